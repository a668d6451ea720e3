//! Scenarios as jobs of a real Slurm: nodes that lose their power or stand still, a `matrix` that is killed, a controller that is away,
//! jobs that others cancel. As an ordinary user, from the submit host and over SSH.

use std::{collections::BTreeSet, fs, path::Path, process::Command, sync::Arc};

use orchestrator::{
    batch::{BatchSystem as _, JobOwner, JobRequest, slurm::SlurmCommands},
    host::{Here, Host},
    state_directory::StateDirectory,
};
use record::connection::Slurm;
use serde_json::Value;
use tests::{
    Ran, Running, WHOLE_WINDOWS_COUNT,
    cluster::{Cluster, give},
    is_whole,
    sshd::Sshd,
};

/// Asked often, so that nobody waits.
const QUICK: &str = "poll: 1s, visible_within: 1s";

/// A matrix of one native host that any node of this machine's kind can be.
fn matrix(slurm: &str, workload: &str) -> String {
    format!(
        "hosts:\n  lab:\n    hardware: x86_64\n    os: debian-12\n    connect: {{slurm: {{{QUICK}, {slurm}}}}}\n\
         matrix: {{virtualization: [native]{workload}\n  {WHOLE_WINDOWS_COUNT}\n"
    )
}

/// So many windows of so many seconds.
fn windows(windows: u32, seconds: u32) -> String {
    format!(
        "}}\nworkload:\n  windows: {windows}\n  window: {seconds}s\n  period: 1s\n  reference: {{amplitude_m: 0.05}}"
    )
}

fn scenarios(report: &Value) -> &Vec<Value> {
    report["scenarios"].as_array().expect("there are scenarios")
}

/// The lines of the journal of one kind.
fn journaled(run: &Path, event: &str) -> Vec<Value> {
    let journal = fs::read_to_string(run.join("events.jsonl")).expect("there is a journal");
    let events = journal
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).expect("a journal's lines are JSON"));
    events.filter(|it| it["event"] == event).collect()
}

/// Fails unless every window of every scenario is there, whole, and was collected once.
fn all_is_whole(run: &Path, scenarios: usize, windows: u32) {
    let folders: Vec<_> = fs::read_dir(run.join("scenarios"))
        .expect("there are scenarios")
        .map(|it| it.expect("it can be read").path())
        .collect();
    assert_eq!(folders.len(), scenarios, "{folders:?}");
    for folder in folders {
        for window in 1..=windows {
            assert!(
                is_whole(&folder.join(format!("window-{window}"))),
                "{folder:?} {window}"
            );
        }
    }
    let collected = journaled(run, "window-collected");
    assert_eq!(collected.len(), scenarios * windows as usize, "{collected:#?}");
}

/// The facts of a scenario's last environment.
fn facts(run: &Path, slug: &str) -> Value {
    let path = run.join("scenarios").join(slug).join("environment.json");
    let record: Value =
        serde_json::from_slice(&fs::read(path).expect("it was collected")).expect("it is JSON");
    record["facts"].clone()
}

/// A run of two windows that measures the second of them, and the node that does. That is seen some seconds late where others use the
/// machine.
fn in_the_second_window(cluster: &Cluster) -> (Running, String) {
    let workplace = &cluster.workplace;
    workplace.write("m.yaml", matrix("constraint: x86_64", &windows(2, 8)));
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("window 1 complete");
    (running, cluster.running_on())
}

fn nothing_is_left(cluster: &Cluster) {
    assert_eq!(cluster.jobs(), Vec::<[String; 4]>::new());
    let cleaned = cluster.workplace.run(&["clean"]);
    assert!(cleaned.err.contains("nothing of ours is left"), "{cleaned:?}");
}

fn done(ran: &Ran) {
    assert_eq!(ran.code, Some(0), "{ran:?}");
}

