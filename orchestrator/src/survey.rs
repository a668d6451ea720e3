//! What the hosts of a matrix can do, asked before anything is planned, so that a plan itself reads no host and no
//! clock. The main function is [`survey`].
//!
//! ```text
//! the machines themselves -> the matrix expanded: what its scenarios need -> each provider, once for each distinct need
//! ```

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use record::{
    causes::with_causes,
    platform::{PlatformRecord, RealtimeGrant},
    settings::Need,
};

use crate::{
    host::{self, Host},
    matrix_file::{self, Connection, MatrixFile},
    plan::{self, HostFacts, Obstacle, ProviderFacts, Questions},
    provider::{Availability, Provider, Roster, detached::AgentClient},
    state_directory::StateDirectory,
};

/// The hosts and providers that a matrix file names.
#[must_use]
pub fn roster(file: &MatrixFile) -> Roster {
    let state = StateDirectory::of_this_user();
    let hosts = file
        .hosts
        .iter()
        .map(|it| host::of(&it.name.value, &it.connection, &state));
    Roster::new(file.catalogue, file.providers.clone(), hosts)
}

/// Asks every host of the matrix what it is, and then for what its scenarios need. One that cannot be asked is in the
/// answer with the reason.
pub async fn survey(file: &MatrixFile, roster: &Roster) -> BTreeMap<String, HostFacts> {
    let mut facts = identities(roster).await;
    let mut questions = plan::questions(file, &facts);
    for (host, facts) in facts.iter_mut().filter(|(_, facts)| facts.obstacle.is_none()) {
        facts.providers = ask(host, questions.remove(host).unwrap_or_default(), roster).await;
    }
    facts
}

/// What is known of the hosts without asking any: of this machine what it is, of others what the file says. Nothing is started
/// and nothing is connected to.
#[must_use]
pub fn unasked(file: &MatrixFile) -> BTreeMap<String, HostFacts> {
    let facts = |host: &matrix_file::Host| HostFacts {
        left_alone: true,
        ..match host.connection {
            Connection::Local => this_machine(),
            Connection::Ssh(_) => HostFacts::default(),
        }
    };
    let named = file
        .hosts
        .iter()
        .map(|host| (host.name.value.clone(), facts(host)));
    named.collect()
}

/// What each host is, all asked at once. No provider was asked yet.
async fn identities(roster: &Roster) -> BTreeMap<String, HostFacts> {
    let mut asking = Vec::new();
    for host in roster.hosts() {
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
    of_platform(workload::survey::platform(RealtimeGrant::default()))
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
pub async fn ask(host: &str, questions: Questions, roster: &Roster) -> BTreeMap<String, ProviderFacts> {
    let mut asking = Vec::new();
    let mut answers = BTreeMap::new();
    for (name, needs) in questions {
        match roster.of(&name, host) {
            Ok(provider) => asking.push((name, tokio::spawn(ask_provider(provider, needs)))),
            Err(error) => {
                let facts = ProviderFacts {
                    availability: Availability::prevented_by(error),
                    needs: BTreeMap::new(),
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
    if matches!(availability, Availability::Available { .. }) {
        for need in needs {
            if let Some(answer) = provider.survey_need(&need).await {
                answers.insert(need, answer);
            }
        }
    }
    ProviderFacts {
        availability,
        needs: answers,
    }
}
