//! What each host is and can do, whatever a matrix needs of it: what `matrix doctor` shows. The main type is [`Examination`].

use std::{path::Path, sync::Arc};

use futures_util::future::join_all;
use record::{
    axis::NATIVE,
    check::Check,
    identity::HostIdentity,
    platform::PlatformRecord,
    run_directory::PlannedScenario,
    settings::{Need, Settings},
};

use crate::{
    batch::Clusters,
    disk_space,
    host::{Here, Host, SlurmNodes},
    matrix_file::{MatrixFile, THIS_MACHINE},
    plan::{self, HostFacts, Selection, order::Order},
    preparation::PreparationError,
    provider::{
        Availability, Catalogue, ProviderError, ProviderKind, ProviderSettings, Providers,
        detached::{AgentClient, ClockReading},
        jobs::{ENGINE, JobWorkload, Jobs, ProbedNode},
    },
    state_directory::StateDirectory,
    survey,
};

/// What a host answers if it is asked for everything.
pub struct Examination {
    /// The host's name.
    pub name: String,
    /// What it is, and what each provider can do there.
    pub facts: HostFacts,
    /// What the experiment needs; an error where it could not be asked.
    pub checks: Result<Vec<Check>, ProviderError>,
    /// None where it could not be asked.
    pub standing: Option<Standing>,
    /// What the windows that the matrix file has for it take on its disk, in bytes; none without a file, or without a plan of it.
    pub to_come_bytes: Option<u64>,
}

impl Examination {
    /// Whether nothing can be measured there, or something that the experiment needs is missing.
    #[must_use]
    pub fn is_lacking(&self, catalogue: Catalogue) -> bool {
        let mut providers = self.facts.providers.iter();
        let measures = providers.any(|(name, provider)| {
            !catalogue.is_simulated(name) && matches!(provider.availability, Availability::Available { .. })
        });
        let is_missing = |check: &Check| check.required && !check.available;
        // A host whose system the workload is no program for may still have engines and virtual machines.
        !measures || self.checks.iter().flatten().any(is_missing)
    }
}

/// What a host is like at the moment.
pub struct Standing {
    /// The number of the user whose rights are used there.
    pub uid: u32,
    /// Free space on the disk with its state folder, in bytes.
    pub free_bytes: u64,
    /// Its clock beside this machine's.
    pub clock: ClockReading,
}

impl Standing {
    async fn of(host: &Arc<dyn Host>) -> Option<Self> {
        let (clock, said) = ClockReading::of(&AgentClient::new(Arc::clone(host))).await.ok()?;
        Some(Self {
            uid: said.uid,
            free_bytes: said.free_bytes,
            clock,
        })
    }
}

/// Asks this machine for everything.
pub async fn of_this_machine(catalogue: Catalogue) -> Examination {
    let here: Arc<dyn Host> = Arc::new(Here::new(THIS_MACHINE, StateDirectory::of_this_user()));
    let providers = Providers::new(catalogue, ProviderSettings::default(), [Arc::clone(&here)]);
    ask(&here, &providers, Probing::default()).await
}

/// Whether jobs may be submitted to ask the nodes of clusters.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Probing {
    /// What only a job can tell is left open.
    #[default]
    SubmitsNothing,
    /// A job of a minute looks.
    SubmitsJobs,
}

/// Asks each host of a matrix file for everything, all of them side by side: a job that looks at a node takes a minute or two.
///
/// # Errors
/// All that is wrong with the file. What is wrong with its scenarios is none: the examinations are then without
/// `to_come_bytes`.
pub async fn of_hosts(
    path: &Path,
    catalogue: Catalogue,
    probing: Probing,
) -> Result<Vec<Examination>, PreparationError> {
    let mut file = MatrixFile::read(path, None, catalogue).map_err(PreparationError::File)?;
    // A cluster that cannot be asked is examined as the one host that stands for it.
    drop(survey::split_clusters(&mut file).await);
    let providers = survey::providers(&file);
    let asking = providers.hosts().map(|host| ask(host, &providers, probing));
    let mut answers = join_all(asking).await;
    foresee(&file, &mut answers);
    Ok(answers)
}

/// What the experiment needs, asked where it would be measured. What a job sees of its node goes to `facts`.
async fn checks(
    host: &Arc<dyn Host>,
    probing: Probing,
    facts: &mut HostFacts,
) -> Result<Vec<Check>, ProviderError> {
    let defaults = Need::of_the_network(&Settings::default());
    match (host.nodes(), probing) {
        (None, _) => {
            let record = AgentClient::new(Arc::clone(host)).check(&defaults).await?;
            Ok(record.checks)
        }
        (Some(nodes), Probing::SubmitsJobs) => {
            let jobs = Jobs::new(NATIVE, JobWorkload::Process, host, nodes, &Clusters::default());
            let ProbedNode {
                mut checks,
                host: node,
            } = jobs.probe(&defaults).await?;
            checks.push(as_said(host.name(), nodes, &node.platform));
            facts.hardware = node.platform.machine;
            facts.os = node.platform.os;
            facts.kernel = node.platform.kernel;
            Ok(checks)
        }
        (Some(_), Probing::SubmitsNothing) => Err(ProviderError::KnownInAJob {
            host: host.name().to_owned(),
        }),
    }
}

