//! HTTP/1.0 and 1.1 messages with a body, as XML-RPC uses them. Pure: bytes in, messages out. The main type is
//! [`Inbox`].
//!
//! Source: RFC 9112. Chunked bodies are refused: no XML-RPC library of ROS sends them.

use std::ops::Range;

/// Request line or status line, and header fields.
const LARGEST_HEAD: usize = 8 * 1024;
/// The largest parameters of real robots (URDF files) are below this.
const LARGEST_BODY: usize = 1024 * 1024;
const MOST_FIELDS: usize = 48;

/// Why bytes are not a message that we take.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(in crate::ros) enum HttpError {
    #[error("it is not HTTP: {0}")]
    Malformed(#[from] httparse::Error),
    #[error("its head is larger than {LARGEST_HEAD} bytes")]
    HeadTooLarge,
    #[error("its body is larger than {LARGEST_BODY} bytes")]
    BodyTooLarge,
    #[error("it does not say how long its body is")]
    NoLength,
    #[error("its Content-Length makes no sense")]
    BadLength,
    #[error("its body is not UTF-8")]
    NotText,
    #[error("it is a {0} request, and only POST is served")]
    NotPost(String),
    #[error("its status is {0}")]
    Status(u16),
}

/// Which of the two kinds of message is expected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::ros) enum Role {
    Requests,
    Responses,
}

/// Collects bytes as they arrive and finds messages in them.
#[derive(Debug)]
pub(in crate::ros) struct Inbox {
    role: Role,
    bytes: Vec<u8>,
    head: Option<Head>,
}

/// What a message's head says that matters here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Head {
    length: usize,
    /// `None`: the body goes on until the peer closes, which only a response may do.
    body: Option<usize>,
    keep_alive: bool,
}

/// A whole message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::ros) struct Message {
    pub body: String,
    /// Whether another may follow on the same connection.
    pub keep_alive: bool,
}

impl Inbox {
    pub fn new(role: Role) -> Self {
        Self {
            role,
            bytes: Vec::new(),
            head: None,
        }
    }

    /// Whether a message has begun to arrive.
    pub fn has_begun(&self) -> bool {
        !self.bytes.is_empty()
    }

