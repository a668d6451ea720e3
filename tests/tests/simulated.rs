//! A matrix whose scenarios are computed: without rights, without the hosts that it names, and with all that a measured run leaves.

#![allow(clippy::unwrap_used, clippy::panic)] // What tests may, but clippy knows only functions that are tests themselves.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

use record::platform_model::{PlatformModel, Quantiles};
use rstest::rstest;
use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};
use tests::{Ran, Workplace};

/// On this machine and on one that nobody can reach.
const MATRIX: &str = "\
matrix:
  hardware: [near, aarch64]
  os: [any]
  virtualization: [native, docker]
hosts:
  here: {hardware: near, os: any}
  far: {hardware: aarch64, os: any, connect: {ssh: nobody@192.0.2.1}}
workload: {dynamics: author, windows: 2, window: 100s, period: 5s}
";

/// Two that differ in their platforms alone.
const ON_PLATFORMS: &str = "\
matrix: {hardware: [any], os: [any], virtualization: [simulated], labels: {of: [quick, slow]}}
hosts: {here: {hardware: any, os: any}}
providers: {simulated: {platforms: platforms}}
workload: {windows: 2, window: 100s, period: 5s}
";
const QUICK: &str = "platforms/any-any-simulated-of-quick.yaml";
const SLOW: &str = "platforms/any-any-simulated-of-slow.yaml";

fn workplace(file: &str) -> Workplace {
    let workplace = Workplace::new();
    workplace.write("m.yaml", file);
    fs::create_dir(workplace.path().join("platforms")).unwrap();
    workplace
}

fn succeeds(ran: &Ran) {
    assert_eq!(ran.code, Some(0), "{ran:?}");
}

/// The SHA-256 of each window's files, by scenario and window.
fn checksums(run: &Path) -> BTreeMap<String, Value> {
    let mut all = BTreeMap::new();
    for scenario in fs::read_dir(run.join("scenarios")).unwrap() {
        let scenario = scenario.unwrap();
        for window in [1, 2] {
            let record = scenario.path().join(format!("window-{window}/window.json"));
            let record: Value = serde_json::from_slice(&fs::read(record).unwrap()).unwrap();
            assert_eq!(record["verdict"], "valid");
            let files = record["files"].as_array().unwrap().iter();
            let sums = files.map(|file| file["sha256"].as_str());
            let name = format!("{} {window}", scenario.file_name().display());
            all.insert(name, json!(sums.collect::<Vec<_>>()));
        }
    }
    all
}

#[test]
fn a_matrix_of_hosts_that_are_far_is_computed_here_and_the_same_again() {
    let workplace = workplace(MATRIX);
    let report = workplace.json(&["run", "m.yaml", "--simulated"]);
    assert_eq!(report["simulated"], true);
    let scenarios = report["scenarios"].as_array().unwrap();
    assert_eq!(scenarios.len(), 4);
    for scenario in scenarios {
        assert_eq!(scenario["simulated"], true, "{scenario:#}");
        assert_eq!(scenario["outcome"], "completed", "{scenario:#}");
    }
    let remarks = report["remarks"].to_string();
    let words = "SIMULATED, NOT MEASURED: scenarios a, b, c, d were computed.";
    assert!(remarks.contains(words), "{remarks}");
    let run = workplace.run_directory();
    for command in ["status", "calibrate", "replay"] {
        let told = workplace.run(&[command, run.to_str().unwrap()]).out;
        assert!(told.contains("(simulated, not measured)"), "{told}");
    }
    let first = checksums(&run);
    // No two windows have the same data, also of scenarios that differ in nothing that is computed.
    let distinct: BTreeSet<String> = first.values().map(Value::to_string).collect();
    assert_eq!((first.len(), distinct.len()), (8, 8));
    fs::rename(&run, workplace.path().join("first")).unwrap();
    succeeds(&workplace.run(&["run", "m.yaml", "--simulated"]));
    assert_eq!(checksums(&workplace.run_directory()), first);
}

