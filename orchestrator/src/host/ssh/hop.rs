//! Where a host over SSH is, and through which others. The main type is [`Hop`]; [`route`] finds those of a connection.

use std::{
    path::{Path, PathBuf},
    sync::{Arc, OnceLock},
};

use record::connection::{Ssh, SshAddress, SshAddressError};

use super::{SshError, configuration::SshClient};

const SSH_PORT: u16 = 22;
/// More of them are a circle.
const MOST_JUMPS: usize = 8;

/// By what a host is known to be the one that is meant.
#[derive(Debug, Clone)]
pub enum Trust {
    /// Its key is in one of the files that `ssh` would look into, or in the one that the matrix file names. Anything else
    /// is refused.
    KnownHosts,
    /// We have just made the machine, and nobody can know its key: the first that answers is believed, and held to its
    /// key from then on. Whoever can answer in its place, which on a virtual network of this machine takes root here, is
    /// believed as well: for machines of that kind only.
    MadeByUs,
}

/// The keys that a host may have.
#[derive(Debug, Clone)]
pub enum HostKeys {
    /// Those in these files.
    Known(Vec<PathBuf>),
    /// The first that it shows.
    FirstSeen(Arc<OnceLock<Vec<u8>>>),
}

/// One host on the way.
#[derive(Debug, Clone)]
pub struct Hop {
    /// Its name or address.
    pub host: String,
    /// Its port.
    pub port: u16,
    /// The name that its key is known by, if that is another.
    pub alias: Option<String>,
    /// Who to be there.
    pub user: String,
    /// Private keys to try.
    pub identities: Vec<PathBuf>,
    /// The agent to ask before.
    pub agent: Option<PathBuf>,
    /// What its key may be.
    pub host_keys: HostKeys,
    /// Whether it is reached through another, so that `ssh-keyscan` does not reach it.
    pub behind_another: bool,
}

impl Hop {
    /// `host:port`, for people.
    #[must_use]
    pub fn place(&self) -> String {
        if self.host.contains(':') {
            format!("[{}]:{}", self.host, self.port)
        } else {
            format!("{}:{}", self.host, self.port)
        }
    }
}

/// The hosts on the way, the last of which is the one that is meant.
///
/// # Errors
/// When `ssh` does not understand its configuration, or the way is one that is not gone here.
pub fn route(ssh: &Ssh, trust: &Trust, client: &SshClient) -> Result<Vec<Hop>, SshError> {
    let mut hops = Vec::new();
    add(&ssh.address, ssh.jump.as_ref(), client, 0, &mut hops)?;
    let behind_others = hops.len() > 1;
    let identity = ssh
        .identity
        .as_ref()
        .map(|path| client.expanded(&path.to_string_lossy()));
    let known_hosts = ssh
        .known_hosts
        .as_ref()
        .map(|path| client.expanded(&path.to_string_lossy()));
    let last = hops.pop();
    // What the matrix file names is all that counts for the host itself, and one more to try for those on the way.
    for hop in &mut hops {
        hop.identities.extend(identity.clone());
        if let HostKeys::Known(files) = &mut hop.host_keys {
            files.extend(known_hosts.clone());
        }
    }
    if let Some(mut hop) = last {
        hop.behind_another = behind_others;
        if let Some(identity) = identity {
            hop.identities = vec![identity];
        }
        match (trust, known_hosts) {
            (Trust::MadeByUs, _) => hop.host_keys = HostKeys::FirstSeen(Arc::default()),
            (Trust::KnownHosts, Some(file)) => hop.host_keys = HostKeys::Known(vec![file]),
            (Trust::KnownHosts, None) => {}
        }
        hops.push(hop);
    }
    Ok(hops)
}

/// Adds a host after those through which it is reached. So many are waiting for it already.
fn add(
    address: &SshAddress,
    jump: Option<&SshAddress>,
    client: &SshClient,
    waiting: usize,
    hops: &mut Vec<Hop>,
) -> Result<(), SshError> {
    let host = &address.host;
    if waiting.max(hops.len()) > MOST_JUMPS {
        return Err(SshError::TooManyJumps {
            host: host.clone(),
            most: MOST_JUMPS,
        });
    }
    let answer = client.look_up(address)?;
    let jumps = match jump {
        Some(jump) => vec![jump.clone()],
        // A host on the way that is not understood must not be left out.
        None => answer
            .jumps
            .iter()
            .map(|jump| address_of_jump(jump))
            .collect::<Result<_, _>>()
            .map_err(|error| SshError::Configuration {
                host: host.clone(),
                said: error.to_string(),
            })?,
    };
    if jumps.is_empty() && answer.has_proxy_command {
        return Err(SshError::ProxyCommand { host: host.clone() });
    }
    for jump in &jumps {
        add(jump, None, client, waiting + 1, hops)?;
    }
    let user = address
        .user
        .clone()
        .or(answer.user)
        .or_else(|| client.user.clone());
    hops.push(Hop {
        host: answer.host.unwrap_or_else(|| host.clone()),
        port: address.port.or(answer.port).unwrap_or(SSH_PORT),
        alias: answer.alias,
        user: user.ok_or_else(|| SshError::NoUser { host: host.clone() })?,
        identities: answer
            .identities
            .into_iter()
            .filter(|path| is_ours_to_use(path))
            .collect(),
        agent: answer.agent,
        host_keys: HostKeys::Known(answer.known_hosts),
        behind_another: !jumps.is_empty(),
    });
    Ok(())
}

