//! Connections to an engine, one a request, with a bound on what an engine may answer. The functions are [`connect`] and
//! [`connect_to_follow`].
//!
//! bollard reads an answer whole before it looks at it, and a frame of a log too, whose length is what the engine says. It does
//! not let an answer be looked at before, but it lets the way be ours on which answers come. So what is counted is what comes
//! over a connection: all of it where the answer is one document, and what has come since the last frame where it is a log
//! that is followed. An archive is read piece by piece, and may be as long as it is. A document that is asked for is given up if it
//! stops coming; what an engine does when it is told to (wait, build, load) may take its time.

use std::{
    io,
    path::PathBuf,
    pin::Pin,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    task::{Context, Poll, ready},
    time::Duration,
};

use bollard::{API_DEFAULT_VERSION, BollardRequest, ClientVersion, Docker as Api, errors::Error};
use hyper::{
    Method, Request, Response, Uri,
    body::Incoming,
    client::conn::http1,
    header::{HOST, HeaderValue},
    rt::{Read, ReadBufCursor, Write},
};
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    net::{TcpStream, UnixStream},
    time::{Instant, Sleep, sleep},
};

/// The longest document: what an engine says of thousands of containers. One says less than a kilobyte of each of ours.
const LONGEST_ANSWER: u64 = 8 << 20;
/// The most that may come between two frames of a log. An engine cuts lines into frames of 16 KiB.
const LONGEST_FRAME: u64 = 4 << 20;
/// How long an engine may take until it begins to answer, in seconds: bollard's own value. And how long it may stop in a document.
const TIMEOUT_S: u64 = 120;
const TIMEOUT: Duration = Duration::from_secs(TIMEOUT_S);

/// An engine answers without end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("its answer is longer than {} MiB", .longest >> 20)]
pub struct TooLong {
    longest: u64,
}

impl TooLong {
    /// Among the causes of an error of bollard's.
    #[must_use]
    pub fn behind(error: &Error) -> Option<Self> {
        io_error(error)?.get_ref()?.downcast_ref().copied()
    }
}

/// The operating system's error among the causes of one of bollard's, or one of ours in its place.
pub fn io_error(error: &Error) -> Option<&io::Error> {
    // It does not count as a cause of itself.
    if let Error::IOError { err } = error {
        return Some(err);
    }
    let mut cause: Option<&(dyn std::error::Error + 'static)> = Some(error);
    while let Some(error) = cause {
        if let Some(found) = error.downcast_ref() {
            return Some(found);
        }
        cause = error.source();
    }
    None
}

/// What was too long on any connection of a handle, for where bollard makes one text of the causes of an error: in streams.
#[derive(Debug, Clone, Default)]
pub struct Exceeded(Arc<Mutex<Option<TooLong>>>);

impl Exceeded {
    /// Since it was last asked.
    #[must_use]
    pub fn take(&self) -> Option<TooLong> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    fn tell(&self, too_long: TooLong) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(too_long);
    }
}

/// How much may still come.
#[derive(Debug)]
pub struct Allowance {
    longest: u64,
    left: AtomicU64,
    exceeded: Exceeded,
}

impl Allowance {
    const fn of(longest: u64, exceeded: Exceeded) -> Self {
        Self {
            longest,
            left: AtomicU64::new(longest),
            exceeded,
        }
    }

    /// As much as at the beginning.
    pub fn renew(&self) {
        self.left.store(self.longest, Ordering::Relaxed);
    }

    fn take(&self, bytes: u64) -> Result<(), TooLong> {
        let less = |left: u64| left.checked_sub(bytes);
        self.left
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, less)
            .map(drop)
            .map_err(|_| {
                let too_long = TooLong {
                    longest: self.longest,
                };
                self.exceeded.tell(too_long);
                too_long
            })
    }
}

/// Where an engine listens.
#[derive(Debug, Clone)]
enum Address {
    Unix(PathBuf),
    Tcp(String),
}