#[test]
fn two_kinds_of_nodes_measure_a_sweep_over_ssh_and_a_power_cut_costs_the_window_that_it_cut() {
    let cluster = Cluster::start();
    let home = cluster.workplace.path();
    let keys = home.join("authorized_keys");
    let sshd = Sshd::with(&format!("AuthorizedKeysFile {}", keys.display()));
    for (from, to) in [
        (sshd.identity().with_extension("pub"), "authorized_keys"),
        (sshd.identity(), "identity"),
        (sshd.known_hosts(), "known_hosts"),
    ] {
        fs::copy(from, home.join(to)).unwrap();
        give(&home.join(to));
    }
    let submit = format!(
        "{{ssh: \"researcher@127.0.0.1:{}\", identity: identity, known_hosts: known_hosts}}",
        sshd.port()
    );
    let workloads = cluster.workload_for("i686");
    let mut workplace = cluster.workplace.beside();
    workplace.set("MATRIX_WORKLOADS", &workloads.display().to_string());
    let slurm = format!("{QUICK}, submit: {submit}");
    for file in ["identity", "known_hosts"] {
        fs::copy(home.join(file), workplace.path().join(file)).unwrap();
        give(&workplace.path().join(file));
    }
    workplace.write(
        "m.yaml",
        format!(
            "hosts:\n  new: {{hardware: x86_64, os: debian-12, connect: {{slurm: {{{slurm}, constraint: x86_64}}}}}}\n  \
             old: {{hardware: i686, os: ubuntu-22.04, connect: {{slurm: {{{slurm}, constraint: i686}}}}}}\n\
             matrix: {{hardware: [x86_64, i686], os: [debian-12, ubuntu-22.04], virtualization: [native], \
             reference.amplitude_m: [0.03, 0.05]}}\n\
             workload:\n  windows: 3\n  window: 8s\n  period: 1s\n  {WHOLE_WINDOWS_COUNT}\n"
        ),
    );
    let mut running = workplace.start(&["run", "m.yaml"]);
    // In the second window of a scenario on a node that has a twin.
    let line = loop {
        let line = running.next_line().expect("it measures");
        if line.starts_with("x86-64") && line.contains("window 1 complete") {
            break line;
        }
    };
    // Its twin may have another scenario, which is further.
    let slug = line.split(':').next().unwrap();
    let jobs = cluster.jobs();
    let (node, cut) = jobs
        .iter()
        .find(|[_, state, _, name]| state == "RUNNING" && name.contains(slug))
        .map(|[_, _, node, name]| (node.clone(), name.clone()))
        .unwrap_or_else(|| panic!("{line}: {jobs:?}"));
    cluster.node("off", &node);
    let ran = running.end();
    done(&ran);
    let run = workplace.run_directory();
    let report = fs::read(run.join("report/report.json")).unwrap();
    let report: Value = serde_json::from_slice(&report).unwrap();
    let outcome = |wanted: &str| {
        let is = |it: &&Value| it["outcome"] == wanted;
        scenarios(&report).iter().filter(is).count()
    };
    assert_eq!((outcome("completed"), outcome("infeasible")), (4, 4));
    all_is_whole(&run, 4, 3);
    // What the lost environment had measured was kept.
    let of_the_cut = journaled(&run, "window-collected")
        .iter()
        .filter(|it| it["environment"] == cut.as_str())
        .count();
    assert!(
        (1..3).contains(&of_the_cut),
        "{of_the_cut} windows of {cut} on {node}: {ran:?}"
    );
    for (slug, hardware, node) in [
        ("x86-64-debian-12-native-amplitude-m-0-03", "x86_64", None),
        ("i686-ubuntu-22-04-native-amplitude-m-0-03", "i686", Some("n3")),
    ] {
        let facts = facts(&run, slug);
        assert!(
            facts["batch_system"].as_str().unwrap().starts_with("Slurm "),
            "{facts:#}"
        );
        assert!(node.is_none_or(|node| facts["node"] == node), "{facts:#}");
        let environment =
            fs::read_to_string(run.join("scenarios").join(slug).join("environment.json")).unwrap();
        assert!(
            environment.contains(&format!("\"machine\": \"{hardware}\"")),
            "{environment}"
        );
    }
    cluster.node("on", &node);
    assert_eq!(cluster.jobs(), Vec::<[String; 4]>::new());
}

