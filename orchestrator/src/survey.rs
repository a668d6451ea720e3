//! What the hosts of a matrix can do, asked before anything is planned, so that a plan itself reads no host and no
//! clock. The main functions are [`identities`] and [`ask_hosts`]: in between, the matrix is expanded.
//!
//! ```text
//! the machines themselves -> the matrix expanded: what its scenarios need -> each provider, once for each distinct need
//! ```

use std::{
    collections::{BTreeMap, BTreeSet},
    ffi::CStr,
    fs,
    sync::Arc,
};

use record::{
    axis::NATIVE,
    causes::with_causes,
    connection::Connection,
    platform::{PlatformRecord, os_name},
    settings::Need,
};
use rustix::system::uname;

use crate::{
    batch::{Clusters, FittingNodes},
    host::{self, Host},
    matrix_file::{self, Code, Diagnostic, Diagnostics, MatrixFile},
    plan::{HostFacts, Obstacle, ProviderFacts, Questions},
    provider::{
        Availability, Provider, Providers,
        detached::AgentClient,
        jobs::{JobWorkload, Jobs},
    },
    state_directory::StateDirectory,
};

/// The hosts and providers that a matrix file names.
#[must_use]
pub fn providers(file: &MatrixFile) -> Providers {
    let state = StateDirectory::of_this_user();
    let hosts = host::all(file.hosts.iter().map(said_of), &state);
    Providers::new(file.catalogue, file.providers.clone(), hosts)
}

/// Makes each node of a cluster a host where the file asks for that (`nodes: each`). The clusters are asked which nodes fit, one
/// after another.
///
/// # Errors
/// When a cluster cannot be asked, has no such node, or a node's name cannot be a host's.
pub async fn split_clusters(file: &mut MatrixFile) -> Result<(), Diagnostics> {
    let state = StateDirectory::of_this_user();
    let mut found = Diagnostics::new();
    let mut nodes = BTreeMap::new();
    for said in file.hosts.iter().filter(|host| host.is_each_node()) {
        let span = said.name.span;
        let host = host::of(said_of(said), &state);
        let Some(wanted) = host.nodes() else { continue };
        let jobs = Jobs::new(NATIVE, JobWorkload::Process, &host, wanted, &Clusters::default());
        match jobs.fitting_nodes().await {
            Ok(FittingNodes { fit, out_of_service }) => {
                for (node, state) in out_of_service {
                    let message = format!("node `{node}` is {state}, and is left out");
                    let help = "`sinfo -R` prints why; the other nodes are measured";
                    found.push(Diagnostic::warning(&file.source, Code::SilentHost, span, message).help(help));
                }
                nodes.insert(said.name.value.clone(), fit);
            }
            Err(error) => {
                let message = format!(
                    "which nodes `{}` stands for is not known: {}",
                    said.name.value,
                    with_causes(&error)
                );
                let mut wrong = Diagnostic::error(&file.source, Code::SilentHost, span, message);
                if let Some(hint) = error.hint() {
                    wrong = wrong.help(hint);
                }
                found.push(wrong);
            }
        }
    }
    let ((), told) = found.unless_errors(())?;
    file.split_hosts(&nodes)?;
    file.warnings.extend(told);
    Ok(())
}

/// What a matrix file says of a host.
fn said_of(host: &matrix_file::Host) -> host::Said<'_> {
    host::Said {
        name: &host.name.value,
        connection: &host.connection,
        hardware: host.hardware.as_deref().unwrap_or_default(),
        os: host.os.as_deref().unwrap_or_default(),
    }
}

/// Asks the hosts whose identity is known for what the scenarios of a matrix need. One that did not answer is left out.
pub async fn ask_hosts(
    facts: &mut BTreeMap<String, HostFacts>,
    mut questions: BTreeMap<String, Questions>,
    providers: &Providers,
) {
    for (host, facts) in facts.iter_mut().filter(|(_, facts)| facts.obstacle.is_none()) {
        facts.providers = ask(host, questions.remove(host).unwrap_or_default(), providers).await;
    }
}

