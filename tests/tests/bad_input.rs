//! Whatever is wrong with what a user gives: one clear error, exit code 2, nothing overwritten, no panic.

use std::{fs::File, io::Read, process::Stdio};

use nix::pty::openpty;
use rstest::rstest;
use tests::{Ran, Workplace, without_checksums};

fn refused(ran: &Ran, words: &[&str]) {
    assert_eq!(ran.code, Some(2), "{ran:?}");
    assert!(!ran.err.contains("panicked"), "{ran:?}");
    assert_eq!(ran.out, "", "{ran:?}");
    for word in words {
        assert!(ran.err.contains(word), "{word:?} is not in:\n{}", ran.err);
    }
}

#[rstest]
#[case::not_yaml("matrix: [native", &["m.yaml:"])]
#[case::empty("", &["m.yaml", "empty"])]
#[case::unknown_key("matirx:\n  virtualization: [native]\n", &["m.yaml:1:1", "matirx", "`matrix`"])]
#[case::misspelt_value("matrix:\n  virtualization: [dokcer]\n", &["m.yaml:2:20", "dokcer", "docker"])]
#[case::no_unit("workload:\n  window: 6000\n", &["m.yaml:2:11", "6000", "unit"])]
#[case::wrong_unit("workload:\n  network: {delay: 10Mbit}\n", &["m.yaml:2:20", "Mbit", "ms"])]
#[case::empty_axis("matrix:\n  virtualization: []\n", &["m.yaml:2", "empty"])]
#[case::duplicate_key("matrix:\n  virtualization: [native]\n  virtualization: [docker]\n", &["m.yaml:3:3", "virtualization"])]
#[case::duplicate_host("hosts:\n  one: {connect: local}\n  one: {connect: local}\n", &["m.yaml:3:3", "one"])]
fn a_wrong_matrix_file_is_refused_at_its_place(#[case] text: &str, #[case] words: &[&str]) {
    let workplace = Workplace::new();
    workplace.write("m.yaml", text);
    for command in ["check", "plan", "run"] {
        refused(&workplace.run(&[command, "m.yaml"]), words);
    }
    assert!(!workplace.path().join("runs").exists(), "nothing was created");
}

#[test]
fn whoever_asks_for_json_gets_the_mistakes_as_json() {
    let workplace = Workplace::new();
    workplace.write("m.yaml", "matirx: {}\nworkload:\n  window: 6000\n");
    let ran = workplace.run(&["check", "m.yaml", "--json"]);
    assert_eq!((ran.code, ran.err.as_str()), (Some(2), ""), "{ran:?}");
    insta::assert_snapshot!(ran.out);
    for command in ["plan", "run"] {
        let other = workplace.run(&[command, "m.yaml", "--json"]);
        assert_eq!((other.code, other.out), (ran.code, ran.out.clone()));
    }
}

#[rstest]
#[case::report(&["report", "nowhere"], "nowhere")]
#[case::resume(&["resume", "nowhere"], "nowhere")]
#[case::status(&["status", "nowhere"], "nowhere")]
#[case::ks(&["ks", "x", "y"], "x")]
fn whoever_asks_for_json_gets_a_failure_as_json(#[case] arguments: &[&str], #[case] named: &str) {
    let workplace = Workplace::new();
    let failure = workplace.json(arguments);
    assert_eq!(
        (&failure["ok"], &failure["exit_code"]),
        (&false.into(), &2.into())
    );
    assert!(
        failure["message"].as_str().unwrap().contains(named),
        "{failure:#}"
    );
    assert!(failure["hint"].is_string(), "{failure:#}");
}

/// What a wrong file looks like on a terminal of its own, with one more variable in the environment.
fn on_a_terminal(variable: (&str, &str)) -> String {
    let workplace = Workplace::new();
    workplace.write("m.yaml", "matirx: {}\n");
    let terminal = openpty(None, None).unwrap();
    let mut command = workplace.matrix(["check", "m.yaml"]);
    for name in ["NO_COLOR", "CLICOLOR", "CLICOLOR_FORCE"] {
        command.env_remove(name);
    }
    command.env("TERM", "xterm-256color").env(variable.0, variable.1);
    let status = command.stderr(Stdio::from(terminal.slave)).status().unwrap();
    assert_eq!(status.code(), Some(2));
    // The other end must be closed for the reading to end, and then the kernel says EIO.
    drop(command);
    let mut shown = Vec::new();
    let _ = File::from(terminal.master).read_to_end(&mut shown);
    String::from_utf8(shown).unwrap()
}

#[test]
fn a_terminal_shows_mistakes_in_colours_unless_it_was_asked_not_to() {
    let coloured = on_a_terminal(("LANG", "C.UTF-8"));
    assert!(
        coloured.contains("matirx") && coloured.contains('\u{1b}'),
        "{coloured:?}"
    );
    let plain = on_a_terminal(("NO_COLOR", "1"));
    assert!(plain.contains("matirx") && !plain.contains('\u{1b}'), "{plain:?}");
}