/// Whether a node is what the file says of it.
fn as_said(host: &str, nodes: &SlurmNodes, node: &PlatformRecord) -> Check {
    let identity = HostIdentity {
        host,
        hardware: Some(&nodes.hardware),
        os: Some(&nodes.os),
    };
    let mismatch = identity.contradiction(&node.machine, &node.os);
    let (reason, fix) = mismatch.map(|it| (it.reason, it.fix)).unzip();
    Check {
        name: "hardware-and-os".to_owned(),
        required: true,
        available: reason.is_none(),
        reason,
        fix,
    }
}

async fn ask(host: &Arc<dyn Host>, providers: &Providers, probing: Probing) -> Examination {
    let name = host.name().to_owned();
    let mut facts = survey::identity(Arc::clone(host)).await;
    let checks = checks(host, probing, &mut facts).await;
    if facts.obstacle.is_none() {
        let everything = providers
            .catalogue()
            .names()
            .map(|name| (name.to_owned(), Need::each().into_iter().collect()))
            .collect();
        facts.providers = survey::ask(&name, everything, providers).await;
        if let Ok(checks) = &checks {
            take_containers_of_no_engine(&mut facts, checks, providers.catalogue());
        }
    }
    Examination {
        name,
        facts,
        checks,
        standing: Standing::of(host).await,
        to_come_bytes: None,
    }
}

/// A plan takes it that the nodes of a cluster have an engine, since only a job knows. One that looked and saw none knows better.
fn take_containers_of_no_engine(facts: &mut HostFacts, checks: &[Check], catalogue: Catalogue) {
    let Some(missing) = checks.iter().find(|it| it.name == ENGINE && !it.available) else {
        return;
    };
    let settings = ProviderSettings::default();
    let runs_containers = |kind: &&ProviderKind| {
        let workload = kind.as_job.map(|workload| workload(&settings));
        matches!(workload, Some(JobWorkload::Container(_)))
    };
    for kind in catalogue.kinds().filter(runs_containers) {
        if let Some(provider) = facts.providers.get_mut(kind.name) {
            provider.availability = Availability::Unavailable {
                reason: missing.reason.clone().unwrap_or_default(),
                fix: missing.fix.clone(),
            };
            provider.needs.clear();
        }
    }
}

/// What is to come on each host, if all that can run there does.
fn foresee(file: &MatrixFile, answers: &mut [Examination]) {
    let facts = answers
        .iter()
        .map(|answer| (answer.name.clone(), answer.facts.clone()))
        .collect();
    // What is wrong with the scenarios is for `check` and `plan` to report.
    let Ok(plan) = plan::plan(file, &facts, &Selection::default(), Order::default(), 0) else {
        return;
    };
    for answer in answers {
        let runs_there = |it: &&PlannedScenario| it.runs() && it.host.as_ref() == Some(&answer.name);
        let scenarios = plan.record.scenarios.iter().filter(runs_there);
        let bytes =
            scenarios.map(|it| disk_space::windows_take(&it.settings, it.settings.all_windows() as usize));
        answer.to_come_bytes = Some(bytes.sum());
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use record::axis::NATIVE;
    use rstest::rstest;

    use super::*;
    use crate::plan::ProviderFacts;

    /// A host on which these providers can be had, of the others of the two not, with or without what the experiment needs.
    fn examined(available: &[&str], has_what_it_needs: Option<bool>) -> Examination {
        let facts = |name: &str| ProviderFacts {
            availability: match available.contains(&name) {
                true => Availability::Available {
                    detail: String::new(),
                },
                false => Availability::Unavailable {
                    reason: "it is not there".to_owned(),
                    fix: None,
                },
            },
            needs: BTreeMap::new(),
            time_limit: None,
        };
        let check = |available| Check {
            name: "network".to_owned(),
            required: true,
            available,
            reason: None,
            fix: None,
        };
        Examination {
            name: "lab".to_owned(),
            facts: HostFacts {
                providers: [NATIVE, "docker", "simulated"]
                    .into_iter()
                    .map(|name| (name.to_owned(), facts(name)))
                    .collect(),
                ..HostFacts::default()
            },
            checks: match has_what_it_needs {
                Some(available) => Ok(vec![check(available)]),
                None => Err(ProviderError::NotFound {
                    what: "a workload for it".to_owned(),
                }),
            },
            standing: None,
            to_come_bytes: None,
        }
    }

    #[rstest]
    #[case::all_is_there(&[NATIVE, "docker", "simulated"], Some(true), false)]
    #[case::what_the_experiment_needs_is_missing(&["docker", "simulated"], Some(false), true)]
    #[case::a_mac_with_an_engine(&["docker", "simulated"], None, false)]
    #[case::nothing_that_measures(&["simulated"], None, true)]
    #[case::nothing_at_all(&[], None, true)]
    fn a_host_is_lacking_if_nothing_can_be_measured_there_or_a_need_is_missing(
        #[case] available: &[&str],
        #[case] has_what_it_needs: Option<bool>,
        #[case] is_lacking: bool,
    ) {
        let examined = examined(available, has_what_it_needs);
        assert_eq!(examined.is_lacking(Catalogue::default()), is_lacking);
    }
}
