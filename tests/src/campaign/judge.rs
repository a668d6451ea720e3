//! What a crash may not do, looked at after it. The main function is [`Verdict::go_on_whole`].

use std::path::Path;

use serde_json::Value;

use super::{
    scene::{Scene, children},
    windows::{Windows, name_of},
};
use crate::Ran;

/// A column of the table: what may not be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// A window that was whole is not there any more.
    Lost,
    /// A window that was whole was measured once more.
    MeasuredTwice,
    /// Something of ours is left, or something of others was touched.
    Leak,
    /// What a command said, or its exit code, is not so.
    WrongWord,
    /// A command did not end in time.
    Hang,
}

/// All of them, in the table's order, with the heads of their columns.
pub const FAULTS: [(Fault, &str); 5] = [
    (Fault::Lost, "windows lost"),
    (Fault::MeasuredTwice, "measured twice"),
    (Fault::Leak, "leaks"),
    (Fault::WrongWord, "wrong words"),
    (Fault::Hang, "hangs"),
];

/// The run's own names in its folder; docs/run-directory.md has them.
const OF_A_RUN: [&str; 6] = [
    "manifest.json",
    "plan.json",
    "events.jsonl",
    "lock",
    "scenarios",
    "report",
];

/// What was found at one point.
#[derive(Debug, Default)]
pub struct Verdict {
    /// Each fault, and in words what was seen.
    pub faults: Vec<(Fault, String)>,
}

impl Verdict {
    /// Notes a fault.
    pub fn note(&mut self, fault: Fault, what: impl Into<String>) {
        self.faults.push((fault, what.into()));
    }

    /// Runs a command; none when it hung.
    pub fn run(&mut self, scene: &Scene, arguments: &[&str]) -> Option<Ran> {
        let ran = scene.run(arguments);
        self.ended(&arguments.join(" "), ran)
    }

    /// Looks at a command that was to end on its own, in one of the ways that docs/exit-codes.md has.
    pub fn ended(&mut self, what: &str, ran: Result<Ran, super::scene::Hung>) -> Option<Ran> {
        let Ok(ran) = ran else {
            self.note(Fault::Hang, format!("{what} did not end"));
            return None;
        };
        if ran.err.contains("panicked") || !matches!(ran.code, Some(0..=3 | 130)) {
            self.note(
                Fault::WrongWord,
                format!("{what} ended with {:?}: {}", ran.code, last_lines(&ran.err)),
            );
        }
        Some(ran)
    }

    /// Runs a command that must succeed.
    pub fn succeeds(&mut self, scene: &Scene, arguments: &[&str]) -> Option<Ran> {
        let ran = self.run(scene, arguments)?;
        if ran.code == Some(0) {
            return Some(ran);
        }
        self.note(
            Fault::WrongWord,
            format!(
                "{} ended with {:?}: {}",
                arguments.join(" "),
                ran.code,
                last_lines(&ran.err)
            ),
        );
        None
    }

    /// What a command that must succeed says with `--json`.
    pub fn json(&mut self, scene: &Scene, arguments: &[&str]) -> Option<Value> {
        let ran = self.succeeds(scene, &[arguments, &["--json"]].concat())?;
        match serde_json::from_str(&ran.out) {
            Ok(said) => Some(said),
            Err(error) => {
                self.note(
                    Fault::WrongWord,
                    format!("{} is no JSON: {error}", arguments.join(" ")),
                );
                None
            }
        }
    }

    /// Goes on with the run and looks at all that it has come to. `before` are the windows that were whole.
    pub fn go_on_whole(&mut self, scene: &mut Scene, before: &Windows) {
        let Some(run) = scene.run_directory() else {
            return self.nothing_is_left_outside(scene);
        };
        let path = run.to_string_lossy().into_owned();
        if !run.join("manifest.json").exists() {
            // It was killed while it made the run directory: nothing was created, and one begins again.
            if let Some(ran) = self.run(scene, &["resume", &path])
                && ran.code != Some(2)
            {
                self.note(
                    Fault::WrongWord,
                    format!("a run that never began is resumed with {:?}", ran.code),
                );
            }
            // What there is of it is no run, and nobody's to go on with.
            return self.nothing_is_left_outside(scene);
        }
        self.succeeds(scene, &["resume", &path]);
        self.windows_are_there(scene, before);
        self.commands_agree(scene, &path);
        self.nothing_is_left(scene);
    }

