//! A tenth of the crash campaign, always the same one, and whether its judge sees what there is to see. `docs/crashes.md` has
//! the whole.

use std::{
    fs,
    path::{Path, PathBuf},
    time::Duration,
};

use rstest::rstest;
use tests::campaign::{
    self, Extent,
    judge::{Fault, Verdict},
    scene::{Platform, Scene},
    windows::{Windows, scenarios},
};

#[test]
fn a_tenth_of_all_crashes_loses_nothing_leaves_nothing_and_tells_nothing_wrong() {
    let tenth = Extent {
        tenth: true,
        only: Vec::new(),
    };
    let rows = campaign::run(&tenth, |row| {
        println!("{}: {} points in {:.0?}", row.name, row.points, row.took);
    });
    let found: Vec<_> = rows.iter().flat_map(|row| &row.faults).collect();
    assert!(found.is_empty(), "{found:#?}\n{}", campaign::table(&rows));
    assert!(
        rows.iter().all(|row| row.points > 0),
        "{}",
        campaign::table(&rows)
    );
}

/// A run that has ended, and its windows.
fn ended() -> (Scene, Windows) {
    let scene = Scene::on(Platform::Fake);
    let ran = scene.run(&["run", "m.yaml"]).unwrap();
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let windows = Windows::in_place(&scene);
    assert_eq!(windows.0.len(), 4);
    (scene, windows)
}

fn window(scene: &Scene) -> PathBuf {
    scenarios(scene).remove(0).join("window-1")
}

fn kinds(verdict: &Verdict) -> Vec<Fault> {
    let mut kinds: Vec<Fault> = verdict.faults.iter().map(|(fault, _)| *fault).collect();
    kinds.dedup();
    kinds
}

#[test]
fn of_a_run_that_nothing_happened_to_nothing_is_found() {
    let (mut scene, windows) = ended();
    let mut verdict = Verdict::default();
    verdict.go_on_whole(&mut scene, &windows);
    assert!(verdict.faults.is_empty(), "{verdict:#?}");
}

#[rstest]
#[case::gone(|window: &Path| fs::remove_dir_all(window).unwrap())]
#[case::cut(|window: &Path| fs::write(window.join("control.csv"), "").unwrap())]
#[case::without_its_record(|window: &Path| fs::remove_file(window.join("window.json")).unwrap())]
fn a_window_that_is_lost_is_found(#[case] damage: fn(&Path)) {
    let (mut scene, windows) = ended();
    damage(&window(&scene));
    let mut verdict = Verdict::default();
    verdict.windows_are_there(&scene, &windows);
    assert_eq!(kinds(&verdict), [Fault::Lost], "{verdict:#?}");

    let mut verdict = Verdict::default();
    verdict.go_on_whole(&mut scene, &windows);
    assert_eq!(kinds(&verdict), [Fault::MeasuredTwice], "{verdict:#?}");
}

#[rstest]
#[case::environment("state/environments/matrix-1")]
#[case::unfinished_binary("state/bin/.workload.1.0")]
#[case::of_others("state/of-others/notes")]
fn what_is_left_and_what_was_touched_is_found(#[case] path: &str) {
    let (mut scene, _) = ended();
    let path = scene.workplace.path().join(path);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(&path, "another's\n").unwrap();
    let mut verdict = Verdict::default();
    verdict.nothing_is_left(&mut scene);
    assert_eq!(kinds(&verdict), [Fault::Leak], "{verdict:#?}");
}

#[test]
fn a_run_that_cannot_be_gone_on_with_and_a_command_that_hangs_are_found() {
    let (mut scene, windows) = ended();
    let run = scene.run_directory().unwrap();
    fs::write(run.join("manifest.json"), "{").unwrap();
    let mut verdict = Verdict::default();
    verdict.go_on_whole(&mut scene, &windows);
    assert_eq!(kinds(&verdict), [Fault::WrongWord], "{verdict:#?}");

    let below = ["sh", "-c", "exec sleep infinity"].map(str::to_owned);
    let ran = scene
        .start(&below, &["status"])
        .end_within(Duration::from_millis(50));
    let mut verdict = Verdict::default();
    verdict.ended("status", ran);
    assert_eq!(kinds(&verdict), [Fault::Hang], "{verdict:#?}");
}
