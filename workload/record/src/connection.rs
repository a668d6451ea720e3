//! How a host is reached, as the matrix file has it in `connect:` and a manifest keeps it. The main type is [`Connection`].

use std::{
    fmt,
    path::{Path, PathBuf},
    str::FromStr,
};

use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{self, value::MapAccessDeserializer},
    ser::SerializeMap as _,
};

pub use self::slurm::{Nodes, Slurm, Submit};

mod slurm;

/// How a host is reached.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum Connection {
    /// It is this machine.
    #[default]
    Local,
    /// Over SSH.
    Ssh(Ssh),
    /// It is any node that a Slurm cluster gives.
    Slurm(Box<Slurm>),
}

impl Connection {
    /// Takes the files that it names from a folder, that of the matrix file, where they are not named from the root or from
    /// the user's home.
    pub fn name_files_from(&mut self, folder: &Path) {
        let ssh = match self {
            Self::Local => return,
            Self::Ssh(ssh) => ssh,
            Self::Slurm(slurm) => return slurm.submit.name_files_from(folder),
        };
        for named in [&mut ssh.identity, &mut ssh.known_hosts] {
            if let Some(path) = named.as_mut().filter(|path| !path.starts_with("~")) {
                *path = folder.join(&*path);
            }
        }
    }
}

/// What a connection over SSH needs to know.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Ssh {
    /// Where to, as `user@host:port`.
    #[serde(rename = "ssh")]
    pub address: SshAddress,
    /// The private key's file, from the matrix file's folder; the agent's keys when left out.
    #[serde(default)]
    pub identity: Option<PathBuf>,
    /// A host to go through.
    #[serde(default)]
    pub jump: Option<SshAddress>,
    /// The file with the host's key, from the matrix file's folder; those that `ssh` looks into when left out.
    #[serde(default)]
    pub known_hosts: Option<PathBuf>,
}

/// `user@host:port`, user and port optional, an IPv6 address in brackets.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SshAddress {
    /// Who to be there.
    pub user: Option<String>,
    /// The host's name or address.
    pub host: String,
    /// The port, 22 when left out.
    pub port: Option<u16>,
}

/// Why a text is no SSH address. `what is wrong: what to write`, as all errors of values are.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is not an SSH address, {why}: write `user@host` or `user@host:port`")]
pub struct SshAddressError {
    text: String,
    why: &'static str,
}

impl FromStr for SshAddress {
    type Err = SshAddressError;

    fn from_str(text: &str) -> Result<Self, SshAddressError> {
        let error = |why| SshAddressError {
            text: text.to_owned(),
            why,
        };
        // Words end up as arguments of `ssh`: one that begins with a dash would be an option.
        let word = |word: &str| {
            !word.is_empty()
                && !word.starts_with('-')
                && word
                    .chars()
                    .all(|c| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-'))
        };
        let rest = text.strip_prefix("ssh://").unwrap_or(text);
        let (user, rest) = rest
            .rsplit_once('@')
            .map_or((None, rest), |(user, rest)| (Some(user), rest));
        if user.is_some_and(|user| !word(user)) {
            return Err(error("for its user is not a word"));
        }
        let (host, port) = match rest.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
            Some((address, after)) => {
                address
                    .parse::<std::net::Ipv6Addr>()
                    .map_err(|_| error("for there is no IPv6 address in the brackets"))?;
                let port = if after.is_empty() {
                    None
                } else {
                    Some(after.strip_prefix(':').unwrap_or(""))
                };
                (address, port)
            }
            None => {
                let (host, port) = rest
                    .split_once(':')
                    .map_or((rest, None), |(host, port)| (host, Some(port)));
                if !word(host) {
                    return Err(error("for its host is not a name"));
                }
                (host, port)
            }
        };
        let port = match port.map(str::parse::<u16>) {
            None => None,
            Some(Ok(port)) if port != 0 => Some(port),
            Some(_) => return Err(error("for its port is not a number from 1 to 65535")),
        };
        Ok(Self {
            user: user.map(str::to_owned),
            host: host.to_owned(),
            port,
        })
    }
}

impl fmt::Display for SshAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(user) = &self.user {
            write!(f, "{user}@")?;
        }
        if self.host.contains(':') {
            write!(f, "[{}]", self.host)?;
        } else {
            write!(f, "{}", self.host)?;
        }
        self.port.map_or(Ok(()), |port| write!(f, ":{port}"))
    }
}

impl<'de> Deserialize<'de> for SshAddress {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?
            .parse()
            .map_err(de::Error::custom)
    }
}

impl Serialize for SshAddress {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for SshAddress {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "SshAddress".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({
            "type": "string",
            "description": "`user@host:port`; user and port may be left out",
            "pattern": r"^(ssh://)?([A-Za-z0-9._][A-Za-z0-9._-]*@)?([A-Za-z0-9._][A-Za-z0-9._-]*|\[[0-9a-fA-F:.]+\])(:[0-9]+)?$",
            "examples": ["ubuntu@lab1.example.org:22"],
        })
    }
}

/// A connection as a mapping.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    ssh: Option<SshAddress>,
    identity: Option<PathBuf>,
    jump: Option<SshAddress>,
    known_hosts: Option<PathBuf>,
    slurm: Option<Box<Slurm>>,
}

