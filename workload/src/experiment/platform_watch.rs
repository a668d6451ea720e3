//! The platform before the windows and after them: `environment.json`. The main type is [`PlatformWatch`].
//!
//! The first look is taken by a thread without priority while network and nodes are set up, most of which is waiting, so
//! that it delays nothing; the second one when the loops have ended.

use std::{
    path::{Path, PathBuf},
    sync::mpsc::{Receiver, Sender, channel},
    thread::{self, JoinHandle},
};

use record::{
    layout,
    platform::{PlatformChange, PlatformRecord, RealtimeGrant, RosMasterRecord, SurveyRecord},
    settings::RosMaster,
};

use super::{error::ExperimentError, master, window_folder::write_whole};
use crate::{realtime::priority::step_back, survey};

/// Knows what the platform was when the run began.
pub struct PlatformWatch {
    path: PathBuf,
    master: RosMaster,
    grants: Sender<RealtimeGrant>,
    first_look: JoinHandle<Result<Option<SurveyRecord>, ExperimentError>>,
}

impl PlatformWatch {
    /// Begins to look.
    ///
    /// # Errors
    /// If the thread cannot be started.
    pub fn start(data: &Path, master: RosMaster) -> Result<Self, ExperimentError> {
        let path = data.join(layout::ENVIRONMENT);
        let (grants, granted) = channel();
        let name = "platform";
        let to = path.clone();
        let first_look = thread::Builder::new().name(name.into()).spawn(move || {
            step_back();
            look(&to, master, &granted)
        });
        let first_look = first_look.map_err(|source| ExperimentError::Thread { name, source })?;
        Ok(Self {
            path,
            master,
            grants,
            first_look,
        })
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
        let first = first.unwrap_or(Err(ExperimentError::ThreadEnded { name: "platform" }))?;
        let Some(mut record) = first else {
            return Ok(Vec::new());
        };
        let after = platform(record.before.realtime.clone(), self.master);
        record.changes = record.before.changes(&after);
        record.after = Some(after);
        let path = self.path;
        write_whole(&path, &record).map_err(|source| ExperimentError::Write { path, source })?;
        Ok(record.changes)
    }
}

fn platform(grant: RealtimeGrant, program: RosMaster) -> PlatformRecord {
    PlatformRecord {
        ros_master: Some(RosMasterRecord {
            program,
            version: master::version(program),
        }),
        ..survey::platform(grant)
    }
}

fn look(
    path: &Path,
    master: RosMaster,
    granted: &Receiver<RealtimeGrant>,
) -> Result<Option<SurveyRecord>, ExperimentError> {
    let mut before = platform(RealtimeGrant::default(), master);
    let Ok(grant) = granted.recv() else {
        return Ok(None);
    };
    before.realtime = grant;
    let record = SurveyRecord {
        before,
        after: None,
        changes: Vec::new(),
    };
    let path = path.to_owned();
    write_whole(&path, &record).map_err(|source| ExperimentError::Write { path, source })?;
    Ok(Some(record))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_record_has_the_platform_before_and_after_and_what_the_loops_were_granted() {
        let data = tempfile::tempdir().unwrap();
        let watch = PlatformWatch::start(data.path(), RosMaster::Embedded).unwrap();
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
        PlatformWatch::start(data.path(), RosMaster::Embedded)
            .unwrap()
            .finish()
            .unwrap();
        assert!(!data.path().join("environment.json").exists());
    }
}
