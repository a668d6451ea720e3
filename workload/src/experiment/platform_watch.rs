//! The platform before the windows and after them: `environment.json`. The main type is [`PlatformWatch`].
//!
//! The first look is taken by a thread without priority while network and nodes are set up, most of which is waiting, so
//! that it delays nothing; the second one when the loops have ended.

use std::{
    path::{Path, PathBuf},
    sync::{
        Arc,
        mpsc::{Receiver, Sender, channel},
    },
    thread::{self, JoinHandle},
};

use record::{
    layout,
    platform::{PlatformChange, PlatformRecord, RealtimeGrant, RosMasterRecord, SurveyRecord},
};

use super::{error::ExperimentError, window_folder::write_whole};
use crate::{realtime::priority::step_back, survey};

/// What the experiment knows of its ROS master, if it has one; asked at each look.
pub type Master = Arc<dyn Fn() -> Option<RosMasterRecord> + Send + Sync>;

/// Knows what the platform was when the run began.
pub struct PlatformWatch {
    grants: Sender<RealtimeGrant>,
    first_look: JoinHandle<Result<Option<KnownPlatform>, ExperimentError>>,
}

impl PlatformWatch {
    /// Begins to look.
    ///
    /// # Errors
    /// If the thread cannot be started.
    pub fn start(
        data: &Path,
        master: impl Fn() -> Option<RosMasterRecord> + Send + Sync + 'static,
    ) -> Result<Self, ExperimentError> {
        let master: Master = Arc::new(master);
        let path = data.join(layout::ENVIRONMENT);
        let (grants, granted) = channel();
        let name = "platform";
        let first_look = thread::Builder::new().name(name.into()).spawn(move || {
            step_back();
            look(path, master, &granted)
        });
        let first_look = first_look.map_err(|source| ExperimentError::Thread {
            name: name.into(),
            source,
        })?;
        Ok(Self { grants, first_look })
    }

    /// What the loops were granted, which is part of the record: it is written from now on.
    pub fn granted(&self, grant: RealtimeGrant) {
        // The thread waits for it; if it is gone, `finish` says why.
        let _ = self.grants.send(grant);
    }

    /// Looks again and says what is not as it was. Nothing is written if there was no grant to record.
    ///
    /// # Errors
    /// If the record cannot be written, first or now.
    pub fn finish(self) -> Result<Vec<PlatformChange>, ExperimentError> {
        drop(self.grants);
        let first = self.first_look.join();
        let first = first.unwrap_or(Err(ExperimentError::ThreadEnded {
            name: "platform".into(),
        }))?;
        first.map_or(Ok(Vec::new()), KnownPlatform::finish)
    }
}

/// What the platform was when the run began, on record.
pub struct KnownPlatform {
    path: PathBuf,
    master: Master,
    record: SurveyRecord,
}

impl KnownPlatform {
    /// Looks now, and writes it down.
    ///
    /// # Errors
    /// If the record cannot be written.
    pub fn look(data: &Path, grant: RealtimeGrant, master: Master) -> Result<Self, ExperimentError> {
        Self::keep(data.join(layout::ENVIRONMENT), platform(grant, &master), master)
    }

    fn keep(path: PathBuf, before: PlatformRecord, master: Master) -> Result<Self, ExperimentError> {
        let record = SurveyRecord {
            before,
            after: None,
            changes: Vec::new(),
        };
        let known = Self { path, master, record };
        known.write()?;
        Ok(known)
    }

    /// Looks again and says what is not as it was.
    ///
    /// # Errors
    /// If the record cannot be written.
    pub fn finish(mut self) -> Result<Vec<PlatformChange>, ExperimentError> {
        let before = &self.record.before;
        let after = platform(before.realtime.clone(), &self.master);
        self.record.changes = before.changes(&after);
        self.record.after = Some(after);
        self.write()?;
        Ok(self.record.changes)
    }

    fn write(&self) -> Result<(), ExperimentError> {
        write_whole(&self.path, &self.record).map_err(|source| ExperimentError::Write {
            path: self.path.clone(),
            source,
        })
    }
}

fn platform(grant: RealtimeGrant, master: &Master) -> PlatformRecord {
    PlatformRecord {
        ros_master: master(),
        ..survey::platform(grant)
    }
}

fn look(
    path: PathBuf,
    master: Master,
    granted: &Receiver<RealtimeGrant>,
) -> Result<Option<KnownPlatform>, ExperimentError> {
    let mut before = platform(RealtimeGrant::default(), &master);
    let Ok(grant) = granted.recv() else {
        return Ok(None);
    };
    before.realtime = grant;
    KnownPlatform::keep(path, before, master).map(Some)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_record_has_the_platform_before_and_after_and_what_the_loops_were_granted() {
        let data = tempfile::tempdir().unwrap();
        let watch = PlatformWatch::start(data.path(), || None).unwrap();
        watch.granted(RealtimeGrant {
            priority_asked: 80,
            ..RealtimeGrant::default()
        });
        assert_eq!(watch.finish().unwrap(), Vec::new());
        let text = std::fs::read(data.path().join("environment.json")).unwrap();
        let record: SurveyRecord = serde_json::from_slice(&text).unwrap();
        assert_eq!(record.before.realtime.priority_asked, 80);
        assert_eq!(record.after.unwrap().kernel, record.before.kernel);
    }

    #[test]
    fn without_loops_there_is_no_record() {
        let data = tempfile::tempdir().unwrap();
        PlatformWatch::start(data.path(), || None)
            .unwrap()
            .finish()
            .unwrap();
        assert!(!data.path().join("environment.json").exists());
    }
}
