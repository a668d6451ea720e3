//! Every provider in one row. The main types are [`ProviderKind`], a row, and [`Catalogue`], the rows of one program.
//!
//! From the rows follow the values of the axis `virtualization`, the matrix file's schema, the proposals in messages, what
//! `matrix clean` asks, the columns of `matrix doctor`, and which scenarios are simulated. Another program has rows of its
//! own beside the built-in ones: [`crate::main_with`].

use std::{collections::BTreeSet, sync::Arc};

use record::axis::SIMULATED;
use serde_json::{Map, Value};

use super::{
    Provider, ProviderError,
    asked_right::AskedRight,
    docker::Docker,
    fake::Fake,
    jobs::{JobWorkload, Jobs},
    native::Native,
    settings::ProviderSettings,
    simulated::Simulated,
    vagrant::{
        Vagrant, VagrantSettings,
        kind::{Requirement, VagrantKind},
        options::{self, Allowed},
    },
};
use crate::{batch::Clusters, host::Host, state_directory::StateDirectory};

/// The providers of this crate, in the order of messages and of the schema.
static BUILT_IN: &[ProviderKind] = &[
    ProviderKind {
        as_job: Some(|_| JobWorkload::Process),
        ..ProviderKind::new("native", |making| {
            Ok(Box::new(Native::new(Arc::clone(making.host))))
        })
    },
    ProviderKind {
        column: true,
        as_job: Some(|settings| JobWorkload::Container(Box::new(settings.docker.clone()))),
        rights: |settings| settings.docker.asked_rights(),
        ..ProviderKind::new("docker", |making| {
            Ok(Box::new(Docker::on(making.host, making.settings.docker.clone())))
        })
    },
    of_vagrant(
        "libvirt",
        VagrantKind {
            settings: |settings| &settings.libvirt,
            requirement: Requirement {
                plugin: Some("vagrant-libvirt"),
                probe: Some(("virsh", &["--connect", "qemu:///system", "version"])),
                fix: "on Debian: apt-get install vagrant-libvirt libvirt-daemon-system libvirt-clients, and be in the group \
                      libvirt",
            },
            options: options::LIBVIRT,
        },
    ),
    of_vagrant(
        "virtualbox",
        VagrantKind {
            settings: |settings| &settings.virtualbox,
            requirement: Requirement {
                plugin: None,
                probe: Some(("VBoxManage", &["--version"])),
                fix: "install VirtualBox, https://www.virtualbox.org/wiki/Linux_Downloads",
            },
            options: options::VIRTUALBOX,
        },
    ),
    of_vagrant(
        "vmware_desktop",
        VagrantKind {
            settings: |settings| &settings.vmware_desktop,
            requirement: Requirement::plugin(
                "vagrant-vmware-desktop",
                "vagrant plugin install vagrant-vmware-desktop",
            ),
            options: options::VMWARE_DESKTOP,
        },
    ),
    of_vagrant(
        "parallels",
        VagrantKind {
            settings: |settings| &settings.parallels,
            requirement: Requirement::plugin("vagrant-parallels", "vagrant plugin install vagrant-parallels"),
            options: options::PARALLELS,
        },
    ),
    of_vagrant(
        "hyperv",
        VagrantKind {
            settings: |settings| &settings.hyperv,
            requirement: Requirement {
                plugin: None,
                probe: Some(("powershell.exe", &["-NoProfile", "-Command", "Get-VMHost"])),
                fix: "Hyper-V is part of Windows alone",
            },
            options: options::HYPERV,
        },
    ),
    of_vagrant(
        "qemu",
        VagrantKind {
            settings: |settings| &settings.qemu,
            requirement: Requirement::plugin("vagrant-qemu", "vagrant plugin install vagrant-qemu"),
            options: options::QEMU,
        },
    ),
    ProviderKind {
        // The fake platform of every host is on this machine.
        hosts: Hosts::ThisMachine,
        simulated: true,
        ..ProviderKind::new("fake", |making| {
            Ok(Box::new(Fake::new(
                making.host.name(),
                making.settings.fake.clone(),
                making.state.clone(),
            )))
        })
    },
    ProviderKind {
        simulated: true,
        as_job: Some(|_| JobWorkload::Process),
        ..ProviderKind::new(SIMULATED, |making| {
            Ok(Box::new(Simulated::new(Arc::clone(making.host))))
        })
    },
];

