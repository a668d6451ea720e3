//! The serving side: a thread for each connection, requests one after another. The main type is [`Api`].

use std::{
    io,
    net::{SocketAddr, TcpListener},
    sync::Arc,
    time::{Duration, Instant},
};

use super::{
    document::{Call, read_call, write_response},
    http::{Inbox, Message, Role, refusal, response},
    value::{Params, Value},
};
use crate::ros::{
    Notice, Notices,
    socket::{Socket, accept_all},
    stop::WaitError,
    thread_group::{Guests, ThreadGroup},
};

/// From a request's first byte to its last, and for the answer to be taken.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(10);
/// For a connection on which nothing is asked, unless there are many. Clients open another when they find theirs closed.
const IDLE_TIMEOUT: Duration = Duration::from_secs(300);
/// `system.multicall` answers that many calls: rospy ends with one for each of its topics and services.
const MOST_CALLS: usize = 1000;

/// A call that could not be answered, in XML-RPC's own form.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("fault {code}: {text}")]
pub(in crate::ros) struct Fault {
    pub code: i32,
    pub text: String,
}

impl Fault {
    pub fn unknown_method(method: &str) -> Self {
        let method: String = method.chars().take(60).collect();
        Self {
            code: 1,
            text: format!("there is no method `{method}`"),
        }
    }

    pub fn to_value(&self) -> Value {
        let members = [
            ("faultCode", Value::Int(self.code)),
            ("faultString", self.text.as_str().into()),
        ];
        Value::Struct(
            members
                .into_iter()
                .map(|(name, value)| (name.to_owned(), value))
                .collect(),
        )
    }

    pub fn from_value(value: &Value) -> Self {
        let member = |name| match value {
            Value::Struct(members) => members.get(name),
            _ => None,
        };
        Self {
            code: member("faultCode")
                .and_then(|value| {
                    if let Value::Int(code) = value {
                        Some(*code)
                    } else {
                        None
                    }
                })
                .unwrap_or(0),
            text: member("faultString")
                .and_then(Value::as_text)
                .unwrap_or("(no words)")
                .to_owned(),
        }
    }
}

/// Something that answers calls: the master, or a node's slave side. Called from several threads at once.
pub(in crate::ros) trait Api: Send + Sync {
    fn call(&self, method: &str, params: Params<'_>) -> Result<Value, Fault>;
}

/// Serves until the thread group is dismissed. Returns at once.
pub(in crate::ros) fn serve(
    listener: TcpListener,
    crew: &ThreadGroup,
    notices: &Notices,
    api: Arc<dyn Api>,
) -> io::Result<()> {
    let notices = notices.clone();
    let guests = crew.guests();
    crew.spawn("xmlrpc-accept", move || {
        let ended = accept_all(&listener, guests.stop(), |stream, peer| {
            let served = {
                let (others, notices, api) = (guests.clone(), notices.clone(), Arc::clone(&api));
                guests.spawn("xmlrpc", move || {
                    let ended = Socket::adopt(stream, others.stop().clone())
                        .map_err(WaitError::from)
                        .and_then(|socket| converse(&socket, peer, &notices, &*api, &others));
                    // Peers come and go; what they did wrong has been noticed where it was known.
                    drop(ended);
                })
            };
            if let Err(error) = served {
                notices.send(Notice::CallerRefused {
                    peer,
                    reason: error.to_string(),
                });
            }
        });
        if let Err(WaitError::Io(error)) = ended {
            notices.send(Notice::System {
                what: "accept XML-RPC connections".into(),
                reason: error.to_string(),
            });
        }
    })
}

/// Answers the requests of one connection.
fn converse(
    socket: &Socket,
    peer: SocketAddr,
    notices: &Notices,
    api: &dyn Api,
    guests: &Guests,
) -> Result<(), WaitError> {
    socket.set_nodelay()?;
    let refused = |reason: &dyn ToString| {
        notices.send(Notice::CallerRefused {
            peer,
            reason: reason.to_string(),
        })
    };
    let mut inbox = Inbox::new(Role::Requests);
    let mut buffer = [0; 4096];
    let mut idle_since = Instant::now();
    let mut deadline = idle_since + REQUEST_TIMEOUT;
    loop {
        match inbox.next() {
            Ok(Some(message)) => {
                let answer = answer(api, &message);
                let taken_by = Instant::now() + REQUEST_TIMEOUT;
                socket.write_all(&response(&answer, message.keep_alive), taken_by)?;
                if !message.keep_alive {
                    return Ok(());
                }
                idle_since = Instant::now();
                deadline = idle_since + REQUEST_TIMEOUT;
            }
            Ok(None) => {
                let begun = inbox.has_begun();
                let count = match socket.read(&mut buffer, Some(deadline)) {
                    Ok(count) => count,
                    Err(WaitError::TimedOut)
                        if !begun && idle_since.elapsed() < IDLE_TIMEOUT && !guests.are_many() =>
                    {
                        deadline = Instant::now() + REQUEST_TIMEOUT;
                        continue;
                    }
                    Err(error) => {
                        if begun {
                            refused(&error);
                        }
                        return Err(error);
                    }
                };
                inbox.take_in(buffer.get(..count).unwrap_or_default());
                if !begun {
                    deadline = Instant::now() + REQUEST_TIMEOUT;
                }
            }
            Err(error) => {
                refused(&error);
                return socket.write_all(&refusal(&error), Instant::now() + REQUEST_TIMEOUT);
            }
        }
    }
}

fn answer(api: &dyn Api, message: &Message) -> String {
    let answer = match read_call(&message.body) {
        Ok(Call { method, params }) if method == "system.multicall" => multicall(api, Params(&params)),
        Ok(Call { method, params }) => api.call(&method, Params(&params)),
        Err(error) => Err(Fault {
            code: 2,
            text: error.to_string(),
        }),
    };
    write_response(&answer)
}

/// Several calls in one; each answer is an array of one value, or a fault.
fn multicall(api: &dyn Api, params: Params<'_>) -> Result<Value, Fault> {
    let calls = params.array(0, "calls").map_err(|error| Fault {
        code: 3,
        text: error.to_string(),
    })?;
    if calls.len() > MOST_CALLS {
        return Err(Fault {
            code: 3,
            text: format!("more than {MOST_CALLS} calls in one"),
        });
    }
    let answers = calls.iter().map(|call| {
        let answer = match call {
            Value::Struct(members) => {
                let method = members
                    .get("methodName")
                    .and_then(Value::as_text)
                    .unwrap_or_default();
                let params = members
                    .get("params")
                    .and_then(Value::as_array)
                    .unwrap_or_default();
                // The API itself knows no multicall, so that none nests.
                api.call(method, Params(params))
            }
            _ => Err(Fault {
                code: 3,
                text: "a call should be a struct".into(),
            }),
        };
        answer.map_or_else(|fault| fault.to_value(), |value| Value::Array(vec![value]))
    });
    Ok(Value::Array(answers.collect()))
}

#[cfg(test)]
mod tests {
    use std::{
        io::{Read, Write},
        net::TcpStream,
    };