#[test]
fn jobs_need_no_matrix_and_one_that_comes_back_takes_up_what_is_there() {
    let cluster = Cluster::start();
    let workplace = &cluster.workplace;
    workplace.write(
        "m.yaml",
        matrix(
            "constraint: x86_64",
            &format!(", reference.amplitude_m: [0.02, 0.03]{}", windows(2, 3)),
        ),
    );
    let submitted = workplace.run(&["run", "m.yaml", "--submit"]);
    done(&submitted);
    assert!(
        submitted.err.contains("2 jobs are submitted or measure"),
        "{submitted:?}"
    );
    let run = workplace.run_directory();
    let run_argument = run.to_str().unwrap();
    assert_eq!(cluster.jobs().len(), 2);
    let status = workplace.json(&["status", run_argument, "--hosts"]);
    let states: Vec<_> = scenarios(&status)
        .iter()
        .map(|it| it["state"].as_str().unwrap())
        .collect();
    assert!(states.contains(&"queued"), "{status:#}");
    // What is there already is neither submitted once more nor said once more.
    let before = journaled(&run, "scenario-started").len();
    done(&workplace.run(&["resume", run_argument, "--submit"]));
    assert_eq!(cluster.jobs().len(), 2);
    assert_eq!(journaled(&run, "scenario-started").len(), before);
    cluster.until("both jobs have ended", || cluster.jobs().is_empty());
    // Slurm forgets jobs, and what they left in the folder counts.
    cluster.until("Slurm has forgotten them", || {
        cluster
            .slurm(&["squeue", "--noheader", "--me", "--states=all"])
            .is_empty()
    });
    let status = workplace.json(&["status", run_argument, "--hosts"]);
    assert!(
        scenarios(&status).iter().all(|it| it["state"] == "to collect"),
        "{status:#}"
    );
    let collected = workplace.run(&["resume", run_argument, "--submit"]);
    done(&collected);
    all_is_whole(&run, 2, 2);
    assert_eq!(journaled(&run, "environment-created").len(), 2);
    nothing_is_left(&cluster);
}