/// What makes a provider for a host.
pub type Make = fn(&Making<'_>) -> Result<Box<dyn Provider>, ProviderError>;

/// What a provider is made of.
pub struct Making<'a> {
    /// Its row.
    pub kind: &'static ProviderKind,
    /// The host.
    pub host: &'a Arc<dyn Host>,
    /// The section `providers:` of the matrix file; the defaults where there is no file, as in `matrix clean`.
    pub settings: &'a ProviderSettings,
    /// Where this machine keeps what outlives this process.
    pub state: &'a StateDirectory,
}

impl Making<'_> {
    /// The section of a provider from outside this crate, as the matrix file has it; empty where the file has none.
    #[must_use]
    pub fn options(&self) -> Value {
        let options = self.settings.outside.get(self.kind.name);
        options.cloned().unwrap_or_else(|| Value::Object(Map::new()))
    }
}

/// Where leftovers of a provider can be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hosts {
    /// On the host of the scenario.
    All,
    /// On this machine, whichever the host of the scenario is.
    ThisMachine,
}

/// One provider.
#[derive(Debug, Clone, Copy)]
pub struct ProviderKind {
    /// The value of the axis `virtualization`, and the section below `providers:`. [`Provider::name`] is the same.
    pub name: &'static str,
    /// Makes it for a host. An error makes the scenarios on that host infeasible.
    pub make: Make,
    /// Where leftovers of it can be.
    pub hosts: Hosts,
    /// Whether its numbers are computed and not measured: reports then begin with that.
    pub simulated: bool,
    /// What a job of a batch system is to start, where its environments can be jobs. On a host that stands for a cluster's nodes
    /// others cannot be made.
    pub as_job: Option<fn(&ProviderSettings) -> JobWorkload>,
    /// The rights that its settings ask for, which `matrix plan` lists.
    pub rights: fn(&ProviderSettings) -> Vec<AskedRight>,
    /// Whether the table of hosts of `matrix doctor` has a column for it. Vagrant's providers share one.
    pub column: bool,
    /// What is wrong with its section below `providers:`, in words. Only asked of a provider from outside this crate whose
    /// section is there; the sections of built-in ones are read as [`ProviderSettings`].
    pub check: fn(&Value) -> Result<(), String>,
    /// What Vagrant's providers have besides; none of a provider from outside this crate.
    pub vagrant: Option<VagrantKind>,
}

impl ProviderKind {
    /// One that can be on every host, measures, asks for no rights, has no column and takes no settings.
    #[must_use]
    pub const fn new(name: &'static str, make: Make) -> Self {
        Self {
            name,
            make,
            hosts: Hosts::All,
            simulated: false,
            as_job: None,
            rights: |_| Vec::new(),
            column: false,
            check: no_settings,
            vagrant: None,
        }
    }

    /// The provider on a host.
    ///
    /// # Errors
    /// When it cannot be made with these settings.
    pub fn provider(
        &'static self,
        host: &Arc<dyn Host>,
        settings: &ProviderSettings,
        state: &StateDirectory,
        clusters: &Clusters,
    ) -> Result<Box<dyn Provider>, ProviderError> {
        let nodes = host.nodes().filter(|_| self.hosts == Hosts::All);
        match nodes.map(|nodes| (nodes, self.as_job)) {
            Some((nodes, Some(workload))) => {
                Ok(Box::new(Jobs::new(self.name, workload(settings), host, nodes, clusters)))
            }
            Some((_, None)) => Err(ProviderError::Unsupported {
                provider: self.name.to_owned(),
                reason: format!("no job of the cluster behind `{}` can make its machines", host.name()),
                hint: Some(
                    "measure `native` or `docker` there, and name a node that you can log in to as a host of its own for the others"
                        .to_owned(),
                ),
            }),
            None => (self.make)(&Making {
                kind: self,
                host,
                settings,
                state,
            }),
        }
    }
}