#[test]
fn a_run_that_was_killed_with_scenarios_under_way_goes_on_computing() {
    let workplace = workplace(MATRIX);
    // Side by side where there are two processors.
    let mut running = workplace.start(&["run", "m.yaml", "--simulated"]);
    running.wait_for("measuring window 1");
    running.wait_for("measuring window 1");
    running.kill();
    let run = workplace.run_directory();
    succeeds(&workplace.run(&["resume", run.to_str().unwrap()]));
    assert_eq!(checksums(&run).len(), 8);
    fs::remove_dir_all(run.join("scenarios/aarch64-any-docker/window-2")).unwrap();
    succeeds(&workplace.run(&["resume", run.to_str().unwrap()]));
    assert_eq!(checksums(&run).len(), 8);
}

#[test]
fn a_scenario_is_on_the_platform_of_its_file() {
    let workplace = workplace(ON_PLATFORMS);
    workplace.write(QUICK, "{}");
    workplace.write(SLOW, "controller: {late: [[0, 1ms], [1, 3ms]]}\nstack: 4ms\n");
    succeeds(&workplace.run(&["run", "m.yaml"]));
    let lateness = |of: &str| {
        let window = format!("scenarios/any-any-simulated-of-{of}/window-1/window.json");
        let record = fs::read(workplace.run_directory().join(window)).unwrap();
        let record: Value = serde_json::from_slice(&record).unwrap();
        record["controller"]["lateness_p50_ns"].as_f64()
    };
    assert_eq!(lateness("quick"), Some(0.0));
    let slow = lateness("slow").unwrap();
    assert!((1.9e6..2.1e6).contains(&slow), "{slow}");
}

#[rstest]
#[case::none("", "there is no platform for `any-any-simulated-of-slow`", "m.yaml:3")]
#[case::no_unit("stack: 3", "`3` has no unit", "any-any-simulated-of-slow.yaml:1:8")]
#[case::descending(
    "reading: [[0, 3us], [1, 1us]]",
    "`reading`: the quantiles do not ascend",
    "any-any-simulated-of-slow.yaml:1:1"
)]
fn a_platform_that_is_none_is_told_before_anything_runs(
    #[case] text: &str,
    #[case] words: &str,
    #[case] place: &str,
) {
    let workplace = workplace(ON_PLATFORMS);
    workplace.write(QUICK, "{}");
    if !text.is_empty() {
        workplace.write(SLOW, text);
    }
    for command in ["check", "run"] {
        let ran = workplace.run(&[command, "m.yaml"]);
        assert_eq!(ran.code, Some(2), "{ran:?}");
        assert!(ran.err.contains(words) && ran.err.contains(place), "{}", ran.err);
    }
    assert!(!workplace.path().join("runs").exists());
}

#[test]
fn what_only_a_computed_scenario_has_is_no_axis_of_a_measured_one() {
    let workplace = workplace(
        "matrix: {virtualization: [native, simulated], simulation.platform.stack: [1ms, 2ms]}\n\
         workload: {windows: 1, window: 100s, period: 5s}\n",
    );
    let ran = workplace.run(&["check", "m.yaml"]);
    let words = "`simulation.platform.stack` says nothing of a scenario that is measured";
    assert!(ran.code == Some(2) && ran.err.contains(words), "{ran:?}");
    let planned = workplace.json(&["plan", "m.yaml", "--simulated"]);
    let scenarios = planned["scenarios"].as_array().unwrap();
    assert!(
        scenarios.len() == 4 && scenarios.iter().all(|it| it["feasible"] == true),
        "{planned:#}"
    );
}

/// The mean |e_x| of each period of 5 s, a line each.
fn errors(run: &Path) -> String {
    let mut lines = String::new();
    for window in [1, 2] {
        let log = run.join(format!("scenarios/any-any-simulated/window-{window}/control.csv"));
        let log = fs::read_to_string(log).unwrap();
        let error = |line: &str| {
            let fields: Vec<f64> = line.split(',').map(|field| field.parse().unwrap()).collect();
            (fields[4] - fields[9]).abs()
        };
        let errors: Vec<f64> = log.lines().skip(1).map(error).collect();
        for period in errors.chunks(250) {
            lines += &format!("{}\n", period.iter().sum::<f64>() / period.len() as f64);
        }
    }
    lines
}

