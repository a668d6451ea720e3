//! Whether a host's key is the one that is known. The main type is [`KnownHosts`]. What is not known is refused: who
//! stands between us and the host must not be able to measure in its place.
//!
//! The files are those of `ssh` (sshd(8), "SSH_KNOWN_HOSTS FILE FORMAT"). libssh2 compares names, hashed ones too, and
//! keys; what it does not know is done here: `@revoked`, and asking for a key of the kind that is known. Names with `*`
//! and `?` and certificates are not understood, so that they let nobody in.

use std::io::ErrorKind;

use base64::{Engine as _, engine::general_purpose::STANDARD_NO_PAD};
use ssh2::{CheckResult, HashType, KnownHostFileKind, MethodType, Session};

use super::{
    SshError,
    error::HostKeyProblem,
    hop::{Hop, HostKeys},
    small_file,
};

/// Kinds of keys as the files name them, and the signatures to ask a host for. SHA-1 is not among them.
const KINDS: [(&str, &str); 5] = [
    ("ssh-ed25519", "ssh-ed25519"),
    ("ecdsa-sha2-nistp256", "ecdsa-sha2-nistp256"),
    ("ecdsa-sha2-nistp384", "ecdsa-sha2-nistp384"),
    ("ecdsa-sha2-nistp521", "ecdsa-sha2-nistp521"),
    ("ssh-rsa", "rsa-sha2-512,rsa-sha2-256"),
];

/// The lines of the files that may be about a host.
pub struct KnownHosts<'a> {
    hop: &'a Hop,
    /// Kind of key and line.
    valid: Vec<(&'static str, String)>,
    /// Keys in base64, without padding. Whoever shows one is not believed, whatever names the line has: those may be
    /// patterns, which libssh2 does not understand.
    revoked: Vec<String>,
}

impl<'a> KnownHosts<'a> {
    /// Reads the files of a host.
    ///
    /// # Errors
    /// When one is there and cannot be read.
    pub fn of(hop: &'a Hop) -> Result<Self, SshError> {
        let mut known = Self {
            hop,
            valid: Vec::new(),
            revoked: Vec::new(),
        };
        let HostKeys::Known(files) = &hop.host_keys else {
            return Ok(known);
        };
        for path in files {
            match small_file::read(path) {
                Ok(text) => known.add(&String::from_utf8_lossy(&text)),
                Err(error) if error.kind() == ErrorKind::NotFound => {}
                Err(source) => {
                    let path = path.clone();
                    return Err(SshError::KnownHosts { path, source });
                }
            }
        }
        Ok(known)
    }

    fn add(&mut self, text: &str) {
        for line in text.lines().map(str::trim).filter(|line| !line.starts_with('#')) {
            if let Some(line) = line.strip_prefix("@revoked") {
                let key = line.split_whitespace().nth(2);
                self.revoked
                    .extend(key.map(|key| key.trim_end_matches('=').to_owned()));
            } else if !line.starts_with('@') {
                let kind = line.split_whitespace().nth(1);
                let kind = KINDS.iter().find(|(name, _)| Some(*name) == kind);
                self.valid.extend(kind.map(|(name, _)| (*name, line.to_owned())));
            }
        }
    }

    /// Has the session ask for a key of a kind that is known, before one of another kind, which would be refused.
    ///
    /// # Errors
    /// When libssh2 has no room.
    pub fn prefer(&self, session: &Session) -> Result<(), ssh2::Error> {
        let (mut known, mut others) = (Vec::new(), Vec::new());
        for (kind, signatures) in KINDS {
            match self.knows_one(session, kind)? {
                true => known.push(signatures),
                false => others.push(signatures),
            }
        }
        known.append(&mut others);
        session.method_pref(MethodType::HostKey, &known.join(","))
    }

