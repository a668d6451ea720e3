//! Small run directories with known numbers, written with the record types that the workload and the orchestrator write
//! with. A pure function of its arguments: the noise comes from a fixed sequence.

use std::{fs, path::PathBuf};

use record::{
    control_log::ControlRow,
    quantity::{Frequency, TimeSpan},
    report_settings::ReportSettings,
    run_directory::{
        Chain, EnvironmentRecord, Event, FORMAT, JournalEntry, Manifest, Outcome, PlanRecord,
        PlannedScenario, RunDirectory,
    },
    settings::Settings,
    window::{
        ConditionsRecord, FileRecord, LoopRecord, LoopsRecord, NoticesRecord, OfExperiment, Verdict,
        WindowRecord,
    },
};
use serde_json::{Map, Value};
use sha2::{Digest, Sha256};
use tempfile::TempDir;

/// Periods in a window; a period has 10 steps.
pub const PERIODS: u64 = 30;

/// A scenario that is to be there.
pub struct Scenario {
    pub slug: &'static str,
    pub provider: &'static str,
    /// Why it is infeasible.
    pub infeasible: Option<&'static str>,
    /// By what it was left out.
    pub not_selected: Option<&'static str>,
    /// How it ended; none if the journal does not say.
    pub outcome: Option<(Outcome, Option<&'static str>)>,
    /// Mean error of each window that was measured, in metres.
    pub errors_m: Vec<f64>,
}

impl Scenario {
    pub fn measured(slug: &'static str, errors_m: &[f64]) -> Self {
        Self {
            slug,
            provider: "native",
            infeasible: None,
            not_selected: None,
            outcome: Some((Outcome::Completed, None)),
            errors_m: errors_m.to_vec(),
        }
    }

    pub fn infeasible(slug: &'static str, reason: &'static str) -> Self {
        Self {
            infeasible: Some(reason),
            outcome: None,
            ..Self::measured(slug, &[])
        }
    }

    pub fn ended(slug: &'static str, outcome: Outcome, reason: &'static str) -> Self {
        Self {
            outcome: Some((outcome, Some(reason))),
            ..Self::measured(slug, &[])
        }
    }

    pub fn by(mut self, provider: &'static str) -> Self {
        self.provider = provider;
        self
    }
}

/// A run directory that is deleted with this value.
pub struct Synthetic {
    pub directory: RunDirectory,
    _folder: TempDir,
}

impl Synthetic {
    /// Scenarios are named hardware-os-virtualization, or hardware-os-node-virtualization.
    pub fn new(scenarios: &[Scenario]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let directory = RunDirectory::new(folder.path().join("2026-11-21"));
        fs::create_dir(directory.path()).unwrap();
        let synthetic = Self {
            directory,
            _folder: folder,
        };
        synthetic.write_json(synthetic.directory.manifest().path(), &manifest());
        synthetic.write_json(synthetic.directory.plan().path(), &plan(scenarios));
        synthetic.write_journal(&journal(scenarios));
        for scenario in scenarios {
            synthetic.write_scenario(scenario);
        }
        synthetic
    }

    fn write_scenario(&self, scenario: &Scenario) {
        if scenario.errors_m.is_empty() {
            return;
        }
        for (index, error_m) in scenario.errors_m.iter().enumerate() {
            let seed = scenario.slug.bytes().map(u64::from).sum::<u64>() * 100 + index as u64;
            self.write_window(
                scenario.slug,
                index as u32 + 1,
                &log(index as u64, *error_m, seed),
            );
        }
        let environment = EnvironmentRecord {
            environment: format!("matrix-2026-11-21-{}-1", scenario.slug),
            provider: scenario.provider.to_owned(),
            host: "here".to_owned(),
            facts: Map::new(),
            platform: None,
        };
        self.write_json(self.directory.environment(scenario.slug).path(), &environment);
    }

    pub fn write_window(&self, slug: &str, window: u32, log: &str) {
        let folder = self.directory.window(slug, window).path();
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join("control.csv"), log).unwrap();
        self.write_json(folder.join("window.json"), &window_record(slug, window, log));
    }

    /// Changes a window's record.
    pub fn edit_window(&self, slug: &str, window: u32, edit: impl FnOnce(&mut WindowRecord)) {
        let path = self.directory.window(slug, window).path().join("window.json");
        let mut record = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
        edit(&mut record);
        self.write_json(path, &record);
    }

