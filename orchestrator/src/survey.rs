//! What the hosts of a matrix can do, asked before anything is planned, so that a plan itself reads no host and no
//! clock. The main function is [`survey`].

use std::collections::BTreeMap;

use workload::record::platform::RealtimeGrant;

use crate::{
    matrix_file::{Connection, MatrixFile},
    plan::HostFacts,
    provider::{self, Availability, Roster},
};

/// Asks every host of the matrix that can be asked for what the matrix names. One over SSH cannot yet: it is not in the
/// answer.
pub async fn survey(file: &MatrixFile, roster: &Roster) -> BTreeMap<String, HostFacts> {
    let named = file.matrix.virtualizations();
    let asked: Vec<&str> = provider::names()
        .into_iter()
        .filter(|name| named.contains(name))
        .collect();
    let mut facts = BTreeMap::new();
    for host in file
        .hosts
        .iter()
        .filter(|host| host.connection == Connection::Local)
    {
        let name = host.name.value.clone();
        facts.insert(name.clone(), this_machine(&name, &asked, roster).await);
    }
    facts
}

/// What this machine is and what those of its providers say.
pub async fn this_machine(host: &str, asked: &[&str], roster: &Roster) -> HostFacts {
    let platform = workload::survey::platform(RealtimeGrant::default());
    HostFacts {
        hardware: platform.machine,
        os: platform.os,
        providers: providers(host, asked, roster).await,
    }
}

/// Asks the providers all at once: each answer is a process or a connection away.
async fn providers(host: &str, asked: &[&str], roster: &Roster) -> BTreeMap<String, Availability> {
    let mut asking = Vec::new();
    for name in asked {
        if let Ok(provider) = roster.provider(name, host) {
            asking.push((*name, tokio::spawn(async move { provider.survey().await })));
        }
    }
    let mut answers = BTreeMap::new();
    for (name, answer) in asking {
        if let Ok(answer) = answer.await {
            answers.insert(name.to_owned(), answer);
        }
    }
    answers
}