impl Address {
    fn read(text: &str) -> Result<Self, Error> {
        match text.split_once("://") {
            Some(("unix", path)) => Ok(Self::Unix(path.into())),
            Some(("tcp" | "http", place)) => Ok(Self::Tcp(place.trim_end_matches('/').to_owned())),
            _ => Err(Error::UnsupportedURISchemeError { uri: text.to_owned() }),
        }
    }

    async fn open(&self) -> io::Result<Box<dyn Stream>> {
        Ok(match self {
            Self::Unix(path) => Box::new(UnixStream::connect(path).await?),
            Self::Tcp(place) => Box::new(TcpStream::connect(place).await?),
        })
    }
}

trait Stream: AsyncRead + AsyncWrite + Send + Unpin {}

impl<T: AsyncRead + AsyncWrite + Send + Unpin> Stream for T {}

/// bollard's handle of the engine at an address such as `unix:///var/run/docker.sock`. Nothing is connected yet.
///
/// # Errors
/// When it is no address of an engine.
pub fn connect(address: &str, exceeded: &Exceeded) -> Result<Api, Error> {
    let exceeded = exceeded.clone();
    by_our_way(address, API_DEFAULT_VERSION, move |request| {
        (!is_archive(request)).then(|| Arc::new(Allowance::of(LONGEST_ANSWER, exceeded.clone())))
    })
}

/// The same for logs that are followed, and what is to be renewed with every frame of theirs that was taken. For one log at a time.
///
/// # Errors
/// As [`connect`].
pub fn connect_to_follow(
    address: &str,
    version: &ClientVersion,
    exceeded: &Exceeded,
) -> Result<(Api, Arc<Allowance>), Error> {
    let allowance = Arc::new(Allowance::of(LONGEST_FRAME, exceeded.clone()));
    let shared = Arc::clone(&allowance);
    let api = by_our_way(address, version, move |_| {
        // A new connection follows from the beginning.
        shared.renew();
        Some(Arc::clone(&shared))
    })?;
    Ok((api, allowance))
}

fn by_our_way(
    address: &str,
    version: &ClientVersion,
    allowance: impl Fn(&BollardRequest) -> Option<Arc<Allowance>> + Send + Sync + 'static,
) -> Result<Api, Error> {
    let address = Address::read(address)?;
    let way = move |request: BollardRequest| {
        let (address, allowance) = (address.clone(), allowance(&request));
        async move { ask(&address, allowance, request).await }
    };
    // The host is in no request's way.
    Api::connect_with_custom_transport(way, Some("http://engine"), TIMEOUT_S, version)
}

/// Whether files are asked for.
fn is_archive(request: &BollardRequest) -> bool {
    request.method() == Method::GET && request.uri().path().ends_with("/archive")
}

async fn ask(
    address: &Address,
    allowance: Option<Arc<Allowance>>,
    request: BollardRequest,
) -> Result<Response<Incoming>, Error> {
    let stream = address.open().await?;
    let pause = is_document(&request).then(|| Pause::of_at_most(TIMEOUT));
    let bounded = Bounded {
        stream,
        allowance,
        pause,
    };
    let (mut sender, connection) = http1::handshake(bounded).await?;
    // It ends with the answer, or with who reads it.
    tokio::spawn(connection);
    let (mut parts, body) = request.into_parts();
    if let Some(path) = parts.uri.path_and_query().cloned() {
        parts.uri = Uri::from(path);
    }
    parts.headers.insert(HOST, HeaderValue::from_static("engine"));
    Ok(sender.send_request(Request::from_parts(parts, body)).await?)
}

/// Whether what is asked for is there already, and nothing is waited for: no log, which may be followed, and no archive, which takes as
/// long as its disk does.
fn is_document(request: &BollardRequest) -> bool {
    request.method() == Method::GET && !is_archive(request) && !request.uri().path().ends_with("/logs")
}

/// A connection over which no more may come than is allowed.
struct Bounded {
    stream: Box<dyn Stream>,
    allowance: Option<Arc<Allowance>>,
    /// Where what is asked for may not stop coming.
    pause: Option<Pause>,
}