#[test]
fn a_matrix_that_is_killed_at_any_step_of_a_submission_leaves_one_job_for_each_environment() {
    let cluster = Cluster::start();
    let workplace = &cluster.workplace;
    workplace.write("m.yaml", matrix("constraint: x86_64", &windows(1, 3)));
    // `sbatch` as a user may have it, which dies or has its caller die before, in or after the submission.
    let real = cluster.slurm(&["sh", "-c", "command -v sbatch"]);
    let real = real.trim();
    let bin = workplace.path().join("bin");
    fs::create_dir(&bin).unwrap();
    for tool in ["squeue", "scancel", "sinfo"] {
        let path = cluster.slurm(&["sh", "-c", &format!("command -v {tool}")]);
        std::os::unix::fs::symlink(path.trim(), bin.join(tool)).unwrap();
    }
    let kill = "kill -KILL $(ps -o ppid= $$)";
    for (moment, script) in [
        (
            "before",
            format!("case \"$*\" in *--test-only*) exec {real} \"$@\";; esac; {kill}"),
        ),
        (
            "after",
            format!("case \"$*\" in *--test-only*) exec {real} \"$@\";; esac; {real} \"$@\"; {kill}"),
        ),
    ] {
        let sbatch = bin.join("sbatch");
        fs::write(&sbatch, format!("#!/bin/sh\n{script}\n")).unwrap();
        fs::set_permissions(&sbatch, std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
        workplace.write(
            "killed.yaml",
            matrix(
                &format!("constraint: x86_64, bin: {}", bin.display()),
                &windows(1, 3),
            ),
        );
        let killed = workplace.run(&["run", "killed.yaml", "--out", moment]);
        assert_eq!(killed.code, None, "{moment}: {killed:?}");
        let there = cluster.jobs().len();
        assert_eq!(there, usize::from(moment == "after"), "{moment}");
        // It works again.
        fs::write(&sbatch, format!("#!/bin/sh\nexec {real} \"$@\"\n")).unwrap();
        let runs = workplace.path().join(moment);
        let run = fs::read_dir(&runs).unwrap().next().unwrap().unwrap().path();
        let resumed = workplace.run(&["resume", run.to_str().unwrap()]);
        done(&resumed);
        all_is_whole(&run, 1, 1);
        let creating = journaled(&run, "environment-creating").len();
        let expected = if moment == "after" { 1 } else { 2 };
        assert_eq!(creating, expected, "{moment}: {resumed:?}");
        nothing_is_left(&cluster);
    }
}

#[test]
fn a_node_that_stands_still_is_given_up_and_does_not_write_where_another_does_when_it_goes_on() {
    let cluster = Cluster::start();
    let workplace = &cluster.workplace;
    let (mut running, node) = in_the_second_window(&cluster);
    cluster.node("hang", &node);
    running.wait_for("NODE_FAIL");
    running.wait_for("window 1 collected");
    running.wait_for("environment discarded");
    // It thinks that nothing has happened.
    cluster.node("wake", &node);
    let ran = running.end();
    done(&ran);
    let run = workplace.run_directory();
    all_is_whole(&run, 1, 2);
    let environments: Vec<_> = journaled(&run, "window-collected")
        .iter()
        .map(|it| it["environment"].clone())
        .collect();
    assert_ne!(environments[0], environments[1], "{environments:?}");
    let elsewhere = facts(&run, "x86-64-debian-12-native")["node"].clone();
    assert_ne!(elsewhere, node.as_str());
    nothing_is_left(&cluster);
}

#[test]
fn a_controller_that_is_away_costs_nothing_and_a_job_that_another_cancels_is_told_as_such() {
    let cluster = Cluster::start();
    let workplace = &cluster.workplace;
    workplace.write("m.yaml", matrix("constraint: x86_64", &windows(3, 15)));
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("measuring window 1");
    cluster.controller(false);
    running.wait_for("window 1 complete");
    cluster.controller(true);
    running.wait_for("window 2 complete");
    let jobs = cluster.jobs();
    let [number, ..] = &jobs[0];
    let _ = cluster.slurm(&["scancel", number]);
    let ran = running.end();
    assert_eq!(ran.code, Some(3), "{ran:?}");
    assert!(ran.err.contains("was asked to end, as `scancel` does"), "{ran:?}");
    let run = workplace.run_directory();
    assert_eq!(journaled(&run, "window-collected").len(), 2);
    // What is missing is measured when it is asked for.
    done(&workplace.run(&["resume", run.to_str().unwrap()]));
    all_is_whole(&run, 1, 3);
    nothing_is_left(&cluster);
}

#[test]
fn a_node_that_is_taken_away_for_somebody_elses_job_costs_the_window_that_it_cut() {
    let cluster = Cluster::start();
    let workplace = &cluster.workplace;
    let (running, node) = in_the_second_window(&cluster);
    // Of root's, so that it is none of the jobs that are looked at.
    let urgent = Command::new("sbatch")
        .args([
            "--partition=urgent",
            "--exclusive",
            "--output=/dev/null",
            "--nodelist",
            &node,
        ])
        .args(["--chdir=/", "--wrap=sleep 20"])
        .output()
        .unwrap();
    assert!(urgent.status.success(), "{urgent:?}");
    let ran = running.end();
    done(&ran);
    let run = workplace.run_directory();
    all_is_whole(&run, 1, 2);
    assert_ne!(facts(&run, "x86-64-debian-12-native")["node"], node.as_str());
    assert!(ran.err.contains("PREEMPTED"), "{ran:?}");
    let _ = Command::new("scancel").args(["--user=root"]).status();
    nothing_is_left(&cluster);
}

#[test]
fn a_job_that_slurm_refuses_and_keeps_is_taken_back() {
    let cluster = Cluster::start();
    let script = cluster.workplace.path().join("script");
    fs::write(&script, "#!/bin/sh\nsleep 60\n").unwrap();
    let here: Arc<dyn Host> = Arc::new(Here::new("lab", StateDirectory::of_this_user()));
    let slurm = SlurmCommands::new(here, None);
    let job = JobRequest {
        name: "matrix-refused-1".to_owned(),
        owner: JobOwner {
            run: "r".to_owned(),
            host: "lab".to_owned(),
            scenario: "s".to_owned(),
        },
        wishes: Slurm {
            constraint: Some("i686&debian-12".to_owned()),
            ..Slurm::default()
        },
        script,
        arguments: Vec::new(),
        output: "/dev/null".into(),
        minutes: 1,
        after: None,
        node: None,
        not_on: BTreeSet::new(),
    };
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let refused = runtime.block_on(slurm.submit(&job)).unwrap_err();
    assert!(
        refused.hint().is_some_and(|hint| hint.contains("constraint")),
        "{refused}"
    );
    let jobs = runtime.block_on(slurm.jobs()).unwrap();
    assert!(jobs.iter().all(|job| !job.standing.is_alive()), "{jobs:?}");
    // One of that name that is there is found by it.
    let fits = JobRequest {
        wishes: Slurm::default(),
        ..job
    };
    let number = runtime.block_on(slurm.submit(&fits)).unwrap();
    let jobs = runtime.block_on(slurm.jobs()).unwrap();
    assert!(
        jobs.iter()
            .any(|job| job.id == number && job.owner == Some(fits.owner.clone())),
        "{jobs:?}"
    );
    runtime.block_on(slurm.cancel(&number)).unwrap();
    runtime.block_on(slurm.cancel("4000000")).unwrap();
}

#[test]
fn ctrl_c_and_clean_leave_no_job() {
    let cluster = Cluster::start();
    let workplace = &cluster.workplace;
    let sweep = format!(", reference.amplitude_m: [0.02, 0.03, 0.04]{}", windows(3, 3));
    workplace.write("m.yaml", matrix("constraint: x86_64", &sweep));
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("window 1 complete");
    let ran = running.interrupt();
    assert_eq!(ran.code, Some(130), "{ran:?}");
    assert_eq!(cluster.jobs(), Vec::<[String; 4]>::new());
    let run = workplace.run_directory();
    assert_eq!(
        journaled(&run, "window-collected").len(),
        1,
        "what was whole is there"
    );
    let submitted = workplace.run(&["resume", run.to_str().unwrap(), "--submit"]);
    done(&submitted);
    let jobs = cluster.jobs();
    assert_eq!(jobs.len(), 3, "{submitted:?}");
    let status = workplace.run(&["status"]);
    assert!(status.out.contains("as `matrix` last saw them"), "{status:?}");
    let cleaned = workplace.run(&["clean"]);
    assert_eq!(cleaned.out.matches("removed").count(), 3, "{cleaned:?}");
    for [number, ..] in jobs {
        let told = format!(", whose job {number} was cancelled");
        assert!(cleaned.out.contains(&told), "{told}: {cleaned:?}");
    }
    nothing_is_left(&cluster);
}

/// What the tables are made of.
fn tables(run: &Path) -> Vec<Value> {
    let report = fs::read(run.join("report/report.json")).expect("there is a report");
    let report: Value = serde_json::from_slice(&report).expect("it is JSON");
    ["within", "between", "contrasts", "replicates"]
        .map(|part| report[part].clone())
        .into()
}

#[test]
fn after_a_power_cut_the_tables_are_those_of_an_undisturbed_run_with_the_same_seed() {
    let cluster = Cluster::start();
    let workplace = &cluster.workplace;
    // Computed windows are the same whenever and wherever they are computed, so that nothing but the cut can make a difference. Each has
    // an environment of its own, since the first window of one begins at rest.
    let computed = |connect: &str| {
        format!(
            "hosts: {{lab: {{hardware: x86_64, os: debian-12, connect: {connect}}}}}\nmatrix: {{virtualization: [simulated], \
             reference.amplitude_m: [0.03, 0.05]}}\nworkload: {{windows: 1, environments: 2, window: 1500s, period: 10s}}\n"
        )
    };
    let slurm = format!("{{slurm: {{{QUICK}, constraint: x86_64}}}}");
    workplace.write("cut.yaml", computed(&slurm));
    workplace.write("undisturbed.yaml", computed("local"));
    let running = workplace.start(&["run", "cut.yaml", "--out", "cut"]);
    let is_running = || cluster.jobs().iter().any(|[_, state, ..]| state == "RUNNING");
    cluster.until("a job runs", is_running);
    cluster.node("off", &cluster.running_on());
    let ran = running.end();
    done(&ran);
    assert!(ran.err.contains("NODE_FAIL"), "nothing was cut: {ran:?}");
    done(&workplace.run(&["run", "undisturbed.yaml", "--out", "undisturbed"]));
    let [cut, undisturbed] = ["cut", "undisturbed"].map(|out| {
        let mut runs = fs::read_dir(workplace.path().join(out)).unwrap();
        runs.next().unwrap().unwrap().path()
    });
    all_is_whole(&cut, 2, 2);
    assert_eq!(tables(&cut), tables(&undisturbed));
    assert!(tables(&cut).iter().all(|table| !table.is_null()));
    nothing_is_left(&cluster);
}

#[test]
fn windows_that_no_job_may_measure_in_one_go_are_divided_and_a_job_whose_time_is_over_keeps_what_is_whole() {
    let cluster = Cluster::start();
    let workplace = &cluster.workplace;
    // One that asked for time enough, of which it is given less: Slurm looks at times every half a minute, and ends a job some seconds later.
    workplace.write("over.yaml", matrix("constraint: x86_64", &windows(8, 10)));
    let mut over = workplace.start(&["run", "over.yaml", "--out", "over"]);
    over.wait_for("window 1 complete");
    let [number, ..] = &cluster.jobs()[0];
    let _ = cluster.slurm(&[
        "scontrol",
        "update",
        &format!("jobid={number}"),
        "endtime=now+1seconds",
    ]);
    // 45 s of the minute are for windows: one of 23 s with what is between them.
    workplace.write(
        "m.yaml",
        matrix("partition: brief, constraint: x86_64", &windows(2, 23)),
    );
    let planned = workplace.run(&["plan", "m.yaml"]);
    done(&planned);
    workplace.write(
        "long.yaml",
        matrix("partition: brief, constraint: x86_64", &windows(1, 50)),
    );
    let long = workplace.json(&["plan", "long.yaml"]);
    let reason = long["scenarios"][0]["reason"].as_str().unwrap_or_default();
    assert!(reason.contains("a job may take 1 min there"), "{long:#}");
    assert_eq!(workplace.run(&["run", "long.yaml"]).code, Some(3));
    let ran = workplace.run(&["run", "m.yaml"]);
    done(&ran);
    let run = workplace.run_directory();
    all_is_whole(&run, 1, 2);
    assert_eq!(journaled(&run, "environment-created").len(), 2);
    let ran = over.end();
    assert_eq!(ran.code, Some(3), "{ran:?}");
    assert!(ran.err.contains("TIMEOUT"), "{ran:?}");
    let whole = (1..=8)
        .filter(|window| ran.err.contains(&format!("window {window} collected")))
        .count();
    assert!(
        (1..8).contains(&whole),
        "{whole} windows of the job whose time was over: {ran:?}"
    );
    nothing_is_left(&cluster);
}

#[test]
fn what_the_cluster_does_not_have_is_told_before_anything_is_submitted() {
    let cluster = Cluster::start();
    let workplace = &cluster.workplace;
    for (slurm, reason, fix) in [
        ("constraint: cray", "Invalid feature specification", "sinfo -o"),
        ("constraint: \"i686&debian-12\"", "not available", "constraint"),
        ("partition: night", "nvalid partition", "sinfo -s"),
        (
            "reservation: ours",
            "eservation is invalid",
            "scontrol show reservation",
        ),
        ("bin: /opt/slurm/bin", "there is no program", "connect.slurm.bin"),
        (
            "options: [--no-such-option]",
            "unrecognized option",
            "leave out of `options`",
        ),
    ] {
        workplace.write("m.yaml", matrix(slurm, &windows(1, 3)));
        let planned = workplace.json(&["plan", "m.yaml"]);
        let scenario = &planned["scenarios"][0];
        assert_eq!(scenario["feasible"], false, "{slurm}: {planned:#}");
        let said = |field: &str| scenario[field].as_str().unwrap_or_default().to_owned();
        assert!(said("reason").contains(reason), "{slurm}: {scenario:#}");
        assert!(said("fix").contains(fix), "{slurm}: {scenario:#}");
    }
    // What a node has is looked at in a job, if that is wished.
    workplace.write("m.yaml", matrix("constraint: x86_64", &windows(1, 3)));
    let asked = workplace.run(&["doctor", "m.yaml"]);
    assert!(
        asked
            .out
            .contains("not known yet: host `lab`: what its nodes have is known in a job"),
        "{asked:?}"
    );
    let probed = workplace.json(&["doctor", "m.yaml", "--probe"]);
    let checks = probed["hosts"][0]["checks"].as_array().unwrap();
    let network = checks.iter().find(|check| check["name"] == "network").unwrap();
    assert_eq!(network["available"], true, "{probed:#}");
    let names: Vec<_> = checks
        .iter()
        .map(|check| check["name"].as_str().unwrap())
        .collect();
    assert!(
        names.ends_with(&["clock", "engine", "hardware-and-os"]),
        "{names:?}"
    );
    assert_eq!(probed["hosts"][0]["os"], "debian-12", "{probed:#}");
    // What the job saw of an engine holds, whatever a plan takes for granted.
    let engine = checks.iter().find(|check| check["name"] == "engine").unwrap();
    let providers = probed["hosts"][0]["providers"].as_array().unwrap();
    let docker = providers.iter().find(|it| it["name"] == "docker").unwrap();
    assert_eq!(docker["available"], engine["available"], "{probed:#}");
    // What only the job can know ends it before its first window.
    let other = matrix("constraint: i686", &windows(1, 3));
    workplace.write("m.yaml", other);
    let ran = workplace.run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(3), "{ran:?}");
    assert!(
        ran.err.contains("which is `i686` (to do: write `hardware: i686`"),
        "{ran:?}"
    );
    assert!(!ran.err.contains("left no word of its end"), "{ran:?}");
    assert_eq!(cluster.jobs(), Vec::<[String; 4]>::new());
    // No job makes a virtual machine, and the plan says what one can do.
    workplace.write(
        "machine.yaml",
        matrix("constraint: x86_64", &windows(1, 3)).replace("[native]", "[libvirt]"),
    );
    let planned = workplace.json(&["plan", "machine.yaml"]);
    let reason = planned["scenarios"][0]["reason"].as_str().unwrap();
    assert!(reason.contains("no job of the cluster behind `lab`"), "{reason}");
}

