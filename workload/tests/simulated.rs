//! The ball on the plate in virtual time: it leaves what a real run leaves, and the same seed leaves the same bytes.

#![allow(clippy::unwrap_used, clippy::panic)] // What tests may, but clippy knows only functions that are tests themselves.

use std::{
    fs,
    path::Path,
    sync::{Arc, atomic::AtomicBool},
};

use record::{
    control_log::ControlRow,
    plant_log::PlantRow,
    settings::{Dynamics, Settings},
    window::{Verdict, WindowRecord},
};
use rstest::rstest;
use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};
use tempfile::TempDir;
use workload::{
    experiment::{Ending, Reporter, Request},
    experiments,
};

fn settings(dynamics: Dynamics, simulation: &Value) -> Settings {
    let own = json!({
        "dynamics": dynamics, "windows": 2, "window": "40s", "period": "10s", "simulation": simulation,
    });
    let settings = Settings::from_json(own, dynamics).unwrap();
    assert_eq!(settings.problems(), []);
    settings
}

fn run(settings: &Settings, stop: bool) -> (TempDir, Ending) {
    let data = tempfile::tempdir().unwrap();
    let request = Request {
        environment: "e-1".to_owned(),
        data: data.path().to_owned(),
        work: None,
        windows: vec![3, 4],
        settings: settings.clone(),
    };
    let stop = Arc::new(AtomicBool::new(stop));
    let ending = experiments::of(settings).run(&request, &Reporter::start(None), &stop);
    (data, ending.unwrap())
}

fn record(data: &Path, window: u32) -> WindowRecord {
    let text = fs::read(data.join(format!("window-{window}/window.json"))).unwrap();
    let record: WindowRecord = serde_json::from_slice(&text).unwrap();
    record.check().unwrap();
    record
}

fn control(data: &Path, window: u32) -> Vec<ControlRow> {
    let text = fs::read_to_string(data.join(format!("window-{window}/control.csv"))).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next().unwrap(), ControlRow::HEADER);
    let step = |line: &str| -> ControlRow {
        let fields: Vec<&str> = line.split(',').collect();
        ControlRow {
            step: fields[0].parse().unwrap(),
            scheduled_ns: fields[1].parse().unwrap(),
            actual_ns: fields[2].parse().unwrap(),
            ..ControlRow::default()
        }
    };
    lines.map(step).collect()
}

/// The SHA-256 of all files of both windows.
fn digest(data: &Path) -> String {
    let mut hash = Sha256::new();
    for window in [3, 4] {
        let folder = data.join(format!("window-{window}"));
        let mut files: Vec<_> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .collect();
        files.sort();
        assert_eq!(files.len(), 6, "{files:?}");
        for file in files {
            hash.update(fs::read(file).unwrap());
        }
    }
    format!("{:x}", hash.finalize())
}

#[rstest]
#[case::robust(Dynamics::Robust)]
#[case::author(Dynamics::Author)]
fn a_simulated_run_leaves_the_files_of_a_real_one(#[case] dynamics: Dynamics) {
    let (data, ending) = run(&settings(dynamics, &json!({"seed": 7})), false);
    assert_eq!(ending, Ending::Finished);
    for (window, first) in [(3, 0), (4, 2000)] {
        let record = record(data.path(), window);
        assert_eq!((record.verdict, &record.reasons), (Verdict::Valid, &vec![]));
        assert_eq!((record.starts_run, record.complete), (window == 3, true));
        let loops = record.loops().unwrap();
        assert_eq!((loops.steps_done, loops.plant.steps), (2000, 2000));
        assert_eq!(
            (
                loops.controller.missed_deadlines,
                loops.controller.lateness_max_ns
            ),
            (0, 0)
        );
        let control = control(data.path(), window);
        let steps: Vec<u64> = control.iter().map(|row| row.step).collect();
        assert_eq!(steps, (first..first + 2000).collect::<Vec<_>>());
        let plant = fs::read_to_string(data.path().join(format!("window-{window}/plant.csv"))).unwrap();
        assert_eq!(
            (plant.lines().next(), plant.lines().count()),
            (Some(PlantRow::HEADER), 2001)
        );
        let names: Vec<&str> = record.files.iter().map(|file| file.name.as_str()).collect();
        assert_eq!(
            names,
            ["control.csv", "h1.pcap", "plant.csv", "sta1.pcap", "sta2.pcap"]
        );
        let [h1, sta1, sta2] = record.captures.as_slice() else {
            panic!("{:?}", record.captures);
        };
        assert_eq!(h1.packets, 0);
        // What left the host and what came to it, but for what was in between at the window's ends.
        for (capture, link) in [(sta1, &record.links[1]), (sta2, &record.links[2])] {
            let passed = link.up.offered + link.down.delivered;
            assert!(capture.packets.abs_diff(passed) < 10, "{capture:?} {link:?}");
        }
        assert!(sta1.packets > 2500, "{sta1:?}");
        let link = &record.links[1];
        // 1 % of each pass, five standard deviations either side.
        let (offered, lost) = (link.up.offered as f64, link.up.lost as f64);
        assert!(
            (lost - offered / 100.0).abs() < 5.0 * (offered / 100.0).sqrt(),
            "{link:?}"
        );
    }
    assert!(data.path().join("environment.json").exists());
}