/// How long nothing has come.
struct Pause {
    longest: Duration,
    over: Pin<Box<Sleep>>,
}

impl Pause {
    fn of_at_most(longest: Duration) -> Self {
        Self {
            longest,
            over: Box::pin(sleep(longest)),
        }
    }

    /// Something came.
    fn begin_anew(&mut self) {
        self.over.as_mut().reset(Instant::now() + self.longest);
    }

    fn poll_over(&mut self, context: &mut Context<'_>) -> Poll<io::Error> {
        ready!(self.over.as_mut().poll(context));
        let stopped = format!("its answer stopped for {} s", self.longest.as_secs());
        Poll::Ready(io::Error::new(io::ErrorKind::TimedOut, stopped))
    }
}

/// What is read at a time.
const PIECE: usize = 16 << 10;

impl Read for Bounded {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        mut into: ReadBufCursor<'_>,
    ) -> Poll<io::Result<()>> {
        let mut piece = [0; PIECE];
        let (piece, _) = piece.split_at_mut(into.remaining().min(PIECE));
        let mut piece = ReadBuf::new(piece);
        let polled = Pin::new(&mut self.stream).poll_read(context, &mut piece)?;
        if let Some(pause) = &mut self.pause {
            match polled {
                Poll::Ready(()) => pause.begin_anew(),
                Poll::Pending => return pause.poll_over(context).map(Err),
            }
        }
        ready!(polled);
        if let Some(allowance) = &self.allowance {
            allowance
                .take(piece.filled().len() as u64)
                .map_err(io::Error::other)?;
        }
        into.put_slice(piece.filled());
        Poll::Ready(Ok(()))
    }
}

impl Write for Bounded {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        from: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(context, from)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

#[cfg(test)]
pub mod tests {
    use std::future::poll_fn;

    use bollard::query_parameters::{ListContainersOptions, LogsOptionsBuilder};
    use futures_util::StreamExt as _;
    use tokio::{
        io::{AsyncReadExt as _, AsyncWriteExt as _},
        net::UnixListener,
    };

    use super::*;

    /// Of a document.
    pub fn too_long() -> TooLong {
        TooLong {
            longest: LONGEST_ANSWER,
        }
    }

    /// What answers as no engine does, until it is dropped.
    pub struct Hostile {
        folder: tempfile::TempDir,
        task: tokio::task::JoinHandle<()>,
    }

    impl Hostile {
        /// Says `head`, then `again` for ever, or nothing more if that is empty, to whoever asks for anything.
        pub fn saying(head: &'static str, again: &'static [u8]) -> Self {
            let folder = tempfile::tempdir().unwrap();
            let listener = UnixListener::bind(folder.path().join("docker.sock")).unwrap();
            let task = tokio::spawn(async move {
                let mut answering = tokio::task::JoinSet::new();
                while let Ok((mut asking, _)) = listener.accept().await {
                    answering.spawn(async move {
                        let mut question = [0; 4096];
                        let _ = asking.read(&mut question).await;
                        let mut goes_on = asking.write_all(head.as_bytes()).await.is_ok();
                        while goes_on && !again.is_empty() {
                            goes_on = asking.write_all(again).await.is_ok();
                        }
                        // Who listens to one that is silent sees no end.
                        let _ = asking.read(&mut question).await;
                    });
                }
            });
            Self { folder, task }
        }

        /// As `DOCKER_HOST` names it.
        pub fn address(&self) -> String {
            format!("unix://{}", self.folder.path().join("docker.sock").display())
        }
    }

    impl Drop for Hostile {
        fn drop(&mut self) {
            self.task.abort();
        }
    }

    const ENDLESS: &str = "HTTP/1.1 200 OK\r\nContent-Type: application/json\r\n\r\n[\"";
    const FRAMES: &str = "HTTP/1.1 200 OK\r\nContent-Type: application/vnd.docker.raw-stream\r\n\r\n";
    const LONG: &[u8] = &[b'a'; 65536];