    /// Whether the key that the host has shown is one that is known.
    ///
    /// # Errors
    /// With the key and how to have it known, if it is not.
    pub fn check(&self, session: &Session) -> Result<(), SshError> {
        let broke = |source| SshError::Session {
            place: self.hop.place(),
            source,
        };
        let Some((key, _)) = session.host_key() else {
            return Err(broke(ssh2::Error::unknown()));
        };
        if let HostKeys::FirstSeen(seen) = &self.hop.host_keys {
            return match seen.get_or_init(|| key.to_owned()) == key {
                true => Ok(()),
                false => Err(self.refusal(HostKeyProblem::Changed, session, key)),
            };
        }
        if self.revoked.contains(&STANDARD_NO_PAD.encode(key)) {
            return Err(self.refusal(HostKeyProblem::Revoked, session, key));
        }
        let valid = table(session, self.valid.iter().map(|(_, line)| line)).map_err(broke)?;
        for (number, name) in self.names().iter().enumerate() {
            match valid.check(name, key) {
                CheckResult::Match => return Ok(()),
                // Without its port another server of the host may be meant.
                CheckResult::Mismatch if number == 0 => {
                    return Err(self.refusal(HostKeyProblem::Changed, session, key));
                }
                _ => {}
            }
        }
        Err(self.refusal(HostKeyProblem::Unknown, session, key))
    }

    /// The names to look for, the most exact first, as `ssh` does.
    fn names(&self) -> Vec<String> {
        let Hop {
            host, port, alias, ..
        } = self.hop;
        match (alias, port) {
            (Some(alias), _) => vec![alias.clone()],
            (None, 22) => vec![host.clone()],
            (None, port) => vec![format!("[{host}]:{port}"), host.clone()],
        }
    }

    fn knows_one(&self, session: &Session, kind: &str) -> Result<bool, ssh2::Error> {
        let lines = self.valid.iter().filter(|(of, _)| *of == kind);
        let table = table(session, lines.map(|(_, line)| line))?;
        // No key is this one, so that a mismatch means that the host is there.
        let there = |name: &String| matches!(table.check(name, b"any"), CheckResult::Mismatch);
        Ok(self.names().iter().any(there))
    }

    fn refusal(&self, problem: HostKeyProblem, session: &Session, key: &[u8]) -> SshError {
        SshError::HostKey {
            place: self.hop.place(),
            problem,
            algorithm: kind(key),
            fingerprint: fingerprint(session),
            hint: self.hint(problem),
        }
    }

    fn hint(&self, problem: HostKeyProblem) -> String {
        let Hop { host, port, user, .. } = self.hop;
        let HostKeys::Known(files) = &self.hop.host_keys else {
            return "it is not the machine that was made: remove it, and have it made anew".to_owned();
        };
        let file = files
            .first()
            .map_or("~/.ssh/known_hosts".into(), |path| path.to_string_lossy());
        let add = match self.hop.behind_another {
            false => format!("`ssh-keyscan -p {port} {host} >> {file}`"),
            true => format!("a yes to `ssh -p {port} {user}@{host}` with its `-J`"),
        };
        let check = "compare the fingerprint with the host's own, as \
                     `ssh-keygen -lf /etc/ssh/ssh_host_ed25519_key.pub` prints it there";
        match problem {
            HostKeyProblem::Unknown => format!("{check}; if it is the same, {add} makes it known"),
            HostKeyProblem::Changed => format!(
                "somebody may be answering in its place. If the host was set up anew, {check}; if it is the same, \
                 `ssh-keygen -f {file} -R '{}'` and {add} make it known",
                self.names().first().unwrap_or(host)
            ),
            HostKeyProblem::Revoked => "the host needs a new key".to_owned(),
        }
    }
}

/// Lines that libssh2 does not understand let nobody in.
fn table<'l>(
    session: &Session,
    lines: impl Iterator<Item = &'l String>,
) -> Result<ssh2::KnownHosts, ssh2::Error> {
    let mut table = session.known_hosts()?;
    for line in lines {
        let _ = table.read_str(line, KnownHostFileKind::OpenSSH);
    }
    Ok(table)
}

/// What a key says of itself in its first string (RFC 4253, 6.6).
fn kind(key: &[u8]) -> String {
    let length = key
        .first_chunk::<4>()
        .map_or(0, |length| u32::from_be_bytes(*length));
    let end = 4_usize.saturating_add(usize::try_from(length).unwrap_or(usize::MAX));
    String::from_utf8_lossy(key.get(4..end).unwrap_or_default()).into_owned()
}

/// As `ssh-keygen -l` prints it.
fn fingerprint(session: &Session) -> String {
    let hash = session.host_key_hash(HashType::Sha256).unwrap_or_default();
    format!("SHA256:{}", STANDARD_NO_PAD.encode(hash))
}