/// A matrix on any node of this machine's kind.
fn in_containers(virtualization: &str, workload: &str) -> String {
    matrix("constraint: x86_64", workload).replace("[native]", virtualization)
}

/// The containers that are an environment's of ours.
fn containers() -> String {
    let mut docker = Command::new("docker");
    docker.args(["ps", "--all", "--quiet", "--filter", "label=matrix.environment"]);
    let listed = docker.output().expect("docker is installed");
    String::from_utf8(listed.stdout).expect("numbers are text")
}

#[test]
fn a_container_on_a_node_measures_as_its_jobs_user_and_ends_with_its_job() {
    let cluster = Cluster::start();
    let workplace = &cluster.workplace;
    cluster.share_the_engine();
    let before = containers();
    workplace.write("m.yaml", in_containers("[native, docker]", &windows(2, 3)));
    let ran = workplace.run(&["run", "m.yaml"]);
    done(&ran);
    let run = workplace.run_directory();
    all_is_whole(&run, 2, 2);
    let facts = facts(&run, "x86-64-debian-12-docker");
    assert!(
        facts["engine_version"]
            .as_str()
            .is_some_and(|version| !version.is_empty()),
        "{facts:#}"
    );
    assert!(
        facts["image_id"]
            .as_str()
            .is_some_and(|id| id.starts_with("sha256:")),
        "{facts:#}"
    );
    assert!(facts["node"].is_string(), "{facts:#}");
    let report = workplace.json(&["report", run.to_str().unwrap()]);
    assert_eq!(scenarios(&report).len(), 2);
    assert_eq!(containers(), before);
    // The engine is this machine's, too, where nodes are not.
    let cleaned = workplace.run(&["clean"]);
    assert!(
        cleaned.out.contains("removed: image matrix-workload:empty"),
        "{cleaned:?}"
    );
    nothing_is_left(&cluster);
}

