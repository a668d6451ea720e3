//! The hosts of an emulated network. The main type is [`VirtualHost`].

use std::{fmt, str::FromStr};

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as _};

/// The longest name: its interface `NAME-eth0` has 15 bytes then, the most that the kernel takes.
const LONGEST: usize = 10;

/// A host of an emulated network, by its name (not a machine that runs it).
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct VirtualHost {
    /// Zeros follow the name.
    bytes: [u8; LONGEST],
}

/// A text that cannot be the name of a virtual host, nor of a switch or a node, whose names are of the same kind.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` cannot be the name of a virtual host, a switch or a node: write at most {LONGEST} lower-case letters, digits and `-`, \
     a letter first"
)]
pub struct NotAVirtualHost(String);

impl VirtualHost {
    /// Of the ball on the plate: runs the ROS master.
    pub const H1: Self = Self::constant(b"h1");
    /// Of the ball on the plate: runs the controller.
    pub const STA1: Self = Self::constant(b"sta1");
    /// Of the ball on the plate: runs the plant.
    pub const STA2: Self = Self::constant(b"sta2");
    /// The switch that there is if none is named, as Mininet names its first.
    pub const S1: Self = Self::constant(b"s1");
    /// Those of the ball on the plate, which the paper names so, in the order of their switch ports.
    pub const OF_THE_BALL: [Self; 3] = [Self::H1, Self::STA1, Self::STA2];

    const fn constant(name: &[u8]) -> Self {
        let mut bytes = [0; LONGEST];
        let mut at = 0;
        while at < name.len() {
            bytes[at] = name[at];
            at += 1;
        }
        Self { bytes }
    }

    /// Its name, which is also the name of its capture.
    #[must_use]
    pub fn name(&self) -> &str {
        let end = self.bytes.iter().position(|byte| *byte == 0).unwrap_or(LONGEST);
        // Whatever made it has seen to it that it is ASCII.
        std::str::from_utf8(self.bytes.get(..end).unwrap_or_default()).unwrap_or_default()
    }

    /// The name of its one network interface, as Mininet names it.
    #[must_use]
    pub fn interface(&self) -> String {
        format!("{}-eth0", self.name())
    }
}

impl FromStr for VirtualHost {
    type Err = NotAVirtualHost;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let plain = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'-';
        let begins = text
            .bytes()
            .next()
            .is_some_and(|first| first.is_ascii_lowercase());
        match begins && text.len() <= LONGEST && text.bytes().all(plain) {
            true => Ok(Self::constant(text.as_bytes())),
            false => Err(NotAVirtualHost(text.chars().take(40).collect())),
        }
    }
}

impl fmt::Display for VirtualHost {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl fmt::Debug for VirtualHost {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl Serialize for VirtualHost {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(self.name())
    }
}

impl<'de> Deserialize<'de> for VirtualHost {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        String::deserialize(from)?.parse().map_err(D::Error::custom)
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for VirtualHost {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "VirtualHost".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({"type": "string", "pattern": "^[a-z][a-z0-9-]{0,9}$"})
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    #[test]
    fn the_hosts_of_the_ball_have_the_papers_names() {
        assert_eq!(
            VirtualHost::OF_THE_BALL.map(|host| host.to_string()),
            ["h1", "sta1", "sta2"]
        );
        assert_eq!(VirtualHost::STA1.interface(), "sta1-eth0");
        assert_eq!("sta2".parse(), Ok(VirtualHost::STA2));
    }

    #[rstest]
    #[case("a", true)]
    #[case("arm-left-1", true)]
    #[case("arm-left-10", false)]
    #[case("", false)]
    #[case("1h", false)]
    #[case("-h", false)]
    #[case("H1", false)]
    #[case("h.1", false)]
    #[case("h\x001", false)]
    #[case("é", false)]
    fn a_name_makes_an_interface_a_file_and_a_word_of_a_command(#[case] name: &str, #[case] is_one: bool) {
        assert_eq!(name.parse::<VirtualHost>().is_ok(), is_one);
        let read = serde_json::from_value::<VirtualHost>(name.into());
        assert!(read.map_or(!is_one, |host| is_one && host.name() == name));
    }
}
