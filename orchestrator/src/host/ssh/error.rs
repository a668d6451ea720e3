//! Why there is no way to a host over SSH. The main type is [`SshError`]. Nothing secret is in one: names of files and
//! public keys' fingerprints are all that is said of keys.

use std::{fmt::Write as _, io, path::PathBuf, time::Duration};

/// What went wrong on the way to a host.
#[derive(Debug, thiserror::Error)]
pub enum SshError {
    /// `ssh -G` did not say where a host is.
    #[error("`ssh -G {host}` failed: {said}")]
    Configuration {
        /// As it stands in the matrix file.
        host: String,
        /// What it said.
        said: String,
    },
    /// The way there is something that is not done here.
    #[error("the SSH configuration of {host} has a ProxyCommand")]
    ProxyCommand {
        /// As it stands in the matrix file.
        host: String,
    },
    /// Hosts that are reached through each other.
    #[error("the way to {host} goes through more than {most} hosts")]
    TooManyJumps {
        /// As it stands in the matrix file.
        host: String,
        /// How many there may be.
        most: usize,
    },
    /// Nobody says who to be there.
    #[error("it is not known which user to be on {host}")]
    NoUser {
        /// As it stands in the matrix file.
        host: String,
    },
    /// Its address was not found, or nothing answers there.
    #[error("cannot connect to {place}")]
    Connect {
        /// `host:port`.
        place: String,
        /// The cause.
        source: io::Error,
    },
    /// A host on the way would not let us through.
    #[error("{through} does not connect us to {place}")]
    Jump {
        /// The host on the way.
        through: String,
        /// `host:port` behind it.
        place: String,
        /// The cause.
        source: ssh2::Error,
    },
    /// What answers does not speak SSH as we do.
    #[error("no SSH session with {place}")]
    Handshake {
        /// `host:port`.
        place: String,
        /// The cause.
        source: ssh2::Error,
    },
    /// A file of known keys that cannot be read: not to know a key is no reason to trust it.
    #[error("cannot read {}", .path.display())]
    KnownHosts {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: io::Error,
    },
    /// The key that it showed is not the host's, as far as anybody knows.
    #[error("the key of {place} {problem}: it showed {algorithm} {fingerprint}")]
    HostKey {
        /// `host:port`.
        place: String,
        /// What is wrong with it.
        problem: HostKeyProblem,
        /// As in `ssh-ed25519`.
        algorithm: String,
        /// `SHA256:…`, as `ssh-keygen -l` prints it.
        fingerprint: String,
        /// What to do about it.
        hint: String,
    },
    /// None of our keys was taken.
    #[error("{place} does not let `{user}` in; {}", list(.tried))]
    NotLetIn {
        /// `host:port`.
        place: String,
        /// Who we said to be.
        user: String,
        /// What was tried, in words.
        tried: Vec<String>,
        /// Keys that only an agent can use.
        encrypted: Vec<PathBuf>,
    },
    /// The connection ended while it was made.
    #[error("the SSH session with {place} broke")]
    Session {
        /// `host:port`.
        place: String,
        /// The cause.
        source: ssh2::Error,
    },
    /// It took too long.
    #[error("no SSH session within {} s", .0.as_secs())]
    TooSlow(Duration),
    /// This machine could not do its part.
    #[error("this machine has no room for another connection")]
    Here(#[from] io::Error),
}

/// What is wrong with a host's key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HostKeyProblem {
    /// No file knows the host.
    Unknown,
    /// The files know another.
    Changed,
    /// The files say that it is not to be trusted any more.
    Revoked,
}

impl std::fmt::Display for HostKeyProblem {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Unknown => "is not known",
            Self::Changed => "is not the one that is known",
            Self::Revoked => "was revoked",
        })
    }
}

impl SshError {
    /// What to do about it, where that is known.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::ProxyCommand { .. } => {
                Some("name the host to go through as `jump: user@host` in the matrix file".to_owned())
            }
            Self::NoUser { host } => Some(format!("write `ssh: user@{host}`")),
            Self::HostKey { hint, .. } => Some(hint.clone()),
            Self::NotLetIn {
                encrypted,
                user,
                place,
                ..
            } => Some(match encrypted.first() {
                Some(key) => format!("the key has a passphrase: run `ssh-add {}` first", key.display()),
                None => format!(
                    "put the public key into ~/.ssh/authorized_keys of `{user}` on {place}, as `ssh-copy-id` does; \
                     passwords are never used"
                ),
            }),
            Self::TooSlow(_) => Some(
                "an SSH agent may be waiting for its user, or the name of the host for its name server; `ssh` to it by \
                 hand tells which"
                    .to_owned(),
            ),
            Self::Connect { .. } => Some("is it switched on, and is its SSH server running?".to_owned()),
            _ => None,
        }
    }
}

fn list(tried: &[String]) -> String {
    if tried.is_empty() {
        return "there is no key to try".to_owned();
    }
    let mut text = "tried".to_owned();
    for (number, what) in tried.iter().enumerate() {
        // Writing to a String cannot fail.
        let _ = write!(text, "{} {what}", if number == 0 { "" } else { "," });
    }
    text
}