    use super::*;
    use crate::ros::xml_rpc::Client;

    struct Echo;

    impl Api for Echo {
        fn call(&self, method: &str, params: Params<'_>) -> Result<Value, Fault> {
            match method {
                "echo" => Ok(Value::Array(params.0.to_vec())),
                _ => Err(Fault::unknown_method(method)),
            }
        }
    }

    fn start(notices: &Notices) -> (ThreadGroup, SocketAddr) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let crew = ThreadGroup::new().unwrap();
        serve(listener, &crew, notices, Arc::new(Echo)).unwrap();
        (crew, address)
    }

    fn soon() -> Instant {
        Instant::now() + Duration::from_secs(10)
    }

    #[test]
    fn a_client_is_answered_again_and_again_on_one_connection() {
        let (crew, address) = start(&Notices::ignored());
        let client = Client::new(&format!("http://{address}/"), crew.stop().clone()).unwrap();
        for number in 0..3 {
            let answer = client.call("echo", &[number.into()], soon()).unwrap();
            assert_eq!(answer, Value::from(vec![number]));
        }
        assert_eq!(client.idle_connections(), 1);
        let fault = client.call("nonsense", &[], soon()).unwrap_err();
        assert!(
            fault.to_string().contains("there is no method `nonsense`"),
            "{fault}"
        );
        assert!(crew.dismiss(Duration::from_secs(10)));
    }

    #[test]
    fn several_calls_in_one_are_answered_each_even_if_one_fails() {
        let (crew, address) = start(&Notices::ignored());
        let client = Client::new(&format!("http://{address}/"), crew.stop().clone()).unwrap();
        let call = |method: &str| {
            let members = [
                ("methodName", Value::from(method)),
                ("params", Value::from(vec![1])),
            ];
            Value::Struct(
                members
                    .into_iter()
                    .map(|(name, value)| (name.to_owned(), value))
                    .collect(),
            )
        };
        let calls = Value::Array(vec![call("echo"), call("system.multicall")]);
        let answer = client.call("system.multicall", &[calls], soon()).unwrap();
        let answers = answer.as_array().unwrap();
        assert_eq!(answers[0], Value::Array(vec![Value::from(vec![1])]));
        assert_eq!(
            Fault::from_value(&answers[1]),
            Fault::unknown_method("system.multicall")
        );
    }

    #[test]
    fn a_caller_who_does_not_speak_http_is_refused_and_others_are_served() {
        let (notices, received) = Notices::queue(16);
        let (crew, address) = start(&notices);
        let mut stranger = TcpStream::connect(address).unwrap();
        stranger.write_all(b"\x00\x01\x02\x03 hello\r\n\r\n").unwrap();
        let mut answer = String::new();
        stranger.read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with("HTTP/1.1 400 "), "{answer}");
        assert!(matches!(received.recv().unwrap(), Notice::CallerRefused { .. }));
        let client = Client::new(&format!("http://{address}/"), crew.stop().clone()).unwrap();
        assert!(client.call("echo", &[], soon()).is_ok());
    }
}