fn no_settings(options: &Value) -> Result<(), String> {
    match options.as_object().is_some_and(Map::is_empty) {
        true => Ok(()),
        false => Err("it has no settings".to_owned()),
    }
}

/// The row of a provider that Vagrant knows by this name.
const fn of_vagrant(name: &'static str, vagrant: VagrantKind) -> ProviderKind {
    ProviderKind {
        vagrant: Some(vagrant),
        ..ProviderKind::new(name, |making| {
            let Some(kind) = &making.kind.vagrant else {
                return Err(ProviderError::OutOfOrder {
                    reason: "a provider that Vagrant does not drive was made as one of its own",
                });
            };
            Ok(Box::new(Vagrant::new(
                making.kind.name,
                kind,
                Arc::clone(making.host),
                (kind.settings)(making.settings).clone(),
            )))
        })
    }
}

/// Two providers have one name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("two providers have the name `{name}`")]
pub struct NameTaken {
    /// The axis value that names the provider.
    pub name: &'static str,
}

impl NameTaken {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> String {
        "give the provider from outside another name".to_owned()
    }
}

/// The providers of one program: the built-in ones, and those from outside this crate that it was started with.
#[derive(Debug, Clone, Copy, Default)]
pub struct Catalogue {
    outside: &'static [ProviderKind],
}

/// Two are the same if they have the same names: a name is one provider.
impl PartialEq for Catalogue {
    fn eq(&self, other: &Self) -> bool {
        self.names().eq(other.names())
    }
}

impl Catalogue {
    /// The built-in providers and these.
    ///
    /// # Errors
    /// When two have the same name.
    pub fn with(outside: &'static [ProviderKind]) -> Result<Self, NameTaken> {
        let catalogue = Self { outside };
        let mut seen = BTreeSet::new();
        let taken = catalogue.names().find(|name| !seen.insert(*name));
        taken.map_or(Ok(catalogue), |name| Err(NameTaken { name }))
    }