    /// Changes a window's log, and with it the checksum if the change is to look as if it had been measured so.
    pub fn edit_log(&self, slug: &str, window: u32, as_measured: bool, edit: impl FnOnce(String) -> String) {
        let path = self.directory.window(slug, window).path().join("control.csv");
        let log = edit(fs::read_to_string(&path).unwrap());
        fs::write(&path, &log).unwrap();
        if as_measured {
            self.edit_window(slug, window, |record| record.files = vec![file_record(&log)]);
        }
    }

    pub fn write_json(&self, path: PathBuf, value: &impl serde::Serialize) {
        fs::write(path, serde_json::to_vec_pretty(value).unwrap()).unwrap();
    }

    pub fn write_journal(&self, events: &[Event]) {
        let mut chain = Chain::default();
        let line = |event: &Event| {
            let entry = JournalEntry {
                at: "2026-11-21T04:00:00.000Z".to_owned(),
                event: event.clone(),
            };
            chain.line(&entry).unwrap()
        };
        fs::write(
            self.directory.journal().path(),
            events.iter().flat_map(line).collect::<Vec<u8>>(),
        )
        .unwrap();
    }
}

pub fn settings() -> Settings {
    Settings {
        windows: 4,
        window: TimeSpan::from_secs(PERIODS),
        period: TimeSpan::from_secs(1),
        rate: Frequency::from_hz(10.0),
        ..Settings::default()
    }
}

fn manifest() -> Manifest {
    Manifest {
        hosts: Vec::new(),
        format: FORMAT,
        run: "2026-11-21".to_owned(),
        created: "2026-11-21T04:00:00.000Z".to_owned(),
        matrix_version: "0.1.0".to_owned(),
        matrix_revision: None,
        workload_sha256: String::new(),
        invocation: ["matrix", "run", "matrix.yaml"].map(str::to_owned).to_vec(),
        matrix_file: "matrix.yaml".to_owned(),
        matrix_text: "matrix: {}\n".to_owned(),
        matrix_sha256: sha256("matrix: {}\n"),
        profile: None,
        order: "randomised".to_owned(),
        seed: 1,
        providers: Map::new(),
        report: ReportSettings::default(),
        state_directory: None,
        experiment_sha256: None,
        redacted: false,
    }
}

fn plan(scenarios: &[Scenario]) -> PlanRecord {
    let letters = || ('a'..='z').map(String::from);
    PlanRecord {
        format: FORMAT,
        scenarios: letters()
            .zip(scenarios)
            .map(|(id, scenario)| planned(id, scenario))
            .collect(),
        order: letters()
            .zip(scenarios)
            .filter(|(_, s)| s.infeasible.is_none())
            .map(|(id, _)| id)
            .collect(),
        later_rounds: Vec::new(),
        measuring_s: 0.0,
    }
}

fn planned(id: String, scenario: &Scenario) -> PlannedScenario {
    let values: Vec<&str> = scenario.slug.split('-').collect();
    let names: &[&str] = match values.len() {
        4 => &["hardware", "os", "node", "virtualization"],
        _ => &["hardware", "os", "virtualization"],
    };
    let named = std::iter::zip(names, values);
    let axes = named
        .map(|(name, value)| ((*name).to_owned(), Value::from(value)))
        .collect();
    PlannedScenario {
        id,
        slug: scenario.slug.to_owned(),
        axes,
        pool: Vec::new(),
        host: scenario.infeasible.is_none().then(|| "here".to_owned()),
        feasible: scenario.infeasible.is_none(),
        reason: scenario.infeasible.map(str::to_owned),
        fix: scenario.infeasible.map(|_| "add a host that can".to_owned()),
        not_selected: scenario.not_selected.map(str::to_owned),
        simulated: false,
        settings: Settings {
            windows: u32::try_from(scenario.errors_m.len()).unwrap().max(4),
            ..settings()
        },
    }
}

