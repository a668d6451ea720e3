//! The `userspace` network: a namespace and a TAP device for each host, links and switch in this process. The main
//! type is [`Userspace`].

use std::io;

use record::{settings::NetworkSettings, virtual_host::VirtualHost, window::LinkRecord};
use simulation::link::Impairment;

use super::{
    backend::Network,
    device::{self, Interface, Tap},
    emulator::Emulator,
    error::NetworkError,
    namespace::{Namespace, Work},
    release_lateness::ReleaseCounts,
    star::Star,
};

/// A network that is up until it is dropped.
#[derive(Debug)]
pub struct Userspace {
    // Before the namespaces, so that the devices are closed while their namespaces still exist.
    emulator: Emulator,
    namespaces: [Namespace; 3],
    seed: u64,
}

impl Userspace {
    /// Makes the namespaces and devices and starts the emulator.
    ///
    /// # Errors
    /// If the platform does not offer what it needs.
    pub fn open(settings: &NetworkSettings, seed: u64, emulator_priority: u8) -> Result<Self, NetworkError> {
        let (h1, h1_tap) = make_host(VirtualHost::H1)?;
        let (sta1, sta1_tap) = make_host(VirtualHost::Sta1)?;
        let (sta2, sta2_tap) = make_host(VirtualHost::Sta2)?;
        let emulator = Emulator::start(
            [h1_tap, sta1_tap, sta2_tap],
            Star::new(Impairment::NONE, seed),
            Impairment::from(settings),
            emulator_priority,
        )?;
        Ok(Self {
            emulator,
            namespaces: [h1, sta1, sta2],
            seed,
        })
    }
}

impl Network for Userspace {
    fn enter(&self, host: VirtualHost) -> Result<(), NetworkError> {
        self.namespaces[host.index()].enter()
    }

    fn give(&self, host: VirtualHost, work: Work) -> io::Result<()> {
        self.namespaces[host.index()].give(work)
    }

    fn interface(&self, host: VirtualHost) -> String {
        host.interface()
    }

    fn impair(&self) -> Result<(), NetworkError> {
        self.emulator.impair();
        Ok(())
    }

    fn links(&self) -> Vec<LinkRecord> {
        self.emulator.links().to_vec()
    }

    fn seed(&self) -> Option<u64> {
        Some(self.seed)
    }

    fn release_lateness(&self) -> Option<ReleaseCounts> {
        Some(self.emulator.release_lateness())
    }

    fn failure(&self) -> Option<NetworkError> {
        self.emulator.failure()
    }
}

/// Makes one host and drops it.
///
/// # Errors
/// What is missing.
pub fn survey() -> Result<(), NetworkError> {
    make_host(VirtualHost::H1).map(drop)
}

/// The host's namespace and its device, which is up and knows the other hosts.
fn make_host(host: VirtualHost) -> Result<(Namespace, Tap), NetworkError> {
    let namespace = Namespace::create()?;
    let tap = namespace.within(move || {
        let interface = Interface::of(host);
        let tap = Tap::create(&interface.name)?;
        let neighbours: Vec<_> = VirtualHost::ALL
            .into_iter()
            .filter(|other| *other != host)
            .map(Interface::of)
            .collect();
        device::configure(&interface, &neighbours)?;
        Ok(tap)
    })?;
    Ok((namespace, tap))
}