/// What is known of the hosts without asking any: of this machine what it is, of others what the file says. Nothing is started
/// and nothing is connected to.
#[must_use]
pub fn unasked(file: &MatrixFile) -> BTreeMap<String, HostFacts> {
    let facts = |host: &matrix_file::Host| HostFacts {
        left_alone: true,
        ..match host.connection {
            Connection::Local => this_machine(),
            Connection::Ssh(_) | Connection::Slurm(_) => HostFacts::default(),
        }
    };
    let named = file
        .hosts
        .iter()
        .map(|host| (host.name.value.clone(), facts(host)));
    named.collect()
}

/// What each host is, all asked at once. One that cannot be asked is in the answer with the reason. No provider was asked
/// yet.
pub async fn identities(providers: &Providers) -> BTreeMap<String, HostFacts> {
    let mut asking = Vec::new();
    for host in providers.hosts() {
        asking.push((host.name().to_owned(), tokio::spawn(identity(Arc::clone(host)))));
    }
    let mut facts = BTreeMap::new();
    for (host, answer) in asking {
        if let Ok(answer) = answer.await {
            facts.insert(host, answer);
        }
    }
    facts
}

/// What a host is, or why it could not be asked. No provider was asked yet.
pub async fn identity(host: Arc<dyn Host>) -> HostFacts {
    if host.is_this_machine() {
        return this_machine();
    }
    // What its nodes are is known in a job, which looks before its first window.
    if let Some(nodes) = host.nodes() {
        return HostFacts {
            hardware: nodes.hardware.clone(),
            os: nodes.os.clone(),
            ..HostFacts::default()
        };
    }
    match AgentClient::new(host).platform().await {
        Ok(host) => of_platform(host.platform),
        Err(error) => HostFacts {
            obstacle: Some(Obstacle {
                reason: with_causes(&error),
                fix: error.hint(),
            }),
            ..HostFacts::default()
        },
    }
}

fn this_machine() -> HostFacts {
    let kernel = uname();
    let text = |name: &CStr| name.to_string_lossy().into_owned();
    HostFacts {
        hardware: text(kernel.machine()),
        os: fs::read_to_string("/etc/os-release")
            .map(|os_release| os_name(&os_release))
            .unwrap_or_default(),
        kernel: text(kernel.release()),
        ..HostFacts::default()
    }
}

fn of_platform(platform: PlatformRecord) -> HostFacts {
    HostFacts {
        hardware: platform.machine,
        os: platform.os,
        kernel: platform.kernel,
        ..HostFacts::default()
    }
}

/// What the providers of a host say, each of what it is asked for: all at once, since an answer is a process or a
/// connection away.
pub async fn ask(host: &str, questions: Questions, providers: &Providers) -> BTreeMap<String, ProviderFacts> {
    let mut asking = Vec::new();
    let mut answers = BTreeMap::new();
    for (name, needs) in questions {
        match providers.of(&name, host) {
            Ok(provider) => asking.push((name, tokio::spawn(ask_provider(provider, needs)))),
            Err(error) => {
                let facts = ProviderFacts {
                    availability: Availability::prevented_by(error),
                    needs: BTreeMap::new(),
                    time_limit: None,
                };
                answers.insert(name, facts);
            }
        }
    }
    for (name, answer) in asking {
        if let Ok(facts) = answer.await {
            answers.insert(name, facts);
        }
    }
    answers
}

/// What a provider says, also of the needs if it can work at all.
async fn ask_provider(provider: Arc<dyn Provider>, needs: BTreeSet<Need>) -> ProviderFacts {
    let availability = provider.survey().await;
    let mut answers = BTreeMap::new();
    // One that cannot be asked for it is asked again when it is needed.
    let mut time_limit = None;
    if matches!(availability, Availability::Available { .. }) {
        time_limit = provider.time_limit().await.ok().flatten();
        for need in needs {
            if let Some(answer) = provider.survey_need(&need).await {
                answers.insert(need, answer);
            }
        }
    }
    ProviderFacts {
        availability,
        needs: answers,
        time_limit,
    }
}
