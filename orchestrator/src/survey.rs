//! What the hosts of a matrix can do, asked before anything is planned, so that a plan itself reads no host and no
//! clock. The main function is [`survey`].

use std::{collections::BTreeMap, sync::Arc};

use workload::{record::platform::RealtimeGrant, settings::NetworkBackend};

use crate::{
    matrix_file::{Connection, MatrixFile},
    plan::HostFacts,
    provider::{self, Availability, Provider, Roster},
};

/// The setting that says which network a scenario has, as an axis.
const BACKEND: &str = "network.backend";

/// Asks every host of the matrix that can be asked for what the matrix names. One over SSH cannot yet: it is not in the
/// answer.
pub async fn survey(file: &MatrixFile, roster: &Roster) -> BTreeMap<String, HostFacts> {
    let named = file.matrix.virtualizations();
    let asked: Vec<&str> = provider::names()
        .into_iter()
        .filter(|name| named.contains(name))
        .collect();
    let backends = backends(file);
    let mut facts = BTreeMap::new();
    for host in file
        .hosts
        .iter()
        .filter(|host| host.connection == Connection::Local)
    {
        let name = host.name.value.clone();
        facts.insert(name.clone(), this_machine(&name, &asked, &backends, roster).await);
    }
    facts
}

/// The networks that scenarios may want.
fn backends(file: &MatrixFile) -> Vec<NetworkBackend> {
    let swept = file.matrix.values_of(BACKEND);
    NetworkBackend::ALL
        .into_iter()
        .filter(|backend| *backend == file.workload.network.backend || swept.contains(backend.name()))
        .collect()
}

/// What this machine is and what those of its providers say, also of those networks.
pub async fn this_machine(
    host: &str,
    asked: &[&str],
    backends: &[NetworkBackend],
    roster: &Roster,
) -> HostFacts {
    let platform = workload::survey::platform(RealtimeGrant::default());
    let mut facts = HostFacts {
        hardware: platform.machine,
        os: platform.os,
        ..HostFacts::default()
    };
    // All providers at once: each answer is a process or a connection away.
    let mut asking = Vec::new();
    for name in asked {
        if let Ok(provider) = roster.provider(name, host) {
            asking.push((*name, tokio::spawn(ask(provider, backends.to_vec()))));
        }
    }
    for (name, answer) in asking {
        if let Ok((availability, networks)) = answer.await {
            facts.providers.insert(name.to_owned(), availability);
            facts.networks.insert(name.to_owned(), networks);
        }
    }
    facts
}

/// What a provider says, also of the networks if it can work at all.
async fn ask(
    provider: Arc<dyn Provider>,
    backends: Vec<NetworkBackend>,
) -> (Availability, BTreeMap<NetworkBackend, Availability>) {
    let availability = provider.survey().await;
    let mut networks = BTreeMap::new();
    if matches!(availability, Availability::Available { .. }) {
        for backend in backends {
            if let Some(answer) = provider.survey_network(backend).await {
                networks.insert(backend, answer);
            }
        }
    }
    (availability, networks)
}
