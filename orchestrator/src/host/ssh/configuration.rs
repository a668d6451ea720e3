//! What the SSH configuration of the user says of a host. The main type is [`SshClient`].
//!
//! A name may be one of `~/.ssh/config`: `ssh -G`, which connects to nothing, says what it means there. Without `ssh`
//! the address is taken as it stands.

use std::{
    env,
    io::ErrorKind,
    path::PathBuf,
    process::{Command, Stdio},
};

use record::connection::SshAddress;

use super::SshError;
use crate::workload_binary;

/// What is tried where nobody names a key.
const DEFAULT_IDENTITIES: [&str; 3] = ["id_ed25519", "id_ecdsa", "id_rsa"];

/// What the `ssh` of the user who started us goes by.
#[derive(Debug, Clone, Default)]
pub struct SshClient {
    /// Where `~` is.
    pub home: Option<PathBuf>,
    /// Who to be where nobody says it.
    pub user: Option<String>,
    /// The socket of the agent that keeps keys.
    pub agent: Option<PathBuf>,
    /// The configuration, in place of `~/.ssh/config` and the system's.
    pub configuration: Option<PathBuf>,
}

impl SshClient {
    /// The surroundings that we were started in.
    #[must_use]
    pub fn of_this_user() -> Self {
        let path = |name| {
            env::var_os(name)
                .filter(|value| !value.is_empty())
                .map(PathBuf::from)
        };
        Self {
            home: path("HOME"),
            user: env::var("USER").or_else(|_| env::var("LOGNAME")).ok(),
            agent: path("SSH_AUTH_SOCK"),
            configuration: None,
        }
    }

    /// A path in which `~` is the user's home.
    pub(super) fn expanded(&self, path: &str) -> PathBuf {
        match (path.strip_prefix("~/"), &self.home) {
            (Some(rest), Some(home)) => home.join(rest),
            _ => PathBuf::from(path),
        }
    }

    /// What `ssh` goes by when nothing is configured.
    fn defaults(&self) -> Answer {
        let ssh = |name: &str| self.expanded(&format!("~/.ssh/{name}"));
        Answer {
            identities: DEFAULT_IDENTITIES.map(ssh).to_vec(),
            known_hosts: vec![ssh("known_hosts"), "/etc/ssh/ssh_known_hosts".into()],
            agent: self.agent.clone(),
            ..Answer::default()
        }
    }

    /// What is configured for an address.
    ///
    /// # Errors
    /// When `ssh` does not understand its configuration.
    pub(super) fn look_up(&self, address: &SshAddress) -> Result<Answer, SshError> {
        Ok(match self.asked(address)? {
            Some(text) => Answer::read(&text, self),
            None => self.defaults(),
        })
    }

    /// What `ssh -G` prints of an address; `None` without `ssh`.
    fn asked(&self, address: &SshAddress) -> Result<Option<String>, SshError> {
        let mut command = Command::new("ssh");
        command.arg("-G").stdin(Stdio::null());
        if let Some(file) = &self.configuration {
            command.arg("-F").arg(file);
        }
        if let Some(port) = address.port {
            command.args(["-p", &port.to_string()]);
        }
        if let Some(user) = &address.user {
            command.args(["-l", user]);
        }
        command.args(["--", &address.host]);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        let failed = |said: String| SshError::Configuration {
            host: address.host.clone(),
            said,
        };
        let output = match workload_binary::start(|| command.spawn()) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            started => started.and_then(std::process::Child::wait_with_output),
        };
        let output = output.map_err(|error| failed(error.to_string()))?;
        if !output.status.success() {
            return Err(failed(String::from_utf8_lossy(&output.stderr).trim().to_owned()));
        }
        Ok(Some(String::from_utf8_lossy(&output.stdout).into_owned()))
    }
}

/// What is configured for an address.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Answer {
    /// Its name or address.
    pub(super) host: Option<String>,
    /// Its port.
    pub(super) port: Option<u16>,
    /// Who to be there.
    pub(super) user: Option<String>,
    /// The name that its key is known by.
    pub(super) alias: Option<String>,
    /// Private keys to try.
    pub(super) identities: Vec<PathBuf>,
    /// The files that know keys, the user's own first.
    pub(super) known_hosts: Vec<PathBuf>,
    /// The agent to ask.
    pub(super) agent: Option<PathBuf>,
    /// The hosts on the way, as they are printed.
    pub(super) jumps: Vec<String>,
    /// Whether a program is the way there.
    pub(super) has_proxy_command: bool,
}

impl Answer {
    /// Reads what `ssh -G` printed.
    pub(crate) fn read(text: &str, client: &SshClient) -> Self {
        let mut answer = Self {
            agent: client.agent.clone(),
            ..Self::default()
        };
        for (key, value) in text.lines().filter_map(|line| line.split_once(' ')) {
            let none = value.eq_ignore_ascii_case("none");
            let paths = || value.split_whitespace().map(|path| client.expanded(path));
            match key {
                "hostname" => answer.host = Some(value.to_owned()),
                "port" => answer.port = value.parse().ok(),
                "user" => answer.user = Some(value.to_owned()),
                "hostkeyalias" => answer.alias = Some(value.to_owned()).filter(|_| !none),
                "identityfile" if !none => answer.identities.push(client.expanded(value)),
                "userknownhostsfile" | "globalknownhostsfile" if !none => answer.known_hosts.extend(paths()),
                "identityagent" => match value {
                    "SSH_AUTH_SOCK" => {}
                    _ if none => answer.agent = None,
                    path => answer.agent = Some(client.expanded(path)),
                },
                "proxyjump" if !none => answer.jumps = value.split(',').map(str::to_owned).collect(),
                "proxycommand" => answer.has_proxy_command = !none,
                _ => {}
            }
        }
        // The user's own come first: it is they who are named to add a key to.
        answer.known_hosts.sort_by_key(|path| path.starts_with("/etc"));
        answer
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn without_ssh_the_usual_files_are_looked_into() {
        let client = SshClient {
            home: Some("/home/me".into()),
            ..SshClient::default()
        };
        let defaults = client.defaults();
        assert_eq!(defaults.identities[0], Path::new("/home/me/.ssh/id_ed25519"));
        assert_eq!(defaults.known_hosts[0], Path::new("/home/me/.ssh/known_hosts"));
    }
}
