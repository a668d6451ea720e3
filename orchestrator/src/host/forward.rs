//! A socket of a host, as one of this machine. The main type is [`Forward`]: for clients, such as a Docker Engine's, that
//! know sockets of this machine only.

use std::{
    io,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use tempfile::TempDir;
use tokio::{
    io::copy_bidirectional,
    net::{UnixListener, UnixStream},
    task::{JoinHandle, JoinSet},
};

use super::{Host, HostError, Listener};

/// The socket, until it is dropped, and with it whatever goes through.
pub struct Forward {
    // Nobody else may enter it: who can connect is the host's user there.
    folder: TempDir,
    accepting: JoinHandle<()>,
    failure: Arc<Mutex<Option<HostError>>>,
}

impl Forward {
    /// Makes a socket here each of whose connections becomes one to `listener` there. Nothing is connected yet.
    ///
    /// # Errors
    /// When there can be no socket here.
    pub fn open(host: Arc<dyn Host>, listener: Listener) -> io::Result<Self> {
        let folder = TempDir::with_prefix("matrix-forward-")?;
        let socket = UnixListener::bind(socket_in(folder.path()))?;
        let failure = Arc::default();
        let accepting = tokio::spawn(accept(socket, host, listener, Arc::clone(&failure)));
        Ok(Self {
            folder,
            accepting,
            failure,
        })
    }

    /// Its file here.
    #[must_use]
    pub fn socket(&self) -> PathBuf {
        socket_in(self.folder.path())
    }

    /// Why the last connection came to nothing, if it did: who connects sees only that it ended.
    #[must_use]
    pub fn take_failure(&self) -> Option<HostError> {
        self.failure.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

impl Drop for Forward {
    fn drop(&mut self) {
        self.accepting.abort();
    }
}

fn socket_in(folder: &Path) -> PathBuf {
    folder.join("socket")
}

async fn accept(
    socket: UnixListener,
    host: Arc<dyn Host>,
    listener: Listener,
    failure: Arc<Mutex<Option<HostError>>>,
) {
    // Dropped with this task.
    let mut connections = JoinSet::new();
    while let Ok((near, _)) = socket.accept().await {
        while connections.try_join_next().is_some() {}
        let (host, listener, failure) = (Arc::clone(&host), listener.clone(), Arc::clone(&failure));
        connections.spawn(async move {
            let (far, outcome) = match host.connect(&listener).await {
                Ok(far) => (Some(far), None),
                Err(error) => (None, Some(error)),
            };
            *failure.lock().unwrap_or_else(PoisonError::into_inner) = outcome;
            if let Some(far) = far {
                pass(near, far).await;
            }
        });
    }
}

/// Both ends see for themselves when the other has ended.
async fn pass(mut near: UnixStream, mut far: UnixStream) {
    let _ = copy_bidirectional(&mut near, &mut far).await;
}
