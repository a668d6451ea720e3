//! What a shell gets from the real `matrix` while a command line is written.

use rstest::rstest;
use tests::Workplace;

const FILE: &str = "\
matrix:
  virtualization: [fake]
  network.loss: [0%, 1%]
workload: {windows: 4, window: 10s, period: 1s}
profiles:
  quick:
    workload: {windows: 2}
  one-more:
    matrix: {network.loss: [2%]}
";

/// What is proposed for the last of these words, as to fish: one a line, what describes it behind a tab.
fn proposed(workplace: &Workplace, words: &[&str]) -> Vec<String> {
    let mut command = workplace.matrix([&["--", "matrix"], words].concat());
    let output = command.env("MATRIX_COMPLETE", "fish").output().unwrap();
    assert!(output.status.success(), "{output:?}");
    assert!(output.stderr.is_empty(), "{output:?}");
    let lines = String::from_utf8(output.stdout).unwrap();
    let word = |line: &str| line.split('\t').next().unwrap_or_default().to_owned();
    lines.lines().map(word).collect()
}

#[test]
fn profiles_and_scenarios_of_the_file_are_proposed() {
    let workplace = Workplace::new();
    workplace.write("m.yaml", FILE);
    let profiles = proposed(&workplace, &["run", "m.yaml", "--profile", ""]);
    assert_eq!(profiles, ["quick", "one-more"]);
    for option in ["--only", "--skip"] {
        let scenarios = proposed(&workplace, &["plan", "m.yaml", option, ""]);
        assert_eq!(scenarios.len(), 4, "{scenarios:?}");
        assert_eq!((scenarios[0].as_str(), scenarios[2].as_str()), ("a", "b"));
        assert!(scenarios[1].ends_with("-fake-loss-0pct"), "{scenarios:?}");
    }
    let in_profile = proposed(
        &workplace,
        &["run", "m.yaml", "--profile", "one-more", "--only", "b"],
    );
    assert_eq!(in_profile, Vec::<String>::new());
    assert!(!workplace.path().join("runs").exists(), "nothing was created");
    assert!(!workplace.path().join("state").exists(), "nothing was created");
}

#[test]
fn without_a_file_the_profiles_are_those_of_matrix_yaml() {
    let workplace = Workplace::new();
    assert_eq!(
        proposed(&workplace, &["run", "--profile", ""]),
        Vec::<String>::new()
    );
    workplace.write("matrix.yaml", FILE);
    assert_eq!(proposed(&workplace, &["run", "--profile", "q"]), ["quick"]);
}

#[test]
fn runs_and_their_scenarios_are_proposed() {
    let workplace = Workplace::new();
    workplace.write("m.yaml", FILE);
    workplace.run(&["run", "m.yaml", "--profile", "quick", "--quiet"]);
    let run = workplace.run_directory();
    let run = format!("runs/{}", run.file_name().unwrap().to_str().unwrap());
    for command in ["status", "report", "resume", "messages"] {
        assert_eq!(proposed(&workplace, &[command, ""])[0], run);
    }
    let of_run = proposed(&workplace, &["messages", &run, "--only", ""]);
    assert_eq!(of_run.len(), 4, "{of_run:?}");
    assert_eq!(proposed(&workplace, &["shell", "a"])[0], "a");
}

#[rstest]
#[case::bash("bash", "complete -o nospace")]
#[case::zsh("zsh", "#compdef matrix")]
#[case::fish("fish", "complete --keep-order")]
fn the_script_of_a_shell_asks_the_program_that_printed_it(#[case] shell: &str, #[case] words: &str) {
    let ran = Workplace::new().run(&["completions", shell]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let program = tests::matrix_binary().display().to_string();
    // fish has no quotes around what needs none.
    let out = ran.out.replace('"', "");
    for part in [
        words,
        program.as_str(),
        format!("MATRIX_COMPLETE={shell}").as_str(),
    ] {
        assert!(out.contains(part), "{part} is not in:\n{out}");
    }
}

#[test]
fn each_command_has_a_manual_page() {
    let workplace = Workplace::new();
    let printed = workplace.run(&["man"]);
    assert!(printed.out.contains(".TH matrix"), "{printed:?}");
    std::fs::create_dir(workplace.path().join("pages")).unwrap();
    let written = workplace.run(&["man", "--output", "pages"]);
    assert_eq!((written.code, written.out.as_str()), (Some(0), ""), "{written:?}");
    let page = |name: &str| std::fs::read_to_string(workplace.path().join("pages").join(name)).unwrap();
    assert_eq!(page("matrix.1"), printed.out);
    assert!(page("matrix-run.1").contains("profile"));
    let nowhere = workplace.run(&["man", "--output", "nowhere"]);
    assert_eq!(nowhere.code, Some(2), "{nowhere:?}");
}