    #[tokio::test]
    async fn a_document_without_end_is_an_error_that_says_so() {
        let hostile = Hostile::saying(ENDLESS, LONG);
        let api = connect(&hostile.address(), &Exceeded::default()).unwrap();
        let listed = api.list_containers(None::<ListContainersOptions>).await;
        let too_long = TooLong::behind(&listed.unwrap_err()).unwrap();
        assert_eq!(too_long.to_string(), "its answer is longer than 8 MiB");
    }

    #[tokio::test]
    async fn a_refusal_without_end_is_the_same() {
        let hostile = Hostile::saying("HTTP/1.1 500 No\r\n\r\n", LONG);
        let api = connect(&hostile.address(), &Exceeded::default()).unwrap();
        assert!(TooLong::behind(&api.version().await.unwrap_err()).is_some());
    }

    #[tokio::test]
    async fn an_answer_that_stops_is_given_up() {
        let (stream, mut engine) = UnixStream::pair().unwrap();
        let mut bounded = Bounded {
            stream: Box::new(stream),
            allowance: None,
            pause: Some(Pause::of_at_most(Duration::from_secs(1))),
        };
        let mut read = async || {
            let mut piece = [0; 16];
            let mut into = hyper::rt::ReadBuf::new(&mut piece);
            poll_fn(|context| Pin::new(&mut bounded).poll_read(context, into.unfilled())).await
        };
        engine.write_all(b"[").await.unwrap();
        read().await.unwrap();
        let stopped = read().await.unwrap_err();
        assert_eq!(stopped.to_string(), "its answer stopped for 1 s");
    }

    #[test]
    fn only_a_document_may_not_stop() {
        let asked = |method: Method, path: &str| {
            let request = Request::builder().method(method).uri(path);
            is_document(&request.body(bollard::body_full(Vec::new().into())).unwrap())
        };
        assert!(asked(Method::GET, "http://engine/v1.43/containers/json?all=true"));
        assert!(!asked(
            Method::GET,
            "http://engine/v1.43/containers/x/logs?follow=true"
        ));
        assert!(!asked(
            Method::GET,
            "http://engine/v1.43/containers/x/archive?path=/data"
        ));
        assert!(!asked(Method::POST, "http://engine/v1.43/containers/x/wait"));
    }

    #[tokio::test]
    async fn a_head_without_end_is_an_error() {
        let hostile = Hostile::saying("HTTP/1.1 200 OK\r\nX: ", LONG);
        let api = connect(&hostile.address(), &Exceeded::default()).unwrap();
        assert!(api.version().await.is_err());
    }

    /// Of 2 GiB, by its head.
    #[tokio::test]
    async fn a_frame_of_a_log_that_is_too_long_is_an_error_before_it_has_come() {
        let hostile = Hostile::saying(FRAMES, b"\x01\0\0\0\x7f\xff\xff\xff0123456789");
        let exceeded = Exceeded::default();
        let (api, _) = connect_to_follow(&hostile.address(), API_DEFAULT_VERSION, &exceeded).unwrap();
        let options = LogsOptionsBuilder::default().follow(true).stdout(true).build();
        let frame = api.logs("x", Some(options)).next().await.unwrap();
        assert!(frame.is_err());
        assert_eq!(
            exceeded.take().unwrap().to_string(),
            "its answer is longer than 4 MiB"
        );
        assert_eq!(exceeded.take(), None);
    }

    #[tokio::test]
    async fn a_log_that_is_followed_may_be_longer_than_a_document() {
        let hostile = Hostile::saying(FRAMES, b"\x01\0\0\0\0\0\0\x180123456789abcdef0123456\n");
        let (api, allowance) =
            connect_to_follow(&hostile.address(), API_DEFAULT_VERSION, &Exceeded::default()).unwrap();
        let options = LogsOptionsBuilder::default().follow(true).stdout(true).build();
        let mut frames = api.logs("x", Some(options));
        let mut bytes = 0;
        while bytes < 2 * LONGEST_ANSWER {
            bytes += frames.next().await.unwrap().unwrap().into_bytes().len() as u64;
            allowance.renew();
        }
    }
}