pub fn journal(scenarios: &[Scenario]) -> Vec<Event> {
    let mut events = vec![Event::RunStarted {
        pid: 1,
        resumed: false,
        manifest_sha256: None,
        plan_sha256: None,
    }];
    for scenario in scenarios
        .iter()
        .filter(|s| s.infeasible.is_none() && s.not_selected.is_none())
    {
        let slug = scenario.slug.to_owned();
        events.push(Event::ScenarioStarted {
            scenario: slug.clone(),
            windows: vec![1, 2, 3, 4],
            round: None,
        });
        events.push(Event::EnvironmentCreating {
            scenario: slug.clone(),
            environment: format!("matrix-2026-11-21-{slug}-1"),
            provider: scenario.provider.to_owned(),
            windows: vec![1, 2, 3, 4],
            resources: Vec::new(),
            round: None,
        });
        let collected = (1..)
            .zip(scenario.errors_m.iter())
            .map(|(window, _)| Event::WindowCollected {
                scenario: slug.clone(),
                environment: format!("matrix-2026-11-21-{slug}-1"),
                window,
                verdict: Verdict::Valid,
                sha256: None,
            });
        events.extend(collected);
        if let Some((outcome, reason)) = scenario.outcome {
            let hint = reason.map(|_| "`matrix resume` tries again".to_owned());
            let reason = reason.map(str::to_owned);
            events.push(Event::ScenarioFinished {
                scenario: slug,
                outcome,
                reason,
                hint,
                round: None,
            });
        }
    }
    events.push(Event::RunFinished);
    events
}

/// A log whose errors are about `error_m` on each axis, each period with a value of its own.
pub fn log(window: u64, error_m: f64, seed: u64) -> String {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut noise = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    let mut log = format!("{}\n", ControlRow::HEADER).into_bytes();
    for period in 0..PERIODS {
        let error = error_m * (0.9 + 0.2 * noise());
        for step in 0..10 {
            row((window * PERIODS + period) * 10 + step, error)
                .write_to(&mut log)
                .unwrap();
        }
    }
    String::from_utf8(log).unwrap()
}

fn row(step: u64, error_m: f64) -> ControlRow {
    let turn = std::f64::consts::TAU * (step % 10) as f64 / 10.0;
    let (x, y) = (
        2.0 * turn.cos() * (2.0 * turn).sin(),
        2.0 * turn.cos() * turn.sin(),
    );
    let due_ns = step as i64 * 100_000_000;
    ControlRow {
        step,
        scheduled_ns: due_ns,
        actual_ns: due_ns + 50_000,
        done_ns: due_ns + 90_000,
        reference_x_m: x,
        reference_y_m: y,
        state_seq: step + 1,
        state_stamp_ns: due_ns + 50_000 - 30_000_000,
        state_received_ns: due_ns - 10_000_000,
        x_m: x - error_m,
        y_m: y + error_m,
        ..ControlRow::default()
    }
}

pub fn file_record(log: &str) -> FileRecord {
    FileRecord {
        name: "control.csv".to_owned(),
        bytes: log.len() as u64,
        sha256: sha256(log),
        measured: None,
    }
}

pub fn sha256(text: &str) -> String {
    format!("{:x}", Sha256::digest(text))
}

fn window_record(slug: &str, window: u32, log: &str) -> WindowRecord {
    let steps = PERIODS * 10;
    let held = LoopRecord {
        steps,
        missed_deadlines: 1,
        late_steps: 3,
        lateness_max_ns: 12_000_000,
        ..LoopRecord::default()
    };
    WindowRecord {
        format: record::FORMAT,
        window,
        environment: format!("matrix-2026-11-21-{slug}-1"),
        starts_run: window == 1,
        complete: true,
        started_unix_ns: 0,
        ended_unix_ns: 0,
        started_ns: 0,
        ended_ns: 0,
        of: OfExperiment::Loops(LoopsRecord {
            steps_expected: steps,
            steps_done: steps,
            controller: held,
            plant: held,
            stale_steps: 6,
            longest_gap_ns: 120_000_000,
            log_dropped: 0,
        }),
        clock_jump_ns: 0,
        cpu_share: 0.025,
        conditions: ConditionsRecord::default(),
        captures: Vec::new(),
        network_seed: None,
        links: Vec::new(),
        notices: NoticesRecord::default(),
        releases: None,
        files: vec![file_record(log)],
        verdict: Verdict::Valid,
        reasons: Vec::new(),
    }
}
