//! How subscribers are welcomed, or refused: the publishing side of TCPROS, up to where the control loop takes over.
//!
//! Source: <http://wiki.ros.org/ROS/TCPROS> and <http://wiki.ros.org/ROS/Connection%20Header>. A thread for each
//! connection: it exchanges headers, hands the socket to the publisher, and then waits for the subscriber to leave.

use std::{
    io,
    net::{Shutdown, SocketAddr, TcpListener, TcpStream},
    sync::Arc,
    time::{Duration, Instant},
};

use super::membership::Membership;
use crate::ros::{
    Notice,
    connection_header::{ConnectionHeader, HeaderError},
    frames::{Frames, LARGEST_HEADER, TooLarge},
    publisher::{Publication, Seat},
    socket::{Socket, accept_all},
    stop::WaitError,
};

/// For a refusal to be taken.
const REFUSAL_TIMEOUT: Duration = Duration::from_secs(1);

/// Why a connection does not become a subscriber.
#[derive(Debug, thiserror::Error)]
enum Refusal {
    /// Somebody tried whether anybody listens, or changed their mind: not worth a word.
    #[error("it came and went")]
    Nothing,
    #[error("no whole header arrived: {0}")]
    Connection(#[from] WaitError),
    #[error(transparent)]
    Header(#[from] HeaderError),
    #[error(transparent)]
    TooLarge(#[from] TooLarge),
    #[error("[{0}] is not published here")]
    NotPublished(String),
    #[error("[{topic}] is {ours} with sum {our_sum}, and not {theirs} with sum {their_sum}")]
    WrongType {
        topic: String,
        ours: &'static str,
        our_sum: &'static str,
        theirs: String,
        their_sum: String,
    },
    #[error("[{0}] has as many subscribers as it serves")]
    Full(String),
}

/// Welcomes subscribers until the thread group is dismissed. Returns at once.
pub(super) fn serve(listener: TcpListener, node: &Arc<Membership>) -> io::Result<()> {
    let member = Arc::clone(node);
    let guests = node.crew.guests();
    node.crew.spawn("tcpros-accept", move || {
        let ended = accept_all(&listener, member.crew.stop(), |stream, peer| {
            let node = Arc::clone(&member);
            let refused = |reason: String| {
                member.notices.send(Notice::SubscriberRefused {
                    peer,
                    reason: cut(&reason),
                })
            };
            if let Err(error) = guests.spawn("tcpros-serve", move || welcome(&node, stream, peer)) {
                refused(error.to_string());
            }
        });
        if let Err(WaitError::Io(error)) = ended {
            let (what, reason) = ("accept subscribers".into(), error.to_string());
            member.notices.send(Notice::System { what, reason });
        }
    })
}

/// One connection, from its header to its end.
fn welcome(node: &Membership, stream: TcpStream, peer: SocketAddr) {
    let refused = |reason: &Refusal| {
        node.notices.send(Notice::SubscriberRefused {
            peer,
            reason: cut(&reason.to_string()),
        })
    };
    let socket = match Socket::adopt(stream, node.crew.stop().clone()) {
        Ok(socket) => socket,
        Err(error) => return refused(&Refusal::Connection(error.into())),
    };
    match agree(node, &socket) {
        Ok(subscriber) => attend(node, &socket, peer, subscriber),
        Err(Refusal::Nothing | Refusal::Connection(WaitError::Stopped)) => {}
        Err(refusal) => {
            refused(&refusal);
            let answer = ConnectionHeader::new([("error", &refusal.to_string())]);
            // It may have gone already.
            let _ = socket.write_all(&answer.to_bytes(), Instant::now() + REFUSAL_TIMEOUT);
        }
    }
}

/// A subscriber that speaks of the same topic and type.
struct Subscriber {
    name: String,
    publication: Arc<Publication>,
    seat: Seat,
}

/// Reads the subscriber's header and answers it.
fn agree(node: &Membership, socket: &Socket) -> Result<Subscriber, Refusal> {
    let deadline = Instant::now() + node.header_patience;
    let header = read_header(socket, deadline)?;
    let topic = header.require("topic")?;
    let md5sum = header.require("md5sum")?;
    let publication = node
        .publication(topic)
        .ok_or_else(|| Refusal::NotPublished(cut(topic)))?;
    let kind = publication.message_type;
    if !kind.agrees_with(header.get("type"), md5sum) {
        return Err(Refusal::WrongType {
            topic: publication.topic.clone(),
            ours: kind.name,
            our_sum: kind.md5sum,
            theirs: cut(header.get("type").unwrap_or("something")),
            their_sum: cut(md5sum),
        });
    }
    let seat = publication
        .take_seat()
        .ok_or_else(|| Refusal::Full(publication.topic.clone()))?;
    // ROS's rule: the subscriber decides.
    if header.get("tcp_nodelay") == Some("1") {
        socket.set_nodelay().map_err(WaitError::from)?;
    }
    let answer = ConnectionHeader::new([
        ("callerid", node.name.as_str()),
        ("topic", &publication.topic),
        ("type", kind.name),
        ("md5sum", kind.md5sum),
        ("message_definition", kind.definition),
        ("latching", "0"),
    ]);
    socket.write_all(&answer.to_bytes(), deadline)?;
    let name = cut(header.get("callerid").unwrap_or("(unnamed)"));
    Ok(Subscriber {
        name,
        publication,
        seat,
    })
}

fn read_header(socket: &Socket, deadline: Instant) -> Result<ConnectionHeader, Refusal> {
    let mut frames = Frames::new(LARGEST_HEADER);
    loop {
        if let Some(header) = frames.next()? {
            return Ok(ConnectionHeader::parse(header)?);
        }
        match socket.read(frames.space(), Some(deadline)) {
            Ok(count) => frames.filled(count),
            Err(WaitError::Closed) if !frames.has_begun() => return Err(Refusal::Nothing),
            Err(error) => return Err(error.into()),
        }
    }
}

/// Hands the socket to the publisher, and waits for the subscriber to leave.
fn attend(node: &Membership, socket: &Socket, peer: SocketAddr, subscriber: Subscriber) {
    let Subscriber {
        name,
        publication,
        seat,
    } = subscriber;
    publication.admit(seat, Arc::clone(socket.stream()));
    // Before it counts: whoever waits for it finds the notice.
    node.notices.send(Notice::SubscriberConnected {
        topic: publication.topic.clone(),
        subscriber: name.clone(),
        peer,
    });
    let connection = publication.connections.add(name.clone());
    let mut ignored = [0; 256];
    let ended = loop {
        // Subscribers have nothing to say after their header.
        if let Err(error) = socket.read(&mut ignored, None) {
            break error;
        }
    };
    drop(connection);
    // So that the publisher's next write fails, and it lets go of the socket.
    let _ = socket.stream().shutdown(Shutdown::Both);
    if !matches!(ended, WaitError::Stopped) {
        node.notices.send(Notice::SubscriberLost {
            topic: publication.topic.clone(),
            subscriber: name,
            peer,
            reason: ended.to_string(),
        });
    }
}

/// What a peer says, at a length that can be logged.
fn cut(text: &str) -> String {
    text.chars().take(200).collect()
}
