//! The wish to stop: Ctrl-C or a signal, asked for once and obeyed in order. The main type is [`Stop`].

use tokio::sync::watch;

/// Listens for the wish to stop; cheap to clone.
#[derive(Debug, Clone)]
pub struct Stop(watch::Receiver<bool>);

/// Makes the wish; all [`Stop`]s of it see it.
#[derive(Debug)]
pub struct StopSwitch(watch::Sender<bool>);

/// A switch and what listens to it.
#[must_use]
pub fn stop_switch() -> (StopSwitch, Stop) {
    let (sender, receiver) = watch::channel(false);
    (StopSwitch(sender), Stop(receiver))
}

impl StopSwitch {
    /// Wishes to stop.
    pub fn request(&self) {
        self.0.send_replace(true);
    }
}

impl Stop {
    /// Whether it was wished already.
    #[must_use]
    pub fn is_requested(&self) -> bool {
        *self.0.borrow()
    }

    /// Ends when it is wished; never if nobody can wish it any more.
    pub async fn requested(&self) {
        let mut receiver = self.0.clone();
        if receiver.wait_for(|requested| *requested).await.is_err() {
            std::future::pending::<()>().await;
        }
    }
}
