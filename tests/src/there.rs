//! Another machine, as far as `matrix` can tell. The main type is [`There`].

use crate::sshd::Sshd;

/// Another machine, as far as anybody can tell: sshd's users have a state folder and a lease of their own.
#[derive(Debug)]
pub struct There {
    /// Its server.
    pub sshd: Sshd,
}

impl There {
    /// One with a server of its own.
    ///
    /// # Panics
    /// As [`Sshd::start`].
    #[must_use]
    pub fn start() -> Self {
        Self { sshd: Sshd::start() }
    }

    /// The matrix file's words for reaching it.
    #[must_use]
    pub fn connect(&self) -> String {
        self.sshd.connect()
    }

    /// What is in its folder of environments.
    #[must_use]
    pub fn environments(&self) -> Vec<String> {
        match std::fs::read_dir(self.sshd.folder().join("state/environments")) {
            Ok(entries) => entries
                .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
                .collect(),
            Err(_) => Vec::new(),
        }
    }

    /// A matrix of it alone, natively; `workload` are the lines of that section.
    #[must_use]
    pub fn matrix(&self, workload: &str) -> String {
        format!(
            "hosts:\n  there: {{hardware: two, os: linux, connect: {}}}\n\
             matrix:\n  virtualization: [native]\nworkload:\n{workload}",
            self.connect()
        )
    }
}
