//! The `userspace` network: a namespace and a TAP device for each host, links and switch in this process. The main
//! type is [`Userspace`].

use record::{settings::NetworkSettings, topology::Topology, window::LinkRecord};

use super::{
    backend::Network,
    device::{self, Interface, Tap},
    emulator::Emulator,
    error::NetworkError,
    fabric::Fabric,
    namespace::{Namespace, Namespaces},
    release_lateness::ReleaseCounts,
};

/// A network that is up until it is dropped.
#[derive(Debug)]
pub struct Userspace {
    // Before the namespaces, so that the devices are closed while their namespaces still exist.
    emulator: Emulator,
    namespaces: Namespaces,
    topology: Topology,
    seed: u64,
}

impl Userspace {
    /// Makes the namespaces and devices and starts the emulator.
    ///
    /// # Errors
    /// If the platform does not offer what it needs.
    pub fn open(settings: &NetworkSettings, seed: u64, emulator_priority: u8) -> Result<Self, NetworkError> {
        let topology = settings.topology();
        let made = (0..topology.hosts.len()).map(|position| make_host(&topology, position));
        let (namespaces, taps): (Vec<_>, Vec<_>) = made.collect::<Result<Vec<_>, _>>()?.into_iter().unzip();
        let fabric = Fabric::new(&topology, seed);
        Ok(Self {
            emulator: Emulator::start(taps, fabric, emulator_priority)?,
            namespaces: Namespaces::of(&topology, namespaces),
            topology,
            seed,
        })
    }
}

impl Network for Userspace {
    fn topology(&self) -> &Topology {
        &self.topology
    }

    fn namespaces(&self) -> &Namespaces {
        &self.namespaces
    }

    fn impair(&self) -> Result<(), NetworkError> {
        self.emulator.impair();
        Ok(())
    }

    fn links(&self) -> Vec<LinkRecord> {
        self.emulator.links()
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
pub fn survey(settings: &NetworkSettings) -> Result<(), NetworkError> {
    make_host(&settings.topology(), 0).map(drop)
}

/// The host's namespace and its device, which is up and knows the other hosts.
fn make_host(topology: &Topology, position: usize) -> Result<(Namespace, Tap), NetworkError> {
    let namespace = Namespace::create()?;
    let (interface, neighbours) = Interface::and_neighbours(topology, position)?;
    let tap = namespace.within(move || {
        let tap = Tap::create(&interface.name)?;
        device::configure(&interface, &neighbours)?;
        Ok(tap)
    })?;
    Ok((namespace, tap))
}