#[test]
fn a_container_ends_with_the_client_that_a_power_cut_has_ended_and_the_window_is_measured_elsewhere() {
    let cluster = Cluster::start();
    let workplace = &cluster.workplace;
    cluster.share_the_engine();
    let before = containers();
    workplace.write("m.yaml", in_containers("[docker]", &windows(2, 12)));
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("window 1 complete");
    assert_ne!(containers(), before);
    // The engine is not the node's here: it goes on, and all who could take the container back are gone.
    cluster.node("off", &cluster.running_on());
    cluster.until("the container has ended", || containers() == before);
    let ran = running.end();
    done(&ran);
    let run = workplace.run_directory();
    all_is_whole(&run, 1, 2);
    assert_eq!(journaled(&run, "environment-created").len(), 2);
    done(&workplace.run(&["clean"]));
    nothing_is_left(&cluster);
}

#[test]
fn a_node_without_what_a_container_needs_ends_the_scenario_before_its_first_window() {
    let cluster = Cluster::start();
    let workplace = &cluster.workplace;
    let docker = in_containers("[docker]", &windows(1, 3));
    workplace.write("m.yaml", &docker);
    let ran = workplace.run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(3), "{ran:?}");
    assert!(ran.err.contains("permission denied"), "{ran:?}");
    assert!(
        ran.err.contains("let your user use the engine of the nodes"),
        "{ran:?}"
    );
    cluster.share_the_engine();
    workplace.write(
        "m.yaml",
        format!("{docker}providers: {{docker: {{image: nobody-has-it:1}}}}\n"),
    );
    let ran = workplace.run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(3), "{ran:?}");
    assert!(ran.err.contains("nobody-has-it:1"), "{ran:?}");
    assert!(
        ran.err.contains("bring the image to the engine of each node"),
        "{ran:?}"
    );
    workplace.write(
        "m.yaml",
        format!("{docker}providers: {{docker: {{capabilities: [SETGID]}}}}\n"),
    );
    let planned = workplace.json(&["plan", "m.yaml"]);
    let reason = planned["scenarios"][0]["reason"].as_str().unwrap();
    assert!(
        reason.contains("`providers.docker.capabilities` gives nothing"),
        "{reason}"
    );
    done(&workplace.run(&["clean"]));
    nothing_is_left(&cluster);
}

