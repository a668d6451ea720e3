//! What `vagrant ssh-config` says of the way into a machine. The main type is [`SshConfig`].

use std::path::PathBuf;

use record::connection::SshAddress;

/// The way into a machine, as its host knows it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SshConfig {
    /// Where it is, and who to be there.
    pub address: SshAddress,
    /// Files of private keys on the host, one of which lets in: Vagrant has several that everybody has.
    pub identities: Vec<PathBuf>,
}

/// Reads what was printed; `None` where the way is not all there.
#[must_use]
pub fn read(printed: &str) -> Option<SshConfig> {
    let values = |wanted: &'static str| {
        printed.lines().filter_map(move |line| {
            let (key, value) = line.trim().split_once(char::is_whitespace)?;
            // A path with spaces is in quotes.
            key.eq_ignore_ascii_case(wanted)
                .then(|| value.trim().trim_matches('"').to_owned())
        })
    };
    let value = |wanted| values(wanted).next();
    let identities: Vec<PathBuf> = values("IdentityFile").map(PathBuf::from).collect();
    if identities.is_empty() {
        return None;
    }
    Some(SshConfig {
        address: SshAddress {
            user: value("User"),
            host: value("HostName")?,
            port: value("Port").and_then(|port| port.parse().ok()),
        },
        identities,
    })
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    /// As Vagrant 2.3.4 printed it for libvirt.
    const LIBVIRT: &str = "\
Host machine
  HostName 192.168.121.237
  User vagrant
  Port 22
  UserKnownHostsFile /dev/null
  StrictHostKeyChecking no
  PasswordAuthentication no
  IdentityFile /state/machines/a/.vagrant/machines/machine/libvirt/private_key
  IdentitiesOnly yes
  LogLevel FATAL
";

    #[test]
    fn the_way_in_is_read() {
        let config = read(LIBVIRT).unwrap();
        assert_eq!(config.address.to_string(), "vagrant@192.168.121.237:22");
        assert_eq!(
            config.identities,
            [Path::new(
                "/state/machines/a/.vagrant/machines/machine/libvirt/private_key"
            )]
        );
    }

    #[test]
    fn a_path_with_spaces_is_read_without_its_quotes() {
        let config =
            read("Host m\n  HostName 127.0.0.1\n  Port 2222\n  IdentityFile \"/a b/key\"\n").unwrap();
        assert_eq!(config.identities, [Path::new("/a b/key")]);
        assert_eq!(config.address.to_string(), "127.0.0.1:2222");
    }

    /// As Vagrant 2.3.8 prints them where it puts in no key of its own.
    #[test]
    fn every_key_is_read() {
        let printed = "Host m\n  HostName 127.0.0.1\n  IdentityFile /keys/vagrant.key.ed25519\n  IdentityFile \
                       /keys/vagrant.key.rsa\n";
        assert_eq!(
            read(printed).unwrap().identities,
            [
                Path::new("/keys/vagrant.key.ed25519"),
                Path::new("/keys/vagrant.key.rsa")
            ]
        );
    }

    #[test]
    fn a_machine_without_an_address_has_no_way_in() {
        assert_eq!(read(""), None);
        assert_eq!(read("Host m\n  HostName 127.0.0.1\n"), None);
    }
}