/// The platform that a run was put on is found again in its logs and captures, and the matrix can be computed on that.
#[test]
fn a_platform_is_found_again_in_what_it_did() {
    let workplace = workplace(
        "matrix: {hardware: [any], os: [any], virtualization: [simulated]}\nhosts: {here: {hardware: any, os: any}}\n\
         providers: {simulated: {platforms: platforms}}\n\
         workload: {dynamics: robust, environments: 2, windows: 1, window: 500s, period: 5s}\n",
    );
    workplace.write(
        "platforms/any-any-simulated.yaml",
        "controller: {late: [[0, 20us], [0.9, 200us], [1, 4ms]], persistence: 40%}\n\
         plant: {late: [[0, 50us], [1, 150us]]}\n\
         stalls: {per_hour: 360, length: [[0, 60ms], [1, 100ms]]}\n\
         stack: 300us\nreading: [[0, 30us], [1, 90us]]\n",
    );
    succeeds(&workplace.run(&["run", "m.yaml"]));
    let run = workplace.run_directory();
    let run = run.to_str().unwrap();
    succeeds(&workplace.run(&["fit", run, "--output", "found"]));
    let text = fs::read_to_string(workplace.path().join("found/any-any-simulated.yaml")).unwrap();
    let found: PlatformModel = serde_yaml::from_str(&text).unwrap();
    let is_near =
        |found: f64, is: f64, within: f64| assert!((found - is).abs() < within, "{found} {is} {text}");
    let us = |quantiles: &Quantiles, p: f64| quantiles.at_ns(p) as f64 / 1000.0;
    // 50 000 ticks, 100 stalls: five standard deviations or more.
    is_near(us(&found.controller.late, 0.5), 120.0, 4.0);
    is_near(us(&found.controller.late, 0.99), 3620.0, 150.0);
    is_near(found.controller.persistence.probability(), 0.4, 0.02);
    is_near(us(&found.plant.late, 0.5), 100.0, 2.0);
    is_near(found.plant.persistence.probability(), 0.0, 0.02);
    is_near(found.stalls.per_hour, 360.0, 180.0);
    is_near(us(&found.stalls.length, 0.5) / 1000.0, 80.0, 10.0);
    is_near(found.stack.as_secs_f64() * 1e6, 300.0, 30.0);
    is_near(us(&found.reading, 0.5), 60.0, 5.0);
    // What waited for the end of a stall is none, in the second environment either.
    is_near(us(&found.reading, 1.0), 90.0, 5.0);

    let again = workplace.run(&["fit", run, "--output", "found"]);
    assert!(
        again.code == Some(2) && again.err.contains("name another folder"),
        "{again:?}"
    );
    fs::rename(run, workplace.path().join("first")).unwrap();
    succeeds(&workplace.run(&["run", "m.yaml", "--platforms", "found"]));
    workplace.write("first.txt", errors(&workplace.path().join("first")));
    workplace.write("again.txt", errors(&workplace.run_directory()));
    let compared = workplace.json(&["ks", "first.txt", "again.txt"]);
    assert_eq!(
        (&compared["n"], &compared["m"]),
        (&json!(200), &json!(200)),
        "{compared:#}"
    );
    assert!(compared["p"].as_f64().unwrap() > 0.01, "{compared:#}");
}

