//! The connection to one publisher: asked for, made, kept, and made again while the publisher is registered. The main
//! type is [`Inlet`].

use std::{
    net::SocketAddrV4,
    sync::{Arc, PoisonError},
    time::{Duration, Instant},
};

use super::{Intake, registration::Registration};
use crate::ros::{
    Notice, RosError,
    address::resolve_host,
    connection_header::{ConnectionHeader, HeaderError},
    frames::{Frames, LARGEST_HEADER, LARGEST_MESSAGE, TooLarge},
    socket::Socket,
    stop::WaitError,
    xml_rpc::{CallError, Client, Value},
};

/// For each step of a connection: asking, connecting, exchanging headers.
const STEP_TIMEOUT: Duration = Duration::from_secs(5);
/// Between two attempts at one publisher, at first and at most.
const FIRST_PAUSE: Duration = Duration::from_millis(20);
const LONGEST_PAUSE: Duration = Duration::from_secs(2);

/// Why there is no connection, or none any more.
#[derive(Debug, thiserror::Error)]
enum InletError {
    #[error(transparent)]
    Address(#[from] RosError),
    #[error("it was asked for the topic: {0}")]
    Request(#[from] CallError),
    #[error("it was asked for the topic, and its answer names no TCPROS address")]
    NoAddress,
    #[error("its host `{0}` is not a known one (set ROS_IP for nodes of other hosts)")]
    Host(String),
    #[error(transparent)]
    Connection(#[from] WaitError),
    #[error(transparent)]
    Header(#[from] HeaderError),
    #[error(transparent)]
    TooLarge(#[from] TooLarge),
    #[error("it refused: {0}")]
    Refused(String),
    #[error("it publishes {name} with sum {md5sum}, not {wanted}")]
    WrongType {
        name: String,
        md5sum: String,
        wanted: &'static str,
    },
}

/// One publisher of a subscribed topic.
pub(super) struct Inlet {
    intake: Arc<Intake>,
    /// The publisher's slave API.
    publisher: String,
    registration: Arc<Registration>,
}

impl Inlet {
    pub fn new(intake: Arc<Intake>, publisher: &str, registration: Arc<Registration>) -> Self {
        Self {
            intake,
            publisher: publisher.to_owned(),
            registration,
        }
    }

    /// Receives for as long as the publisher is registered, and from a connection for as long as that works.
    pub fn run(&self) {
        if let Some(setup) = &self.intake.receiver_setup {
            setup();
        }
        let mut pause = FIRST_PAUSE;
        loop {
            let ended = self.connect().and_then(|(socket, frames)| {
                if !self.registration.connected() {
                    return Err(WaitError::Stopped.into());
                }
                pause = FIRST_PAUSE;
                self.receive(&socket, frames)
            });
            let goes_on = self.registration.disconnected();
            if self.registration.stop.is_raised() {
                break;
            }
            if let Err(error) = ended {
                // Another type does not become ours in a moment.
                if matches!(error, InletError::Refused(_) | InletError::WrongType { .. }) {
                    pause = LONGEST_PAUSE;
                }
                self.intake.notices.send(Notice::PublisherLost {
                    topic: self.intake.topic.clone(),
                    publisher: self.publisher.clone(),
                    reason: error.to_string(),
                });
            }
            if !goes_on || self.registration.stop.rest(pause).is_err() {
                break;
            }
            pause = LONGEST_PAUSE.min(pause * 2);
        }
        self.intake.forget(&self.publisher, &self.registration);
    }

    /// Asks for the topic's address, connects to it and exchanges headers.
    fn connect(&self) -> Result<(Socket, Frames), InletError> {
        let deadline = || Instant::now() + STEP_TIMEOUT;
        let address = self.request_topic(deadline())?;
        let socket = Socket::connect(address, &self.registration.stop, deadline())?;
        if self.intake.tcp_nodelay {
            socket.set_nodelay().map_err(WaitError::from)?;
        }
        socket.write_all(&self.header().to_bytes(), deadline())?;
        let mut frames = Frames::new(LARGEST_HEADER);
        let deadline = deadline();
        loop {
            if let Some(header) = frames.next()? {
                self.check(&ConnectionHeader::parse(header)?)?;
                frames.set_limit(LARGEST_MESSAGE);
                return Ok((socket, frames));
            }
            let count = socket.read(frames.space(), Some(deadline))?;
            frames.filled(count);
        }
    }

    fn request_topic(&self, deadline: Instant) -> Result<SocketAddrV4, InletError> {
        let client = Client::new(&self.publisher, self.registration.stop.clone())?;
        let protocols = Value::Array(vec![Value::from(vec!["TCPROS"])]);
        let params = [
            self.intake.node.as_str().into(),
            self.intake.topic.as_str().into(),
            protocols,
        ];
        let answer = client.call_ros("requestTopic", &params, deadline)?;
        let Some([Value::Text(protocol), Value::Text(host), Value::Int(port)]) = answer.as_array() else {
            return Err(InletError::NoAddress);
        };
        let port = u16::try_from(*port)
            .ok()
            .filter(|port| protocol == "TCPROS" && *port != 0);
        let host = resolve_host(host).ok_or_else(|| InletError::Host(host.clone()))?;
        Ok(SocketAddrV4::new(host, port.ok_or(InletError::NoAddress)?))
    }

    fn header(&self) -> ConnectionHeader {
        let kind = &self.intake.message_type;
        ConnectionHeader::new([
            ("callerid", &self.intake.node),
            ("topic", &self.intake.topic),
            ("type", kind.name),
            ("md5sum", kind.md5sum),
            ("message_definition", kind.definition),
            ("tcp_nodelay", if self.intake.tcp_nodelay { "1" } else { "0" }),
        ])
    }

    fn check(&self, header: &ConnectionHeader) -> Result<(), InletError> {
        if let Some(error) = header.get("error") {
            return Err(InletError::Refused(error.chars().take(300).collect()));
        }
        let (name, md5sum) = (header.get("type"), header.require("md5sum")?);
        if self.intake.message_type.agrees_with(name, md5sum) {
            return Ok(());
        }
        Err(InletError::WrongType {
            name: name.unwrap_or("something").chars().take(100).collect(),
            md5sum: md5sum.chars().take(100).collect(),
            wanted: self.intake.message_type.md5sum,
        })
    }

    /// Gives out messages until the connection ends.
    fn receive(&self, socket: &Socket, mut frames: Frames) -> Result<(), InletError> {
        // Before it counts: whoever waits for it finds the notice.
        self.intake.notices.send(Notice::PublisherConnected {
            topic: self.intake.topic.clone(),
            publisher: self.publisher.clone(),
        });
        let _connection = self.intake.connections.add(self.publisher.clone());
        loop {
            let mut on_message = self
                .intake
                .on_message
                .lock()
                .unwrap_or_else(PoisonError::into_inner);
            while let Some(message) = frames.next()? {
                on_message(message);
            }
            drop(on_message);
            let count = socket.read(frames.space(), None)?;
            frames.filled(count);
        }
    }
}