#[test]
fn ten_megabytes_of_nesting_are_refused_at_once() {
    let workplace = Workplace::new();
    workplace.write("m.yaml", "[".repeat(10_000_000));
    refused(&workplace.run(&["check", "m.yaml"]), &["m.yaml"]);
}

#[test]
fn what_is_not_utf8_is_refused() {
    let workplace = Workplace::new();
    workplace.write("m.yaml", [0x6d, 0xff, 0xfe]);
    refused(&workplace.run(&["check", "m.yaml"]), &["m.yaml", "UTF-8"]);
}

#[test]
fn a_selection_that_matches_nothing_says_what_there_is() {
    let workplace = Workplace::new();
    workplace.write("m.yaml", "matrix:\n  virtualization: [fake]\n");
    refused(
        &workplace.run(&["plan", "m.yaml", "--only", "virtualization=docker"]),
        &["virtualization=docker"],
    );
}

#[test]
fn a_missing_file_or_run_is_named() {
    let workplace = Workplace::new();
    refused(&workplace.run(&["check", "nowhere.yaml"]), &["nowhere.yaml"]);
    for command in ["report", "resume", "status"] {
        refused(&workplace.run(&[command, "nowhere"]), &["nowhere"]);
    }
}

#[test]
fn an_empty_folder_is_not_a_run_and_stays_empty() {
    let workplace = Workplace::new();
    std::fs::create_dir(workplace.path().join("folder")).unwrap();
    for command in ["report", "resume", "status"] {
        refused(&workplace.run(&[command, "folder"]), &["folder"]);
    }
    assert_eq!(
        std::fs::read_dir(workplace.path().join("folder"))
            .unwrap()
            .count(),
        0
    );
}

const FAKE: &str = "\
matrix:
  virtualization: [fake]
workload:
  windows: 2
  window: 8s
  period: 1s
";

#[test]
fn a_run_of_a_future_format_is_refused() {
    let workplace = Workplace::new();
    workplace.write("m.yaml", FAKE);
    assert_eq!(workplace.run(&["run", "m.yaml"]).code, Some(0));
    let directory = workplace.run_directory();
    without_checksums(&directory);
    let manifest = directory.join("manifest.json");
    let text = std::fs::read_to_string(&manifest).unwrap();
    std::fs::write(&manifest, text.replacen("\"format\": 1", "\"format\": 99", 1)).unwrap();
    for command in ["report", "resume", "status"] {
        refused(&workplace.run(&[command, directory.to_str().unwrap()]), &["99"]);
    }
}

#[rstest]
#[case::nan("NaN")]
#[case::cut("0.1,0.2")]
fn a_log_that_was_tampered_with_is_named_and_not_counted(#[case] tail: &str) {
    let workplace = Workplace::new();
    workplace.write("m.yaml", FAKE);
    assert_eq!(workplace.run(&["run", "m.yaml"]).code, Some(0));
    let directory = workplace.run_directory();
    let scenario = workplace.scenario_directory();
    let log = scenario.join("window-2/control.csv");
    let mut text = std::fs::read_to_string(&log).unwrap();
    text.push_str(tail);
    std::fs::write(&log, text).unwrap();
    let ran = workplace.run(&["report", directory.to_str().unwrap()]);
    assert!(!ran.err.contains("panicked"), "{ran:?}");
    assert!(
        format!("{}{}", ran.out, ran.err).contains("control.csv"),
        "the file is named: {ran:?}"
    );
}

#[rstest]
#[case::text("1\nzwei\n", &["x: line 2", "zwei"])]
#[case::nothing("", &["x"])]
#[case::infinite("1\ninf\n", &["x", "inf"])]
#[case::not_a_number("1\nNaN\n", &["x", "NaN"])]
fn a_ks_file_that_is_not_a_sample_is_refused(#[case] text: &str, #[case] words: &[&str]) {
    let workplace = Workplace::new();
    workplace.write("x", text);
    workplace.write("y", "1\n2\n");
    refused(&workplace.run(&["ks", "x", "y"]), words);
}

#[test]
fn ks_prints_the_papers_limit_case() {
    let workplace = Workplace::new();
    let x: Vec<String> = (0..60).map(|i| i.to_string()).collect();
    let y: Vec<String> = (22..82).map(|i| i.to_string()).collect();
    workplace.write("x", x.join("\n"));
    workplace.write("y", y.join("\n"));
    let test = workplace.json(&["ks", "x", "y"]);
    assert_eq!(
        (&test["h"], &test["lcm"], &test["method"]),
        (&22.into(), &60.into(), &"exact".into())
    );
    let p = test["p"].as_f64().unwrap();
    assert!((p / 0.000_556_971_061_145_461_7 - 1.0).abs() < 1e-12, "{test:#}");
}

#[test]
fn doctor_of_a_file_of_which_nothing_can_run_says_so_and_ends_with_3() {
    let workplace = Workplace::new();
    workplace.write("none.yaml", "matrix: {virtualization: [native], os: [plan-9]}\n");
    let ran = workplace.run(&["doctor", "none.yaml"]);
    assert_eq!(ran.code, Some(3), "{ran:?}");
    assert!(
        ran.err
            .contains("no scenario of the file can run: `matrix plan none.yaml`"),
        "{ran:?}"
    );
}
