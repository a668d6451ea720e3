//! A live native environment. The main type is [`NativeEnvironment`].

use std::{fs, io, path::Path, time::Duration};

use async_trait::async_trait;
use serde_json::{Map, Value, json};
use workload::record::progress::Progress;

use super::{follow::FollowedFile, process::WorkloadProcess, refused};
use crate::provider::{
    Ended, Environment, ProviderError, data_folder, environment_directory::EnvironmentDirectory, lines::Lines,
};

/// How long a workload may take to end in order before it is ended by force.
const PATIENCE: Duration = Duration::from_secs(10);

/// The environment's folder and the process that writes to it.
#[derive(Debug)]
pub struct NativeEnvironment {
    directory: EnvironmentDirectory,
    process: Option<WorkloadProcess>,
    file: FollowedFile,
    lines: Lines,
    /// Whether it ran when it was created or found.
    ran: bool,
    /// Whether it has ended, so that what the file has is all there will ever be.
    ended: bool,
    last_line: Option<Progress>,
}

impl NativeEnvironment {
    /// Of the folder; with its process, if it runs.
    pub fn new(
        directory: EnvironmentDirectory,
        process: Option<WorkloadProcess>,
    ) -> Result<Self, ProviderError> {
        let file = FollowedFile::open(&directory.lines()).map_err(|source| ProviderError::File {
            action: "read",
            path: directory.lines(),
            source,
        })?;
        Ok(Self {
            ran: process.is_some(),
            ended: process.is_none(),
            directory,
            process,
            file,
            lines: Lines::default(),
            last_line: None,
        })
    }

    /// Waits until there may be more to read: the file has grown, or the process has ended.
    async fn more(&mut self) -> Result<(), ProviderError> {
        let failed = |error| refused("watching the workload", error);
        match &self.process {
            Some(process) => tokio::select! {
                changed = self.file.changed() => changed.map_err(failed),
                ended = process.ended() => {
                    ended.map_err(failed)?;
                    self.ended = true;
                    Ok(())
                }
            },
            None => Ok(()),
        }
    }
}

#[async_trait]
impl Environment for NativeEnvironment {
    fn facts(&self) -> Map<String, Value> {
        let mut facts = Map::new();
        facts.insert("provider".to_owned(), json!("native"));
        facts.insert(
            "workload_sha256".to_owned(),
            json!(crate::workload_binary::sha256()),
        );
        facts
    }

    fn running(&self) -> bool {
        self.ran
    }

    async fn next_progress(&mut self) -> Result<Option<Progress>, ProviderError> {
        loop {
            if let Some(line) = self.lines.next_line()? {
                self.last_line = Some(line.clone());
                return Ok(Some(line));
            }
            // Asked before the file is read: what was written until the end is read after it.
            let ended = self.ended;
            let mut piece = [0_u8; 8192];
            let read = self.file.read(&mut piece).map_err(|source| ProviderError::File {
                action: "read",
                path: self.directory.lines(),
                source,
            })?;
            self.lines.push(piece.get(..read).unwrap_or_default());
            if read == 0 {
                if ended {
                    return Ok(None);
                }
                self.more().await?;
            }
        }
    }

    async fn stop(&mut self) -> Result<(), ProviderError> {
        match &self.process {
            Some(process) => process
                .ask_to_end()
                .map_err(|error| refused("asking the workload to end", error)),
            None => Ok(()),
        }
    }

    async fn ended(&mut self) -> Result<Ended, ProviderError> {
        while self.next_progress().await?.is_some() {}
        let status = self.process.as_mut().and_then(WorkloadProcess::status);
        let words = fs::read_to_string(self.directory.errors()).unwrap_or_default();
        Ok(status
            .map_or_else(|| Ended::by_last_line(self.last_line.as_ref()), Ended::by_status)
            .with_last_words(&words))
    }

    async fn collect(&mut self, into: &Path) -> Result<(), ProviderError> {
        let (from, into) = (self.directory.data(), into.to_owned());
        // Gigabytes at times: not on a thread that others wait for.
        tokio::task::spawn_blocking(move || data_folder::copy(&from, &into))
            .await
            .map_err(|error| refused("copying the data", io::Error::other(error)))?
    }

    async fn discard(mut self: Box<Self>) -> Result<(), ProviderError> {
        remove(&self.directory, self.process.take()).await
    }
}

/// Ends the process, if there is one, and removes the folder.
pub async fn remove(
    directory: &EnvironmentDirectory,
    process: Option<WorkloadProcess>,
) -> Result<(), ProviderError> {
    if let Some(mut process) = process {
        process.end(PATIENCE).await.map_err(|error| {
            if error.kind() == io::ErrorKind::TimedOut {
                ProviderError::TimedOut {
                    action: "ending the workload's process".to_owned(),
                    after: PATIENCE * 2,
                }
            } else {
                refused("ending the workload's process", error)
            }
        })?;
    }
    directory.remove()
}