    /// Each window is there exactly once and whole, and those that were whole are those that there were.
    pub fn windows_are_there(&mut self, scene: &Scene, before: &Windows) {
        let after = Windows::in_place(scene);
        let wanted = scene.platform.scenarios() * scene.platform.windows() as usize;
        if after.0.len() != wanted {
            let missing = wanted.saturating_sub(after.0.len());
            // Those that were whole are told each below.
            let lost = before
                .0
                .keys()
                .filter(|name| !after.0.contains_key(*name))
                .count();
            if missing > lost {
                self.note(
                    Fault::WrongWord,
                    format!("the run came to {} of {wanted} windows", after.0.len()),
                );
            }
        }
        for (name, window) in &before.0 {
            match after.0.get(name) {
                None => self.note(
                    Fault::Lost,
                    format!("{name:?} of {} was whole", window.environment),
                ),
                Some(now) if !now.is(window) => self.note(
                    Fault::MeasuredTwice,
                    format!(
                        "{name:?} of {} was whole, and is now {}'s",
                        window.environment, now.environment
                    ),
                ),
                Some(_) => {}
            }
        }
        for folder in Windows::put_aside(scene) {
            self.note(Fault::MeasuredTwice, format!("{} is whole", folder.display()));
        }
    }

    /// `status`, `report` and `resume` say one and the same, and it is so.
    fn commands_agree(&mut self, scene: &Scene, run: &str) {
        let windows = u64::from(scene.platform.windows());
        if let Some(status) = self.json(scene, &["status", run]) {
            let mut scenarios = status["scenarios"].as_array().into_iter().flatten();
            let all_done =
                scenarios.all(|it| it["state"] == "completed" && it["windows_collected"] == windows);
            if !all_done || status["finished"] != true || status["live"] != false {
                self.note(Fault::WrongWord, format!("status says {status}"));
            }
        }
        if let Some(left) = self.json(scene, &["resume", run, "--dry-run"])
            && left["scenarios"]
                .as_array()
                .is_none_or(|scenarios| !scenarios.is_empty())
        {
            self.note(Fault::WrongWord, format!("resume --dry-run says {left}"));
        }
        if let Some(report) = self.json(scene, &["report", run]) {
            for scenario in report["scenarios"].as_array().into_iter().flatten() {
                let listed = scenario["windows"].as_array().into_iter().flatten();
                // What a window is worth, the machine's other work has a part in.
                let numbers: Vec<u64> = listed
                    .filter(|window| window["verdict"] != "missing" && window["verdict"] != "broken")
                    .filter_map(|window| window["window"].as_u64())
                    .collect();
                if numbers != (1..=windows).collect::<Vec<_>>() || scenario["outcome"] != "completed" {
                    let slug = &scenario["slug"];
                    let outcome = &scenario["outcome"];
                    self.note(
                        Fault::WrongWord,
                        format!("report has {numbers:?} of {slug}, {outcome}"),
                    );
                }
            }
        }
    }

    /// Nothing of ours is left, and nothing of others was touched.
    pub fn nothing_is_left(&mut self, scene: &mut Scene) {
        self.nothing_is_left_outside(scene);
        if let Some(run) = scene.run_directory() {
            self.run_directory_is_tidy(&run);
        }
    }

    /// Nothing of ours is left outside of the run directory, and nothing of others was touched.
    pub fn nothing_is_left_outside(&mut self, scene: &mut Scene) {
        self.clean_finds_nothing(scene);
        for state in scene.state_folders() {
            for left in children(&state.join("environments")) {
                self.note(Fault::Leak, format!("{} is left", left.display()));
            }
            for left in children(&state.join("bin")) {
                let name = name_of(&left);
                if !name.starts_with("workload-") && left.is_file() {
                    self.note(Fault::Leak, format!("{} is left", left.display()));
                }
            }
        }
        for (pid, words) in scene.processes() {
            self.note(Fault::Leak, format!("process {pid} is left: {words}"));
        }
        for id in scene.on_the_engine() {
            self.note(Fault::Leak, format!("{id} is left on the engine"));
        }
        for what in scene.touched() {
            self.note(Fault::Leak, what);
        }
    }

    fn clean_finds_nothing(&mut self, scene: &Scene) {
        let Some(clean) = self.json(scene, &["clean", "--dry-run"]) else {
            return;
        };
        // Others may be at work on the same engine; the workload's image on it is no run's, and stays for the next.
        let ours = |left: &&Value| {
            let of_run = left["run_directory"].as_str();
            of_run.is_some_and(|run| Path::new(run).starts_with(scene.workplace.path()))
        };
        let leftovers = clean["leftovers"].as_array().into_iter().flatten();
        for left in leftovers.filter(ours) {
            self.note(Fault::Leak, format!("clean finds {left}"));
        }
    }

    fn run_directory_is_tidy(&mut self, run: &Path) {
        for place in children(run) {
            if !OF_A_RUN.contains(&name_of(&place).as_str()) {
                self.note(Fault::Leak, format!("{} is left", place.display()));
            }
        }
        for scenario in children(&run.join("scenarios")) {
            for place in children(&scenario) {
                let name = name_of(&place);
                let is_ours = ["window-", "environment", "network"]
                    .iter()
                    .any(|begin| name.starts_with(begin));
                if name != "broken" && !is_ours {
                    self.note(Fault::Leak, format!("{} is left", place.display()));
                }
            }
        }
    }
}

/// Enough of what was said to know what was wrong.
fn last_lines(text: &str) -> String {
    let lines: Vec<&str> = text.lines().collect();
    lines[lines.len().saturating_sub(4)..].join(" / ")
}