/// Of a host on the way `ssh -G` prints any host with a port in brackets.
fn address_of_jump(text: &str) -> Result<SshAddress, SshAddressError> {
    let brackets = ['[', ']'];
    let parts: Vec<&str> = text.split(brackets).collect();
    match parts.as_slice() {
        [before, host, after] if !host.contains(':') => format!("{before}{host}{after}").parse(),
        _ => text.parse(),
    }
}

/// A key that is there and needs no device.
fn is_ours_to_use(identity: &Path) -> bool {
    let with_a_device = identity
        .file_name()
        .is_some_and(|name| name.to_string_lossy().ends_with("_sk"));
    !with_a_device && identity.is_file()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    /// The way to `lab` by this configuration, in words.
    fn way(configuration: &str, ssh: &str) -> Result<Vec<String>, String> {
        let home = tempfile::tempdir().unwrap();
        let file = home.path().join("config");
        // `ssh` knows another home than the client of this test.
        let configuration = configuration.replace("HOME", home.path().to_str().unwrap());
        fs::write(&file, configuration).unwrap();
        for key in ["id_of_lab", "id_sk"] {
            fs::write(home.path().join(key), "a key").unwrap();
        }
        let client = SshClient {
            home: Some(home.path().to_owned()),
            configuration: Some(file),
            ..SshClient::default()
        };
        let ssh: Ssh = serde_yaml::from_str(ssh).unwrap();
        let hops = route(&ssh, &Trust::KnownHosts, &client).map_err(|error| error.to_string())?;
        let relative = |paths: &[PathBuf]| {
            let paths = paths
                .iter()
                .filter_map(|path| path.strip_prefix(home.path()).ok());
            paths
                .map(|path| path.display().to_string())
                .collect::<Vec<_>>()
                .join(" ")
        };
        let words = |hop: &Hop| {
            let HostKeys::Known(files) = &hop.host_keys else {
                return String::new();
            };
            format!(
                "{} {} [{}] [{}]",
                hop.user,
                hop.place(),
                relative(&hop.identities),
                relative(files)
            )
        };
        Ok(hops.iter().map(words).collect())
    }

    const LAB: &str = "Host lab\n HostName 10.0.0.7\n Port 2222\n User me\n IdentityFile ~/id_of_lab\n \
                       IdentityFile ~/id_sk\n IdentityFile ~/id_missing\n UserKnownHostsFile HOME/known HOME/more\n";

    #[test]
    fn a_name_means_what_the_configuration_says() {
        let known = "[id_of_lab] [known more]";
        assert_eq!(
            way(LAB, "ssh: lab"),
            Ok(vec![format!("me 10.0.0.7:2222 {known}")])
        );
        assert_eq!(
            way(LAB, "ssh: you@lab:22"),
            Ok(vec![format!("you 10.0.0.7:22 {known}")])
        );
    }

    #[test]
    fn the_matrix_file_comes_before_the_configuration() {
        let ssh = "{ssh: lab, identity: ~/mine, known_hosts: ~/theirs}";
        assert_eq!(
            way(LAB, ssh),
            Ok(vec!["me 10.0.0.7:2222 [mine] [theirs]".to_owned()])
        );
    }

    #[test]
    fn hosts_on_the_way_are_looked_up_as_well() {
        let configuration = format!(
            "{LAB} ProxyJump b\nHost a\n HostName 10.0.0.1\n User a\nHost b\n User b\n ProxyJump a,c@127.0.0.1:7\n"
        );
        let way = |ssh| way(&configuration, ssh).unwrap();
        let places = |way: Vec<String>| {
            way.iter()
                .map(|hop| hop.split(" [").next().unwrap().to_owned())
                .collect::<Vec<_>>()
        };
        assert_eq!(
            places(way("ssh: lab")),
            ["a 10.0.0.1:22", "c 127.0.0.1:7", "b b:22", "me 10.0.0.7:2222"]
        );
        assert_eq!(
            places(way("{ssh: lab, jump: a}")),
            ["a 10.0.0.1:22", "me 10.0.0.7:2222"]
        );
    }

    #[test]
    fn hosts_that_are_reached_through_each_other_are_refused() {
        let configuration = "Host a\n ProxyJump b\nHost b\n ProxyJump a\n";
        let refused = way(configuration, "ssh: me@a").unwrap_err();
        assert!(refused.contains("goes through more than 8 hosts"), "{refused}");
    }

    #[test]
    fn a_proxy_command_is_refused_unless_a_jump_replaces_it() {
        let configuration = "Host a\n ProxyCommand nc %h %p\n";
        let refused = way(configuration, "ssh: me@a").unwrap_err();
        assert!(refused.contains("ProxyCommand"), "{refused}");
        assert_eq!(way(configuration, "{ssh: me@a, jump: you@b}").unwrap().len(), 2);
    }
}
