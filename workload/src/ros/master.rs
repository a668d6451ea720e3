//! The embedded ROS master: who publishes and subscribes what, and the parameter server.
//!
//! It answers as Debian's rosmaster does, on which rospy, rostopic and rosnode are the judges. It does not end when it
//! is asked to: it ends with its experiment. The main type is [`Master`].

mod callbacks;
mod handler;
mod parameters;
mod registry;

use std::{
    net::{SocketAddr, TcpListener},
    sync::{Arc, Mutex},
    time::Duration,
};

use self::{
    callbacks::Callbacks,
    handler::{Handler, Tables},
};
use super::{Notices, RosError, thread_group::ThreadGroup, xml_rpc::serve};

/// For its threads to end.
const END_TIMEOUT: Duration = Duration::from_secs(2);

/// A running master.
#[derive(Debug)]
pub struct Master {
    address: SocketAddr,
    crew: ThreadGroup,
    callbacks: Callbacks,
}

impl Master {
    /// Starts serving on this listener, from threads of the calling thread's network namespace. Nodes may connect as
    /// soon as the listener exists.
    ///
    /// # Errors
    /// [`RosError::System`] if a thread or the listener's address cannot be had.
    pub fn start(listener: TcpListener, notices: Notices) -> Result<Self, RosError> {
        let failed = |error| RosError::system("start the ROS master", error);
        let address = listener.local_addr().map_err(failed)?;
        let crew = ThreadGroup::new().map_err(failed)?;
        let callbacks = Callbacks::new(crew.clone(), notices.clone());
        let handler = Handler {
            uri: format!("http://{address}/"),
            callbacks: callbacks.clone(),
            tables: Mutex::new(Tables::default()),
        };
        serve(listener, &crew, &notices, Arc::new(handler)).map_err(failed)?;
        Ok(Self {
            address,
            crew,
            callbacks,
        })
    }

    /// Its address, such as `http://10.0.0.1:11311/`.
    #[must_use]
    pub fn uri(&self) -> String {
        format!("http://{}/", self.address)
    }

    /// Stops serving and ends its threads, within two seconds.
    pub fn stop(self) {
        self.callbacks.close();
        self.crew.dismiss(END_TIMEOUT);
    }
}

impl Drop for Master {
    /// For whoever leaves by an error: tells the threads to end, without waiting for them.
    fn drop(&mut self) {
        self.callbacks.close();
        self.crew.stop().raise();
    }
}
