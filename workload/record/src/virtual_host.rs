//! The three hosts of the experiment's own network, as the paper names them. The main type is [`VirtualHost`].

use std::{fmt, net::Ipv4Addr};

use serde::{Deserialize, Serialize};

/// A host of the experiment's own network (not a machine that runs it).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum VirtualHost {
    /// Runs the ROS master.
    H1,
    /// Runs the controller.
    Sta1,
    /// Runs the plant.
    Sta2,
}

impl VirtualHost {
    /// All of them, in the order of their switch ports.
    pub const ALL: [Self; 3] = [Self::H1, Self::Sta1, Self::Sta2];

    /// Its name, which is also the name of its capture.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::H1 => "h1",
            Self::Sta1 => "sta1",
            Self::Sta2 => "sta2",
        }
    }

    /// Position among [`Self::ALL`], from 0; also its switch port.
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Its address, numbered from 10.0.0.1 as Mininet does; the network is 10.0.0.0/8.
    #[must_use]
    pub const fn address(self) -> Ipv4Addr {
        Ipv4Addr::new(10, 0, 0, self as u8 + 1)
    }

    /// Its hardware address, as Mininet gives with `autoSetMacs`: 00:00:00:00:00:01 and up.
    #[must_use]
    pub const fn mac(self) -> [u8; 6] {
        [0, 0, 0, 0, 0, self as u8 + 1]
    }

    /// The name of its one network interface, as Mininet names it.
    #[must_use]
    pub fn interface(self) -> String {
        format!("{}-eth0", self.name())
    }
}

impl fmt::Display for VirtualHost {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}