/// A text without its line breaks.
fn words(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Of each factor the ends of its interval with its part between them, in metres.
fn parts(explanation: &Value) -> BTreeMap<String, [f64; 3]> {
    let parts = explanation["parts"].as_array().unwrap().iter();
    let of = |part: &Value| {
        let [low, high] = [0, 1].map(|end| part["interval_m"][end].as_f64().unwrap());
        [low, part["part_m"].as_f64().unwrap(), high]
    };
    parts
        .map(|part| (part["factor"].as_str().unwrap().to_owned(), of(part)))
        .collect()
}

/// Differences that were made are laid where they belong.
#[test]
fn what_makes_two_scenarios_differ_is_found() {
    let workplace = workplace(
        "matrix: {virtualization: [simulated], network.delay: [10ms, 12ms], network.loss: [0.5%, 2%]}\n\
         workload: {windows: 5, window: 40s, period: 4s, reference: {amplitude_m: 0.03}}\n",
    );
    succeeds(&workplace.run(&["run", "m.yaml"]));
    let run = workplace.run_directory();
    let explain = |other: &str| workplace.json(&["explain", run.to_str().unwrap(), "a", other]);
    // b loses more, c delays more.
    for (other, cause, none) in [("b", "losses", "delays"), ("c", "delays", "losses")] {
        let explained = &explain(other)[0]["explanation"];
        assert_eq!(
            json!([explained["unit"], explained["units"]]),
            json!(["windows", 5])
        );
        let parts = parts(explained);
        assert!(parts[cause][0] > 0.0, "{explained:#}");
        assert!(parts[cause][1] > 3.0 * parts[none][1].abs(), "{explained:#}");
        assert_eq!([parts["lateness"], parts["stalls"]], [[0.0; 3]; 2]);
        let sum: f64 = parts.values().map(|[_, part, _]| part).sum();
        let [whole, measured, rest] =
            ["simulated_m", "difference_m", "unexplained_m"].map(|field| explained[field].as_f64().unwrap());
        assert!(
            (sum - whole).abs() < 1e-9 && (measured - whole - rest).abs() < 1e-9,
            "{explained:#}"
        );
        let of_distances = explained["parts"].as_array().unwrap().iter();
        let sum: f64 = of_distances.map(|part| part["part_d"].as_f64().unwrap()).sum();
        assert!(
            (sum - explained["simulated_d"].as_f64().unwrap()).abs() < 1e-9,
            "{explained:#}"
        );
    }
    let ran = workplace.run(&["explain", run.to_str().unwrap(), "a", "x"]);
    assert!(
        ran.code == Some(2) && ran.err.contains("write one of a, b, c, d"),
        "{ran:?}"
    );
}

#[test]
fn a_report_says_of_each_pair_that_differs_what_its_difference_comes_from() {
    let workplace = workplace(
        "matrix: {virtualization: [simulated], network.delay: [10ms, 12ms], network.jitter: [0ms, 0.1ms]}\n\
         workload: {windows: 6, window: 40s, period: 4s, reference: {amplitude_m: 0.03}}\n\
         report: {alpha: 0.05, family: [[a, b], [a, c]]}\n",
    );
    succeeds(&workplace.run(&["run", "m.yaml"]));
    let run = workplace.run_directory();
    let run = run.to_str().unwrap();
    let report = workplace.json(&["report", run]);
    assert!(report.get("causes").is_none(), "{report:#}");
    let report = workplace.json(&["report", run, "--explain"]);
    let causes = report["causes"].as_array().unwrap();
    assert_eq!(causes.len(), 1, "{report:#}");
    assert_eq!(json!([causes[0]["a"], causes[0]["b"]]), json!(["a", "c"]));
    assert!(parts(&causes[0]["explanation"])["delays"][0] > 0.0, "{causes:#?}");
    let folder = workplace.run_directory().join("report");
    let text = words(&fs::read_to_string(folder.join("tables.md")).unwrap());
    assert!(
        text.contains("Why they differ") && text.contains("The largest part is delays of messages"),
        "{text}"
    );
    assert!(
        folder.join("figures/causes-a-c.svg").is_file() && folder.join("figures/causes-a-c.pdf").is_file()
    );
    // The same pairs without a report.
    assert_eq!(workplace.json(&["explain", run])[0]["a"], "a");
    let ran = workplace.run(&["report", run, run, "--explain", "--output", "both"]);
    assert!(
        ran.code == Some(2) && ran.err.contains("give one run directory alone"),
        "{ran:?}"
    );
}

/// The delay of a link's end goes from 10 to 12 ms with the last night.
#[test]
fn a_drift_of_the_error_is_told_with_what_it_comes_from() {
    let workplace = workplace("");
    for (night, delay) in (1..).zip(["10ms", "10ms", "10ms", "10ms", "10ms", "13ms"]) {
        workplace.write(
            "m.yaml",
            format!(
                "matrix: {{virtualization: [simulated]}}\n\
                 workload: {{windows: 4, window: 40s, period: 4s, reference: {{amplitude_m: 0.03}}, network: {{delay: {delay}}}, \
                 simulation: {{seed: {night}}}}}\n"
            ),
        );
        succeeds(&workplace.run(&["run", "m.yaml"]));
    }
    let runs = fs::read_dir(workplace.path().join("runs")).unwrap();
    let runs = runs
        .map(|entry| entry.unwrap().path())
        .filter(|path| !path.is_symlink());
    let mut runs: Vec<String> = runs.map(|path| path.to_str().unwrap().to_owned()).collect();
    runs.sort();
    let mut arguments = vec![
        "drift",
        "--json",
        "--webhook",
        "told.json",
        "--candidate",
        &runs[5],
        "--baseline",
    ];
    arguments.extend(runs[..5].iter().map(String::as_str));
    let told: Value = serde_json::from_str(&workplace.run(&arguments).out).unwrap();
    let judgements = told["judgements"].as_array().unwrap();
    let of_error = judgements.iter().find(|it| it["metric"] == "error").unwrap();
    let explanation = &of_error["findings"][0]["explained"]["explanation"];
    for (run, path) in explanation["runs"].as_array().unwrap().iter().zip(&runs[4..]) {
        assert!(path.ends_with(run.as_str().unwrap()), "{explanation:#}");
    }
    assert!(parts(explanation)["delays"][0] > 0.0, "{explanation:#}");
    let webhook = fs::read_to_string(workplace.path().join("told.json")).unwrap();
    assert!(webhook.contains(
        "changed with it: settings.network.delay, settings.simulation.seed. The largest part is delays of"
    ));
}

#[test]
fn scenarios_of_other_experiments_are_not_explained() {
    let workplace = workplace(
        "matrix: {virtualization: [simulated], control.position.kp: [-1.312, -1.2]}\n\
         workload: {windows: 1, window: 100s, period: 5s}\n",
    );
    succeeds(&workplace.run(&["run", "m.yaml"]));
    let ran = workplace.run(&["explain", workplace.run_directory().to_str().unwrap(), "a", "b"]);
    let words = "a and b differ in control.position.kp, which no platform explains";
    assert!(ran.code == Some(2) && ran.err.contains(words), "{ran:?}");
}

#[rstest]
#[case::author("author")]
#[case::robust("robust")]
fn a_run_replays_and_one_whose_log_was_changed_says_where_it_parts(#[case] dynamics: &str) {
    let workplace = workplace(&format!(
        "matrix: {{virtualization: [simulated]}}\n\
         workload: {{dynamics: {dynamics}, windows: 3, window: 100s, period: 5s}}\n"
    ));
    succeeds(&workplace.run(&["run", "m.yaml"]));
    let run = workplace.run_directory();
    let replay = ["replay", run.to_str().unwrap()];
    let replayed = workplace.json(&replay);
    let same = json!({
        "reason": null, "periods": 20, "largest_difference_m": 0.0, "mean_difference_m": 0.0, "parts": null,
    });
    for (window, number) in replayed["scenarios"][0]["windows"]
        .as_array()
        .unwrap()
        .iter()
        .zip(1..)
    {
        let mut same = same.clone();
        same["window"] = json!(number);
        assert_eq!(*window, same);
    }
    succeeds(&workplace.run(&replay));

    // One position of the second window, by 3 mm.
    let window = workplace.scenario_directory().join("window-2");
    let log = fs::read_to_string(window.join("control.csv")).unwrap();
    let mut lines: Vec<String> = log.lines().map(str::to_owned).collect();
    let mut fields: Vec<String> = lines[1234].split(',').map(str::to_owned).collect();
    fields[9] = (fields[9].parse::<f64>().unwrap() + 0.003).to_string();
    let step: u64 = fields[0].parse().unwrap();
    lines[1234] = fields.join(",");
    let changed = lines.join("\n") + "\n";
    fs::write(window.join("control.csv"), &changed).unwrap();
    let ran = workplace.run(&replay);
    assert!(
        ran.code == Some(2) && ran.out.contains("window 2: no period was replayed"),
        "{ran:?}"
    );
    let of_the_next = "window 3: no period was replayed; SUSPECT: not replayed to its end: the window before it, from which it goes on, \
                       cannot be replayed";
    assert!(ran.out.contains(of_the_next), "{ran:?}");

    // Whoever changes it may change its checksum, too.
    let record = window.join("window.json");
    let mut sealed: Value = serde_json::from_slice(&fs::read(&record).unwrap()).unwrap();
    let file = sealed["files"]
        .as_array_mut()
        .unwrap()
        .iter_mut()
        .find(|file| file["name"] == "control.csv");
    let file = file.unwrap();
    file["sha256"] = json!(format!("{:x}", Sha256::digest(&changed)));
    file["bytes"] = json!(changed.len());
    fs::write(&record, sealed.to_string()).unwrap();
    tests::without_checksums(&run);
    let replayed = workplace.json(&replay);
    let windows = replayed["scenarios"][0]["windows"].as_array().unwrap();
    assert_eq!(windows[1]["parts"]["log"], "control.csv", "{replayed:#}");
    assert_eq!(windows[1]["parts"]["step"], json!(step));
    let of_one_step = windows[1]["largest_difference_m"].as_f64().unwrap() * 250.0;
    assert!((of_one_step - 0.003).abs() < 1e-9, "{of_one_step}");
    assert_eq!(
        (&windows[0]["parts"], &windows[2]["parts"]),
        (&Value::Null, &Value::Null)
    );
    let report = workplace.json(&["report", run.to_str().unwrap(), "--replay"]);
    assert_eq!(report["replays"], replayed["scenarios"]);
    let remarks = report["remarks"].to_string();
    assert!(
        remarks.contains("Windows of a do not give their errors again"),
        "{remarks}"
    );
    let tables = words(&fs::read_to_string(run.join("report/tables.md")).unwrap());
    let doubt =
        format!("a window 2: from step {step} of control.csv on positions differ, there by 3000.0000 µm.");
    assert!(tables.contains(&doubt), "{tables}");
}

#[test]
fn two_names_of_one_machine_wait_for_each_other() {
    let workplace = workplace(
        "hosts: {one: {hardware: a}, two: {hardware: b}}\n\
         matrix: {hardware: [a, b], virtualization: [simulated], network.delay: [9ms, 11ms]}\n\
         workload: {windows: 2, window: 100s, period: 5s}\n",
    );
    let report = workplace.json(&["run", "m.yaml"]);
    let scenarios = report["scenarios"].as_array().unwrap();
    assert!(
        scenarios.iter().all(|it| it["outcome"] == "completed"),
        "{scenarios:#?}"
    );
}

#[test]
fn a_command_is_not_computed() {
    let workplace = workplace(
        "matrix: {}\nexperiment:\n  name: e\n  run: [\"true\"]\n  metrics: [{name: m, from: m.csv}]\n",
    );
    let planned = workplace.json(&["plan", "m.yaml", "--simulated"]);
    let reason = planned["scenarios"][0]["reason"].as_str().unwrap();
    assert_eq!(
        reason,
        "`simulated` computes the ball on the plate, and no command's numbers"
    );
}
