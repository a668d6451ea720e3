//! Files of a run that has ended: emptied, cut, flipped, gone. What was whole stays; what is damaged is found, and either
//! mended by `resume` or refused by every command until somebody puts it back.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
    sync::Arc,
};

use serde_json::Value;

use super::{
    Point,
    judge::{Fault, Verdict},
    scene::{Platform, Scene, children},
    windows::{Windows, name_of},
};

/// What happens to a file.
#[derive(Debug, Clone, Copy)]
enum Damage {
    Emptied,
    /// Only this share of it is left.
    Cut(f64),
    /// One bit of the byte at this share of it is another.
    Flipped(f64),
    Gone,
}

const DAMAGES: [Damage; 7] = [
    Damage::Emptied,
    Damage::Cut(0.5),
    Damage::Cut(0.99),
    Damage::Flipped(0.2),
    Damage::Flipped(0.5),
    Damage::Flipped(0.8),
    Damage::Gone,
];

impl Damage {
    fn do_to(self, file: &Path) {
        let mut bytes = fs::read(file).expect("the file is there");
        let at = |share: f64, length: usize| (length as f64 * share) as usize;
        match self {
            Self::Gone => return fs::remove_file(file).expect("the file is ours"),
            Self::Emptied => bytes.clear(),
            Self::Cut(share) => bytes.truncate(at(share, bytes.len())),
            Self::Flipped(share) => {
                let at = at(share, bytes.len());
                if let Some(byte) = bytes.get_mut(at) {
                    *byte ^= 1;
                }
            }
        }
        fs::write(file, bytes).expect("the file is ours");
    }
}

/// A run that has ended, and what its report says.
struct Ended {
    scene: Scene,
    report: Value,
}

impl Ended {
    fn on(platform: Platform) -> Self {
        let scene = Scene::on(platform);
        let ran = scene.run(&["run", "m.yaml"]).expect("a run ends");
        assert_eq!(ran.code, Some(0), "{ran:?}");
        let run = scene.run_directory().expect("there is a run");
        let report = scene
            .run(&["report", &run.to_string_lossy(), "--json"])
            .expect("a report ends");
        let report = serde_json::from_str(&report.out).expect("it is JSON");
        Self { scene, report }
    }

    /// The same run in a folder of its own.
    fn again(&self) -> Scene {
        let again = Scene::on(self.scene.platform);
        for folder in ["runs", "state"] {
            copy(&self.scene.workplace.path().join(folder), again.workplace.path());
        }
        again
    }

    /// The files of the run, below its folder; of a scenario's windows those of the first.
    fn files(&self) -> Vec<PathBuf> {
        let run = self.scene.run_directory().expect("there is a run");
        let mut files: Vec<PathBuf> = ["manifest.json", "plan.json", "events.jsonl"]
            .map(PathBuf::from)
            .to_vec();
        let scenario = children(&run.join("scenarios")).remove(0);
        for folder in [scenario.clone(), scenario.join("window-1")] {
            let inside = children(&folder).into_iter().filter(|path| path.is_file());
            files.extend(inside.filter_map(|file| Some(file.strip_prefix(&run).ok()?.to_owned())));
        }
        files
    }
}

fn copy(from: &Path, into: &Path) {
    let copied = Command::new("cp")
        .arg("-a")
        .arg(from)
        .arg(into)
        .status()
        .expect("cp starts");
    assert!(copied.success(), "{} can be copied", from.display());
}

/// A point for each kind of damage to each file.
pub fn damaged(platform: Platform) -> Vec<Point> {
    let ended = Arc::new(Ended::on(platform));
    let mut points = Vec::new();
    for file in ended.files() {
        for damage in DAMAGES {
            let (ended, file) = (Arc::clone(&ended), file.clone());
            points.push(Point::new(
                format!("{damage:?} {}", file.display()),
                move |verdict| {
                    let mut scene = ended.again();
                    damage.do_to(&run(&scene).join(&file));
                    look_at_damage(verdict, &ended, &mut scene, &file);
                },
            ));
        }
    }
    points
}