    /// The rows, the built-in ones first.
    pub fn kinds(self) -> impl Iterator<Item = &'static ProviderKind> + Clone {
        BUILT_IN.iter().chain(self.outside)
    }

    /// The names: the values of the axis `virtualization`.
    pub fn names(self) -> impl Iterator<Item = &'static str> + Clone {
        self.kinds().map(|kind| kind.name)
    }

    /// The row of that name.
    #[must_use]
    pub fn kind(self, name: &str) -> Option<&'static ProviderKind> {
        self.kinds().find(|kind| kind.name == name)
    }

    /// The rows from outside this crate.
    #[must_use]
    pub const fn outside(self) -> &'static [ProviderKind] {
        self.outside
    }

    /// Whether a row of that name comes from outside this crate.
    #[must_use]
    pub fn is_from_outside(self, name: &str) -> bool {
        self.outside.iter().any(|kind| kind.name == name)
    }

    /// Whether the numbers of a `virtualization` are made up.
    #[must_use]
    pub fn is_simulated(self, virtualization: &str) -> bool {
        self.kind(virtualization).is_some_and(|kind| kind.simulated)
    }

    /// The settings of the providers that Vagrant drives, with their rows' names and what a file may set under `options`.
    pub fn of_vagrant(
        self,
        settings: &ProviderSettings,
    ) -> impl Iterator<Item = (&'static str, &VagrantSettings, Allowed)> {
        self.kinds().filter_map(move |kind| {
            let vagrant = kind.vagrant.as_ref()?;
            Some((kind.name, (vagrant.settings)(settings), vagrant.options))
        })
    }

    /// The section `providers:` out of a manifest.
    ///
    /// # Errors
    /// When it is of other providers, or of another version.
    pub fn settings_of(self, sections: Map<String, Value>) -> Result<ProviderSettings, serde_json::Error> {
        let (outside, built_in): (Map<String, Value>, Map<String, Value>) = sections
            .into_iter()
            .partition(|(name, _)| self.is_from_outside(name));
        Ok(ProviderSettings {
            outside: outside.into_iter().collect(),
            ..serde_json::from_value(Value::Object(built_in))?
        })
    }

    /// The provider of a `virtualization` on a host.
    ///
    /// # Errors
    /// When there is none of that name, or it cannot be made with these settings.
    pub fn choose(
        self,
        virtualization: &str,
        settings: &ProviderSettings,
        host: &Arc<dyn Host>,
        clusters: &Clusters,
    ) -> Result<Box<dyn Provider>, ProviderError> {
        let Some(kind) = self.kind(virtualization) else {
            return Err(ProviderError::Unknown {
                name: virtualization.to_owned(),
                known: self.names().collect(),
            });
        };
        kind.provider(host, settings, &StateDirectory::of_this_user(), clusters)
    }

    /// Every provider that can have left something behind on a host.
    #[must_use]
    pub fn all(self, host: &Arc<dyn Host>) -> Vec<Box<dyn Provider>> {
        let (settings, clusters) = (ProviderSettings::default(), Clusters::default());
        self.kinds()
            .filter(|kind| host.is_this_machine() || kind.hosts == Hosts::All)
            .filter_map(|kind| self.choose(kind.name, &settings, host, &clusters).ok())
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::host::Here;

    /// As a program of somebody else's has it.
    static OUTSIDE: [ProviderKind; 1] = [ProviderKind::new("elsewhere", native)];
    static TAKEN: [ProviderKind; 1] = [ProviderKind::new("docker", native)];

    fn native(making: &Making<'_>) -> Result<Box<dyn Provider>, ProviderError> {
        Ok(Box::new(Native::new(Arc::clone(making.host))))
    }

    fn here() -> Arc<dyn Host> {
        Arc::new(Here::new("here", StateDirectory::of_this_user()))
    }

    #[test]
    fn each_option_of_vagrants_providers_is_listed_once() {
        let settings = ProviderSettings::default();
        let each = Catalogue::default()
            .of_vagrant(&settings)
            .flat_map(|(provider, _, allowed)| allowed.iter().map(move |(name, _)| (provider, *name)));
        let mut names: Vec<_> = each.collect();
        let count = names.len();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), count);
    }

    #[test]
    fn every_name_has_its_provider_and_no_other_has() {
        let (catalogue, settings) = (Catalogue::default(), ProviderSettings::default());
        for name in catalogue.names() {
            assert_eq!(
                catalogue
                    .choose(name, &settings, &here(), &Clusters::default())
                    .map(|provider| provider.name())
                    .ok(),
                Some(name)
            );
        }
        let unknown = catalogue.choose("dokcer", &settings, &here(), &Clusters::default());
        let error = unknown.map(|_| ()).unwrap_err();
        assert!(
            error.hint().is_some_and(|hint| hint.contains("docker")),
            "{error}"
        );
    }

    #[test]
    fn a_provider_from_outside_stands_behind_the_built_in_ones_and_takes_no_name_of_theirs() {
        let catalogue = Catalogue::with(&OUTSIDE).unwrap();
        assert_eq!(catalogue.names().last(), Some("elsewhere"));
        let all = catalogue.all(&here());
        assert_eq!(all.len(), Catalogue::default().all(&here()).len() + 1);
        assert_eq!(Catalogue::with(&TAKEN), Err(NameTaken { name: "docker" }));
    }

    #[test]
    fn one_that_has_no_settings_takes_an_empty_section_alone() {
        let check = OUTSIDE[0].check;
        assert_eq!(check(&serde_json::json!({})), Ok(()));
        assert!(check(&serde_json::json!({"level": 1})).is_err());
    }

    #[test]
    fn the_docs_name_every_value_of_the_axis_virtualization_and_no_other() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/matrix-file.md");
        let text = std::fs::read_to_string(path).unwrap();
        let row = text.lines().find(|line| line.starts_with("| `virtualization` |"));
        let mut named: Vec<_> = row.unwrap().split('`').skip(3).step_by(2).collect();
        let mut names: Vec<_> = Catalogue::default().names().collect();
        named.sort_unstable();
        names.sort_unstable();
        assert_eq!(named, names);
    }
}