/// Held on every machine, x86_64, i686 and aarch64: `workload/builder/test` runs this on each.
#[rstest]
#[case::author(
    Dynamics::Author,
    "82b31486e49870550b9240898d7df7ab3e291af3867b20733229dfc9416085e8"
)]
#[case::robust(
    Dynamics::Robust,
    "44c43ca5fdf608d2e8924bd5736c9ba1e1a7b1ee2ef335a326ae07f0d3ab7f84"
)]
#[case::equations(
    Dynamics::Equations,
    "7fe15beac742fba08743b6128f3956cb63c0ce754c299857eaad0ce6ff06a856"
)]
fn the_same_seed_gives_the_same_bytes_and_another_seed_others(
    #[case] dynamics: Dynamics,
    #[case] expected: &str,
) {
    let platform = json!({
        "controller": {"late": [[0, "10us"], [0.5, "60us"], [0.99, "300us"], [1, "4ms"]], "persistence": "20%"},
        "plant": {"late": [[0, "10us"], [1, "200us"]]},
        "stalls": {"per_hour": 600, "length": [[0, "2ms"], [1, "60ms"]]},
        "stack": "90us",
        "reading": [[0, "20us"], [1, "120us"]],
    });
    let digest = |seed: u64| {
        let simulation = json!({"seed": seed, "platform": platform});
        let (data, _) = run(&settings(dynamics, &simulation), false);
        digest(data.path())
    };
    assert_eq!(digest(1), expected);
    assert_ne!(digest(2), expected);
}

#[test]
fn what_the_platform_does_reaches_the_records() {
    let platform = json!({
        "controller": {"late": [[0, "3ms"], [1, "3ms"]]},
        "stalls": {"per_hour": 1800, "length": [[0, "50ms"], [1, "50ms"]]},
    });
    let (data, _) = run(&settings(Dynamics::Author, &json!({"platform": platform})), false);
    let record = record(data.path(), 4);
    let loops = record.loops().unwrap();
    assert_eq!(loops.controller.lateness_p50_ns, 3_000_000);
    // A stall of 50 ms begins somewhere between two ticks of 20 ms.
    assert!(
        (40_000_000..53_000_000).contains(&loops.controller.lateness_max_ns),
        "{loops:?}"
    );
    assert!(
        (30_000_000..50_000_000).contains(&loops.plant.lateness_max_ns),
        "{loops:?}"
    );
    assert!(
        loops.controller.lost_ticks > 10 && loops.plant.lost_ticks > 10,
        "{loops:?}"
    );
}

#[test]
fn a_run_that_is_to_stop_cuts_the_window_under_way() {
    let mut settings = settings(Dynamics::Robust, &json!({}));
    settings.window = "1000s".parse().unwrap();
    let (data, ending) = run(&settings, true);
    assert_eq!(ending, Ending::Stopped { window: 3 });
    let record = record(data.path(), 3);
    assert_eq!((record.verdict, record.complete), (Verdict::Invalid, false));
    assert!(!data.path().join("window-4").exists());
}
