//! The lease of a host, on this machine and over SSH: one at a time has it, for as long as they live.

#![allow(clippy::unwrap_used, clippy::panic)] // What tests may, but clippy knows only functions that are tests themselves.

use std::{fs, path::Path, sync::Arc, time::Duration};

use orchestrator::{
    host::{
        Here, Host,
        lease::{Answer, HostLease, is_held},
        ssh::{SshClient, SshHost, Trust},
    },
    lease::Holder,
    state_directory::StateDirectory,
};
use record::connection::Ssh;
use tempfile::TempDir;
use tests::{MacOs, sshd::Sshd};
use tokio::time::timeout;

/// Only ends a wait for what never comes.
const TIMEOUT: Duration = Duration::from_secs(120);

/// This machine, with a lease of the test's own.
fn here(folder: &TempDir) -> Arc<dyn Host> {
    let state = StateDirectory::new(folder.path());
    Arc::new(Here::leased_at("here", state, folder.path().join("lease")))
}

fn there(sshd: &Sshd) -> Arc<dyn Host> {
    let connection = Ssh {
        address: sshd.address().parse().unwrap(),
        identity: Some(sshd.identity()),
        jump: None,
        known_hosts: Some(sshd.known_hosts()),
    };
    let configuration = sshd.folder().join("ssh_config");
    fs::write(&configuration, "IdentityFile none\n").unwrap();
    let client = SshClient {
        home: Some(sshd.folder().to_owned()),
        configuration: Some(configuration),
        ..SshClient::default()
    };
    Arc::new(SshHost::new("there", connection, Trust::KnownHosts, client))
}

fn ask(host: &Arc<dyn Host>, run: &str) -> HostLease {
    let holder = Holder::this_process(Path::new(run));
    HostLease::ask(Arc::clone(host), run, &holder)
}

async fn answer(lease: &mut HostLease) -> Answer {
    timeout(TIMEOUT, lease.answer()).await.unwrap().unwrap()
}

/// Whoever asks second is told who has it and gets it when it is given back.
async fn one_at_a_time(host: Arc<dyn Host>) {
    let mut first = ask(&host, "/runs/one");
    assert_eq!(answer(&mut first).await, Answer::Granted);
    assert!(is_held(host.as_ref()).await.unwrap());

    let mut second = ask(&host, "/runs/two");
    let Answer::HeldBy(holder) = answer(&mut second).await else {
        panic!("two have it")
    };
    assert!(holder.contains(" with /runs/one since "), "{holder}");
    assert!(
        holder.contains(&format!("process {} on ", std::process::id())),
        "{holder}"
    );

    first.give_back().await;
    assert_eq!(answer(&mut second).await, Answer::Granted);
    second.give_back().await;
    assert!(!is_held(host.as_ref()).await.unwrap());
}

#[tokio::test]
async fn on_this_machine_one_at_a_time_has_the_lease() {
    let folder = tempfile::tempdir().unwrap();
    one_at_a_time(here(&folder)).await;
}

#[tokio::test]
async fn over_ssh_one_at_a_time_has_the_lease() {
    let sshd = Sshd::start();
    one_at_a_time(there(&sshd)).await;
}

#[tokio::test]
async fn on_macos_one_at_a_time_has_the_lease() {
    let mac = MacOs::start();
    one_at_a_time(there(&mac.sshd)).await;
}

async fn it_ends_with_the_connection(sshd: &Sshd) {
    let (one, two) = (there(sshd), there(sshd));
    let mut first = ask(&one, "/runs/one");
    assert_eq!(answer(&mut first).await, Answer::Granted);
    let mut second = ask(&two, "/runs/two");
    assert!(matches!(answer(&mut second).await, Answer::HeldBy(_)));
    drop(first);
    drop(one);
    assert_eq!(answer(&mut second).await, Answer::Granted);
}

#[tokio::test]
async fn a_lease_ends_with_the_connection_of_who_has_it() {
    it_ends_with_the_connection(&Sshd::start()).await;
}

#[tokio::test]
async fn a_lease_on_macos_ends_with_the_connection_of_who_has_it() {
    it_ends_with_the_connection(&MacOs::start().sshd).await;
}

async fn who_was_cut_off_has_it_again(sshd: &Sshd) {
    let host = there(sshd);
    let mut first = ask(&host, "/runs/one");
    assert_eq!(answer(&mut first).await, Answer::Granted);
    // Behind a cable that was cut the host does not know that its holder is out of reach.
    sshd.freeze();
    let elsewhere = there(sshd);
    let mut second = ask(&elsewhere, "/runs/two");
    assert!(matches!(answer(&mut second).await, Answer::HeldBy(_)));
    // The same run, from a process that knows nothing of the older connection.
    let mut again = ask(&elsewhere, "/runs/one");
    assert_eq!(answer(&mut again).await, Answer::Granted);
    again.give_back().await;
    assert_eq!(answer(&mut second).await, Answer::Granted);
}

#[tokio::test]
async fn who_was_cut_off_has_the_lease_again_before_who_has_waited() {
    who_was_cut_off_has_it_again(&Sshd::start()).await;
}

#[tokio::test]
async fn who_was_cut_off_from_macos_has_the_lease_again_before_who_has_waited() {
    who_was_cut_off_has_it_again(&MacOs::start().sshd).await;
}

#[tokio::test]
async fn a_host_that_cannot_be_asked_is_an_error_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let state = StateDirectory::new(folder.path());
    // A folder is no file to lock.
    let host: Arc<dyn Host> = Arc::new(Here::leased_at("here", state, folder.path().to_owned()));
    let mut lease = ask(&host, "/runs/one");
    let error = timeout(TIMEOUT, lease.answer()).await.unwrap().unwrap_err();
    assert!(error.to_string().contains("leasing the host"), "{error}");
    assert!(error.hint().is_some(), "{error:?}");
}