    pub fn take_in(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    /// The next message, if it is all there.
    pub fn next(&mut self) -> Result<Option<Message>, HttpError> {
        let head = match self.head {
            Some(head) => head,
            None => match parse_head(self.role, &self.bytes)? {
                Some(head) => *self.head.insert(head),
                None if self.bytes.len() > LARGEST_HEAD => return Err(HttpError::HeadTooLarge),
                None => return Ok(None),
            },
        };
        match head.body {
            Some(length) => self.take(head, head.length..head.length + length),
            None if self.bytes.len() - head.length > LARGEST_BODY => Err(HttpError::BodyTooLarge),
            None => Ok(None),
        }
    }

    /// What there is when the peer has closed: a response without a length is whole then.
    pub fn close(&mut self) -> Result<Option<Message>, HttpError> {
        match self.head {
            Some(head) if head.body.is_none() => self.take(head, head.length..self.bytes.len()),
            _ => Ok(None),
        }
    }

    fn take(&mut self, head: Head, range: Range<usize>) -> Result<Option<Message>, HttpError> {
        let end = range.end;
        let Some(body) = self.bytes.get(range) else {
            return Ok(None);
        };
        let body = String::from_utf8(body.to_vec()).map_err(|_| HttpError::NotText)?;
        self.bytes.drain(..end);
        self.head = None;
        Ok(Some(Message {
            body,
            keep_alive: head.keep_alive,
        }))
    }
}

fn parse_head(role: Role, bytes: &[u8]) -> Result<Option<Head>, HttpError> {
    let bytes = bytes.get(..LARGEST_HEAD).unwrap_or(bytes);
    let mut fields = [httparse::EMPTY_HEADER; MOST_FIELDS];
    let (length, version, fields) = match role {
        Role::Requests => {
            let mut request = httparse::Request::new(&mut fields);
            let httparse::Status::Complete(length) = request.parse(bytes)? else {
                return Ok(None);
            };
            if let Some(method) = request.method.filter(|method| *method != "POST") {
                return Err(HttpError::NotPost(method.chars().take(20).collect()));
            }
            (length, request.version, request.headers)
        }
        Role::Responses => {
            let mut response = httparse::Response::new(&mut fields);
            let httparse::Status::Complete(length) = response.parse(bytes)? else {
                return Ok(None);
            };
            if let Some(code) = response.code.filter(|code| *code != 200) {
                return Err(HttpError::Status(code));
            }
            (length, response.version, response.headers)
        }
    };
    let body = body_length(fields)?;
    if body.is_none() && role == Role::Requests {
        return Err(HttpError::NoLength);
    }
    let connection = values(fields, "connection")
        .next()
        .map(<[u8]>::to_ascii_lowercase);
    let keep_alive = match connection.as_deref() {
        Some(b"close") => false,
        Some(b"keep-alive") => body.is_some(),
        _ => version == Some(1) && body.is_some(),
    };
    Ok(Some(Head {
        length,
        body,
        keep_alive,
    }))
}

fn body_length(fields: &[httparse::Header<'_>]) -> Result<Option<usize>, HttpError> {
    if values(fields, "transfer-encoding").next().is_some() {
        return Err(HttpError::NoLength);
    }
    let mut lengths = values(fields, "content-length").map(|value| {
        let text = std::str::from_utf8(value).ok()?.trim();
        text.bytes()
            .all(|byte| byte.is_ascii_digit())
            .then(|| text.parse::<usize>().ok())?
    });
    let Some(first) = lengths.next() else {
        return Ok(None);
    };
    // Two lengths that differ are how requests are smuggled.
    if lengths.any(|other| other != first) {
        return Err(HttpError::BadLength);
    }
    match first {
        None => Err(HttpError::BadLength),
        Some(length) if length > LARGEST_BODY => Err(HttpError::BodyTooLarge),
        length => Ok(length),
    }
}

fn values<'a>(fields: &'a [httparse::Header<'a>], name: &'a str) -> impl Iterator<Item = &'a [u8]> {
    fields
        .iter()
        .filter(move |field| field.name.eq_ignore_ascii_case(name))
        .map(|field| field.value)
}

/// A request to be written with one system call, so that head and body leave in one segment.
pub(in crate::ros) fn request(host: &str, path: &str, body: &str) -> Vec<u8> {
    let length = body.len();
    format!(
        "POST {path} HTTP/1.1\r\nHost: {host}\r\nUser-Agent: matrix-workload\r\nContent-Type: text/xml\r\n\
        Content-Length: {length}\r\n\r\n{body}"
    )
    .into_bytes()
}

/// A response, likewise.
pub(in crate::ros) fn response(body: &str, keep_alive: bool) -> Vec<u8> {
    let length = body.len();
    let connection = if keep_alive { "keep-alive" } else { "close" };
    format!(
        "HTTP/1.1 200 OK\r\nServer: matrix-workload\r\nContent-Type: text/xml\r\nContent-Length: {length}\r\n\
        Connection: {connection}\r\n\r\n{body}"
    )
    .into_bytes()
}

/// The last words to a peer that did not send a request that is served.
pub(in crate::ros) fn refusal(error: &HttpError) -> Vec<u8> {
    let status = match error {
        HttpError::HeadTooLarge => "431 Request Header Fields Too Large",
        HttpError::BodyTooLarge => "413 Content Too Large",
        HttpError::NoLength => "411 Length Required",
        HttpError::NotPost(_) => "405 Method Not Allowed\r\nAllow: POST",
        _ => "400 Bad Request",
    };
    let body = format!("{error}\n");
    let length = body.len();
    format!(
        "HTTP/1.1 {status}\r\nContent-Type: text/plain\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n{body}"
    )
    .into_bytes()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn read_all(role: Role, bytes: &[u8]) -> Result<Vec<Message>, HttpError> {
        let mut inbox = Inbox::new(role);
        inbox.take_in(bytes);
        let mut messages = Vec::new();
        while let Some(message) = inbox.next()? {
            messages.push(message);
        }
        messages.extend(inbox.close()?);
        Ok(messages)
    }

    #[test]
    fn what_is_written_is_read() {
        let kept = Message {
            body: "<ä/>".into(),
            keep_alive: true,
        };
        assert_eq!(
            read_all(Role::Requests, &request("h1:1", "/", "<ä/>")),
            Ok(vec![kept.clone()])
        );
        assert_eq!(read_all(Role::Responses, &response("<ä/>", true)), Ok(vec![kept]));
    }

    #[rstest::rstest]
    #[case("HTTP/1.1", "", true)]
    #[case("HTTP/1.1", "connection: Close\r\n", false)]
    #[case("HTTP/1.0", "", false)]
    #[case("HTTP/1.0", "Connection: Keep-Alive\r\n", true)]
    fn a_connection_is_kept_as_version_and_field_say(
        #[case] version: &str,
        #[case] field: &str,
        #[case] kept: bool,
    ) {
        let bytes = format!("POST / {version}\r\n{field}Content-length: 1\r\n\r\nx");
        assert_eq!(
            read_all(Role::Requests, bytes.as_bytes()).unwrap()[0].keep_alive,
            kept
        );
    }

    #[test]
    fn a_response_without_a_length_ends_with_its_connection() {
        let bytes = b"HTTP/1.0 200 OK\r\n\r\nall of it";
        let whole = Message {
            body: "all of it".into(),
            keep_alive: false,
        };
        assert_eq!(read_all(Role::Responses, bytes), Ok(vec![whole]));
    }

    #[rstest::rstest]
    #[case("GET / HTTP/1.1\r\n\r\n", HttpError::NotPost("GET".into()))]
    #[case("POST / HTTP/1.1\r\n\r\n", HttpError::NoLength)]
    #[case("POST / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n", HttpError::NoLength)]
    #[case("POST / HTTP/1.1\r\nContent-Length: -1\r\n\r\n", HttpError::BadLength)]
    #[case(
        "POST / HTTP/1.1\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\n",
        HttpError::BadLength
    )]
    #[case(
        "POST / HTTP/1.1\r\nContent-Length: 99999999\r\n\r\n",
        HttpError::BodyTooLarge
    )]
    #[case("POST / HTTP/1.1\r\nContent-Length: 1\r\n\r\n\u{ff}", HttpError::NotText)]
    fn what_is_not_served_is_refused_with_its_reason(#[case] request: &str, #[case] reason: HttpError) {
        assert_eq!(read_all(Role::Requests, request.as_bytes()), Err(reason));
    }

    #[test]
    fn a_head_without_end_is_refused() {
        let bytes = format!("POST / HTTP/1.1\r\nX: {}", "x".repeat(2 * LARGEST_HEAD));
        assert_eq!(
            read_all(Role::Requests, bytes.as_bytes()),
            Err(HttpError::HeadTooLarge)
        );
    }

    #[test]
    fn an_answer_other_than_ok_is_an_error() {
        assert_eq!(
            read_all(Role::Responses, b"HTTP/1.1 404 Not Found\r\n\r\n"),
            Err(HttpError::Status(404))
        );
    }

    proptest! {
        #[test]
        fn requests_are_found_however_the_bytes_are_cut(
            bodies in proptest::collection::vec("[a-zä]{0,20}", 1..4),
            cut in 1_usize..64,
        ) {
            let bytes: Vec<u8> = bodies.iter().flat_map(|body| request("h", "/", body)).collect();
            let mut inbox = Inbox::new(Role::Requests);
            let mut found = Vec::new();
            for piece in bytes.chunks(cut) {
                inbox.take_in(piece);
                while let Some(message) = inbox.next().unwrap() {
                    found.push(message.body);
                }
            }
            prop_assert_eq!(found, bodies);
        }

        #[test]
        fn a_request_that_was_tampered_with_is_found_or_refused_within_the_limits(
            body in "[a-z]{0,40}",
            changes in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 1..4),
        ) {
            let mut bytes = request("h", "/", &body);
            for (place, byte) in changes {
                *place.get_mut(&mut bytes) = byte;
            }
            for message in read_all(Role::Requests, &bytes).unwrap_or_default() {
                prop_assert!(message.body.len() <= bytes.len());
            }
        }

        #[test]
        fn no_bytes_make_it_panic(bytes: Vec<u8>) {
            let _ = read_all(Role::Requests, &bytes);
            let _ = read_all(Role::Responses, &bytes);
        }
    }
}
