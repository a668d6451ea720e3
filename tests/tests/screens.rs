//! The screens of docs/screens.md, which are what the program prints. After a change of words, `MATRIX_UPDATE_SCREENS=1 cargo test --test
//! screens` writes them anew, for a person to read before they are committed.

use std::{env, fs, path::Path, process::Command};

use rstest::rstest;
use tests::Workplace;

const DOCS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/screens.md");
const ROOMS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/rooms");

/// The experiment of examples/rooms, for a history.
const NIGHT: &str = "\
hosts:
  desk: {hardware: desk, os: linux}
matrix: {hardware: [desk], os: [linux], virtualization: [simulated]}
workload:
  dynamics: robust
  windows: 2
  window: 32s
  period: 2s
  reference: {amplitude_m: 0.05}
  simulation: {seed: SEED}
providers: {simulated: {platforms: platforms}}
";

/// With the example's files in it.
fn room() -> Workplace {
    let workplace = Workplace::new();
    let copied = Command::new("cp")
        .args(["-r", ROOMS, "rooms"])
        .current_dir(workplace.path())
        .status();
    assert!(copied.expect("cp is there").success());
    workplace
}

/// The text without what is another one in each run: the names of runs, and where they are.
fn settled(workplace: &Workplace, text: &str) -> String {
    let mut settled = text.replace(&format!("{}/", workplace.path().display()), "");
    for name in runs(workplace) {
        settled = settled.replace(&name, "RUN");
    }
    settled
}

fn runs(workplace: &Workplace) -> Vec<String> {
    let found = fs::read_dir(workplace.path().join("runs")).expect("there are runs");
    found
        .map(|run| {
            run.expect("it is a folder")
                .file_name()
                .to_string_lossy()
                .into_owned()
        })
        .collect()
}

/// Holds a screen against the one of that name in the docs, or writes it there.
fn shown(name: &str, screen: &str) {
    let docs = fs::read_to_string(DOCS).expect("docs/screens.md is there");
    let begin = format!("<!-- screen: {name} -->\n```text\n");
    let (before, rest) = docs
        .split_once(&begin)
        .unwrap_or_else(|| panic!("docs/screens.md has no place for {name}"));
    let (stored, after) = rest.split_once("```\n").expect("the screen ends");
    if env::var_os("MATRIX_UPDATE_SCREENS").is_some() {
        fs::write(DOCS, format!("{before}{begin}{screen}```\n{after}"))
            .expect("docs/screens.md can be written");
        return;
    }
    assert_eq!(stored, screen, "{name}: MATRIX_UPDATE_SCREENS=1 writes it anew");
}

#[rstest]
#[case("alike")]
#[case("different")]
#[case("disturbed")]
fn a_report_on_the_terminal_is_the_one_in_the_docs(#[case] rooms: &str) {
    let workplace = room();
    let ran = workplace.run(&["run", &format!("rooms/{rooms}.yaml"), "--quiet"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let screen = settled(&workplace, &ran.out);
    assert!(screen.lines().count() <= 48, "it fits a screen: {screen}");
    shown(rooms, &screen);
}

#[test]
fn a_history_on_the_terminal_is_the_one_in_the_docs() {
    let workplace = room();
    let platforms = Path::new("rooms/platforms/different");
    fs::create_dir(workplace.path().join("platforms")).expect("it is not there");
    for night in 1..=20 {
        let room = if night > 16 { "other" } else { "quiet" };
        let platform = workplace
            .path()
            .join(platforms)
            .join(format!("desk-linux-simulated-room-{room}.yaml"));
        workplace.write(
            "platforms/desk-linux-simulated.yaml",
            fs::read(platform).expect("it is an example"),
        );
        workplace.write("night.yaml", NIGHT.replace("SEED", &night.to_string()));
        let ran = workplace.run(&["run", "night.yaml", "--quiet"]);
        assert_eq!(ran.code, Some(0), "{ran:?}");
    }
    let drift = workplace.run(&["drift", "runs"]);
    assert_eq!(drift.code, Some(4), "{drift:?}");
    // How long it takes to make an environment is this machine's, and may have changed as well.
    let is_other = |line: &&str| line.is_empty() || line.starts_with("- ");
    let mut lines = drift
        .out
        .lines()
        .skip_while(|line| !line.contains("packet-delay jumped"));
    let first = lines.next().expect("the change is found");
    let finding: Vec<&str> = [first]
        .into_iter()
        .chain(lines.take_while(|line| !is_other(line)))
        .collect();
    shown("history", &settled(&workplace, &(finding.join("\n") + "\n")));
}