/// A point for each length that the journal's end can be cut to, within its last lines and at each line before.
pub fn journal_cut(platform: Platform) -> Vec<Point> {
    let ended = Arc::new(Ended::on(platform));
    let journal = fs::read(run(&ended.scene).join("events.jsonl")).expect("there is a journal");
    let ends = journal.iter().enumerate().filter(|(_, byte)| **byte == b'\n');
    let mut lengths: Vec<usize> = ends.map(|(at, _)| at + 1).collect();
    // Within a line: every few bytes of the last three.
    let within = lengths.iter().rev().nth(3).copied().unwrap_or_default();
    lengths.extend((within..journal.len()).step_by(9));
    let point = |length: usize| {
        let ended = Arc::clone(&ended);
        Point::new(format!("{length} bytes left"), move |verdict| {
            let mut scene = ended.again();
            let file = run(&scene).join("events.jsonl");
            let bytes = fs::read(&file).expect("there is a journal");
            fs::write(&file, &bytes[..length]).expect("the file is ours");
            look_at_damage(verdict, &ended, &mut scene, Path::new("events.jsonl"));
        })
    };
    lengths.into_iter().map(point).collect()
}

fn run(scene: &Scene) -> PathBuf {
    scene.run_directory().expect("there is a run")
}

/// Whatever a file has become, no command takes it for what it was, and nothing else is lost by it.
fn look_at_damage(verdict: &mut Verdict, ended: &Ended, scene: &mut Scene, file: &Path) {
    // What the journal has of windows counts as it was written.
    let before = Windows::in_place(match file == Path::new("events.jsonl") {
        true => &ended.scene,
        false => scene,
    });
    let path = run(scene).to_string_lossy().into_owned();
    if let Some(report) = verdict.run(scene, &["report", &path, "--json"])
        && report.code == Some(0)
    {
        let report: Value = serde_json::from_str(&report.out).unwrap_or_default();
        if report != ended.report && said(&report) == said(&ended.report) {
            verdict.note(Fault::WrongWord, "the report is another, and does not say why");
        }
    }
    let Some(resumed) = verdict.run(scene, &["resume", &path]) else {
        return;
    };
    if resumed.code == Some(0) {
        return verdict.go_on_whole(scene, &before);
    }
    // Refused: nothing was done, and with the file put back all is as it was.
    verdict.windows_stay(scene, &before);
    let original = run(&ended.scene).join(file);
    fs::copy(&original, run(scene).join(file)).expect("the file is ours");
    verdict.go_on_whole(scene, &Windows::in_place(&ended.scene));
}

/// What a report says besides its numbers.
fn said(report: &Value) -> Vec<Value> {
    let mut said = vec![report["remarks"].clone()];
    for scenario in report["scenarios"].as_array().into_iter().flatten() {
        said.extend(["outcome", "reason", "broken"].map(|name| scenario[name].clone()));
        let windows = scenario["windows"].as_array().into_iter().flatten();
        said.extend(windows.flat_map(|window| [window["counted"].clone(), window["reasons"].clone()]));
    }
    said
}

impl Verdict {
    /// The windows that were whole in their place are there still.
    fn windows_stay(&mut self, scene: &Scene, before: &Windows) {
        let after = Windows::in_place(scene);
        for (name, window) in &before.0 {
            if !after.0.get(name).is_some_and(|now| now.is(window)) {
                self.note(Fault::Lost, format!("{name:?}, by a command that refused"));
            }
        }
    }
}

/// A window's folder is moved away, for each window.
pub fn windows_gone(platform: Platform) -> Vec<Point> {
    let ended = Arc::new(Ended::on(platform));
    let scenarios = children(&run(&ended.scene).join("scenarios"));
    let windows = scenarios.iter().flat_map(|scenario| children(scenario));
    let windows = windows.filter(|folder| name_of(folder).starts_with("window-"));
    let point = |folder: PathBuf| {
        let below = folder
            .strip_prefix(run(&ended.scene))
            .expect("it is below")
            .to_owned();
        let ended = Arc::clone(&ended);
        Point::new(below.display().to_string(), move |verdict| {
            let mut scene = ended.again();
            let aside = scene.aside("window");
            let moved = Command::new("mv")
                .arg(run(&scene).join(&below))
                .arg(aside)
                .status();
            assert!(moved.is_ok_and(|moved| moved.success()), "it can be moved");
            let before = Windows::in_place(&scene);
            verdict.go_on_whole(&mut scene, &before);
        })
    };
    windows.map(point).collect()
}