#[test]
fn each_node_measures_every_scenario_and_a_mean_that_is_not_expected_ends_with_7() {
    let cluster = Cluster::start();
    let workplace = &cluster.workplace;
    let file = matrix("constraint: x86_64, nodes: each", &windows(3, 3));
    workplace.write(
        "m.yaml",
        format!("{file}report: {{expect: {{error: {{value: 1mm, above: 5%}}}}}}\n"),
    );
    let ran = workplace.run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(7), "{ran:?}");
    assert!(
        ran.out.contains("Not as expected: the error of a (node n1) is"),
        "{ran:?}"
    );
    let run = workplace.run_directory();
    all_is_whole(&run, 2, 3);
    for node in ["n1", "n2"] {
        let slug = format!("x86-64-debian-12-native-node-{node}");
        assert_eq!(facts(&run, &slug)["node"], node);
    }
    let report = fs::read(run.join("report/report.json")).unwrap();
    let report: Value = serde_json::from_slice(&report).unwrap();
    let nodes = &report["conclusions"][0];
    assert_eq!(
        (&nodes["axis"], &nodes["first"], &nodes["second"]),
        (&"node".into(), &"n1".into(), &"n2".into())
    );
    // One that is out of service is left out and named; what no node is, is an error.
    cluster.node("drain", "n2");
    let planned = workplace.json(&["plan", "m.yaml"]);
    cluster.node("undrain", "n2");
    assert_eq!(scenarios(&planned).len(), 1, "{planned:#}");
    assert!(
        planned["warnings"].to_string().contains("node `n2` is drained"),
        "{planned:#}"
    );
    workplace.write("m.yaml", matrix("nodes: each, constraint: cray", &windows(1, 3)));
    let refused = workplace.run(&["plan", "m.yaml"]);
    assert_eq!(refused.code, Some(2), "{refused:?}");
    assert!(
        refused.err.contains("Invalid feature specification"),
        "{refused:?}"
    );
    nothing_is_left(&cluster);
}

#[test]
fn a_shared_folder_that_is_full_is_told_and_what_was_whole_is_kept() {
    let cluster = Cluster::start();
    let workplace = &cluster.workplace;
    let small = Path::new("/home/researcher/small");
    let root = small.join("root");
    workplace.write(
        "m.yaml",
        matrix(
            &format!("constraint: x86_64, root: {}", root.display()),
            &windows(2, 8),
        ),
    );
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("window 1 complete");
    let filler = small.join("filler");
    let _ = fs::write(&filler, vec![0_u8; 24 << 20]);
    let ran = running.end();
    fs::remove_file(&filler).unwrap();
    assert_eq!(ran.code, Some(3), "{ran:?}");
    let run = workplace.run_directory();
    assert_eq!(journaled(&run, "window-collected").len(), 1);
    done(&workplace.run(&["resume", run.to_str().unwrap()]));
    all_is_whole(&run, 1, 2);
    nothing_is_left(&cluster);
    fs::remove_dir_all(&root).unwrap();
}
