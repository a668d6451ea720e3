//! Says where the run is: lines of JSON on standard output, and in `progress.jsonl` for who comes later. The main type
//! is [`Reporter`].
//!
//! The run must go on whatever becomes of its client: a thread of its own writes to standard output, so that a pipe
//! that nobody empties holds up that thread alone, and one that is closed is forgotten.

use std::{
    fs::{File, OpenOptions},
    io::{self, Write},
    path::Path,
    sync::{
        Mutex, PoisonError,
        mpsc::{Receiver, SyncSender, sync_channel},
    },
    time::Duration,
};

use record::progress::Progress;

use crate::capabilities::spawn_after_drop;

/// Lines that may wait for a slow reader; later ones are dropped from standard output, never from the file.
const MOST_WAITING: usize = 1024;

/// How long the last lines may take.
const END_TIMEOUT: Duration = Duration::from_secs(2);

/// Takes progress from any thread. It never fails: what cannot be written is not worth a measurement.
#[derive(Debug)]
pub struct Reporter {
    file: Option<Mutex<File>>,
    lines: SyncSender<String>,
    /// Never locked: the mutex only lets the threads share the reporter.
    ended: Mutex<Receiver<()>>,
}

impl Reporter {
    /// Writes to standard output, and to a file if one can be had.
    #[must_use]
    pub fn start(file: Option<&Path>) -> Self {
        let file = file.and_then(|path| OpenOptions::new().create(true).append(true).open(path).ok());
        let (lines, waiting) = sync_channel::<String>(MOST_WAITING);
        let (ends, ended) = sync_channel(0);
        // Without the thread `lines` is closed and all else goes on.
        let _ = spawn_after_drop("reporter", move || {
            let mut out = io::stdout();
            for line in waiting {
                let _ = out.write_all(line.as_bytes()).and_then(|()| out.flush());
            }
            drop(ends);
        });
        Self {
            file: file.map(Mutex::new),
            lines,
            ended: Mutex::new(ended),
        }
    }

    /// Says it. A sign of life goes to standard output only: it is for who watches now.
    pub fn say(&self, progress: &Progress) {
        // Progress is plain data: it can always be written as JSON.
        let Ok(mut line) = serde_json::to_string(progress) else {
            return;
        };
        line.push('\n');
        if let (Some(file), false) = (&self.file, progress.is_sign_of_life()) {
            let _ = file
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .write_all(line.as_bytes());
        }
        let _ = self.lines.try_send(line);
    }

    /// Waits until all lines are out, or for two seconds.
    pub fn finish(self) {
        drop(self.lines);
        // Nothing is ever sent: the thread's end closes the channel.
        let ended = self.ended.into_inner().unwrap_or_else(PoisonError::into_inner);
        let _ = ended.recv_timeout(END_TIMEOUT);
    }
}