impl Written {
    fn connection<E: de::Error>(self) -> Result<Connection, E> {
        let has_keys_of_ssh = self.identity.is_some() || self.jump.is_some() || self.known_hosts.is_some();
        match (self.ssh, self.slurm) {
            (Some(address), None) => Ok(Connection::Ssh(Ssh {
                address,
                identity: self.identity,
                jump: self.jump,
                known_hosts: self.known_hosts,
            })),
            (None, Some(slurm)) if !has_keys_of_ssh => Ok(Connection::Slurm(slurm)),
            (None, Some(_)) => Err(E::custom(
                "`identity`, `jump` and `known_hosts` are the submit host's: write them below `slurm.submit`",
            )),
            (Some(_), Some(_)) => Err(E::custom(
                "a host is reached in one way: write either `ssh` or `slurm`, and a submit host as `{slurm: {submit: {ssh: \
                 user@host}}}`",
            )),
            // As of any key that must be there: whoever left out a wrong one has told of it.
            (None, None) => Err(E::missing_field("ssh")),
        }
    }
}

impl<'de> Deserialize<'de> for Connection {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl<'de> de::Visitor<'de> for Visitor {
            type Value = Connection;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("`local`, `{ssh: user@host}` or `{slurm: {}}`")
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<Connection, E> {
                match text {
                    "local" => Ok(Connection::Local),
                    address if address.contains('@') => Err(E::custom(format_args!(
                        "an address stands here without the way to it: write `{{ssh: {address}}}`"
                    ))),
                    other => Err(E::custom(format_args!(
                        "`{other}` is no way to reach a host: write `local`, `{{ssh: user@host}}` or `{{slurm: {{}}}}`"
                    ))),
                }
            }

            fn visit_unit<E: de::Error>(self) -> Result<Connection, E> {
                Ok(Connection::Local)
            }

            fn visit_map<A: de::MapAccess<'de>>(self, map: A) -> Result<Connection, A::Error> {
                Written::deserialize(MapAccessDeserializer::new(map))?.connection()
            }
        }
        deserializer.deserialize_any(Visitor)
    }
}

/// As it is written in a file.
impl Serialize for Connection {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Local => serializer.serialize_str("local"),
            Self::Ssh(ssh) => ssh.serialize(serializer),
            Self::Slurm(slurm) => {
                let mut map = serializer.serialize_map(Some(1))?;
                map.serialize_entry("slurm", slurm)?;
                map.end()
            }
        }
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for Connection {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Connection".into()
    }

    fn json_schema(generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
        let ssh = generator.subschema_for::<Ssh>();
        let slurm = generator.subschema_for::<Slurm>();
        schemars::json_schema!({
            "description": "`local` for this machine, how to reach it over SSH, or how a Slurm cluster gives one",
            "anyOf": [
                { "const": "local" },
                ssh,
                {
                    "type": "object",
                    "description": "a node that a Slurm cluster gives; each scenario is a job",
                    "properties": { "slurm": slurm },
                    "required": ["slurm"],
                    "additionalProperties": false,
                },
            ],
        })
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    #[rstest]
    #[case("ubuntu@lab1:2222", Some("ubuntu"), "lab1", Some(2222))]
    #[case("lab1.example.org", None, "lab1.example.org", None)]
    #[case("ssh://me@10.0.0.7", Some("me"), "10.0.0.7", None)]
    #[case("me@[fe80::1]:22", Some("me"), "fe80::1", Some(22))]
    fn an_address_is_taken_apart(
        #[case] text: &str,
        #[case] user: Option<&str>,
        #[case] host: &str,
        #[case] port: Option<u16>,
    ) {
        let address: SshAddress = text.parse().unwrap();
        assert_eq!(
            (address.user.as_deref(), address.host.as_str(), address.port),
            (user, host, port)
        );
        assert_eq!(address.to_string(), text.trim_start_matches("ssh://"));
    }

    #[rstest]
    #[case("keys/lab", "/lab/keys/lab")]
    #[case("../lab", "/lab/../lab")]
    #[case("/etc/lab", "/etc/lab")]
    #[case("~/.ssh/lab", "~/.ssh/lab")]
    fn a_file_is_named_from_the_matrix_files_folder(#[case] named: &str, #[case] means: &str) {
        let mut connection = Connection::Ssh(Ssh {
            address: "lab1".parse().unwrap(),
            identity: Some(named.into()),
            jump: None,
            known_hosts: Some(named.into()),
        });
        connection.name_files_from(Path::new("/lab"));
        let Connection::Ssh(ssh) = connection else {
            unreachable!()
        };
        assert_eq!(
            (ssh.identity, ssh.known_hosts),
            (Some(means.into()), Some(means.into()))
        );
    }

    #[rstest]
    #[case("")]
    #[case("me@")]
    #[case("me@host:0")]
    #[case("me@host:port")]
    #[case("me@host:70000")]
    #[case("-oProxyCommand=x@host")]
    #[case("me@-oProxyCommand=x")]
    #[case("a b@host")]
    #[case("[fe80::1")]
    #[case("[::1]22")]
    fn what_is_no_address_is_refused(#[case] text: &str) {
        assert!(text.parse::<SshAddress>().is_err());
    }
}
