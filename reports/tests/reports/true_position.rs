//! `report.error: true-position`: the error of where the ball was, by the plant's log.

use std::fs;

use captures::traffic::Traffic;
use record::{plant_log::PlantRow, report_settings::ErrorOf};
use reports::{analyse, analysis::other_ways::other_ways, input::run::WindowState, load_from};

use crate::synthetic::{Scenario, Synthetic, file_record, log};

/// Each window has a plant's log by which the ball was a quarter of a metre below its reference.
fn with_plant_logs(received_m: [f64; 2]) -> Synthetic {
    let synthetic = Synthetic::new(&[Scenario::measured("x86-debian-native", &received_m)]);
    for window in [1, 2] {
        let control = log(u64::from(window) - 1, 0.1, 1);
        let column = |name: &str| {
            control
                .lines()
                .next()
                .unwrap()
                .split(',')
                .position(|it| it == name)
                .unwrap()
        };
        let columns = ["scheduled_ns", "reference_x_m", "reference_y_m"].map(column);
        let mut plant = format!("{}\n", PlantRow::HEADER).into_bytes();
        for (step, line) in (0..).zip(control.lines().skip(1)) {
            let fields: Vec<&str> = line.split(',').collect();
            let [actual_ns, x_m, y_m] = columns.map(|at| fields[at]);
            let row = PlantRow {
                step,
                actual_ns: actual_ns.parse().unwrap(),
                x_m: x_m.parse().unwrap(),
                y_m: y_m.parse::<f64>().unwrap() - 0.25,
                ..PlantRow::default()
            };
            row.write_to(&mut plant).unwrap();
        }
        let plant = String::from_utf8(plant).unwrap();
        let folder = synthetic.directory.window("x86-debian-native", window).path();
        fs::write(folder.join("plant.csv"), &plant).unwrap();
        let mut described = file_record(&plant);
        described.name = "plant.csv".to_owned();
        synthetic.edit_window("x86-debian-native", window, |record| record.files.push(described));
    }
    synthetic
}

#[test]
fn the_error_is_of_where_the_ball_was_and_the_report_says_so() {
    let synthetic = with_plant_logs([0.1, 0.1]);
    let run = load_from(&synthetic.directory, Some(ErrorOf::TruePosition)).unwrap();
    let report = analyse(&run, Traffic::default(), &run.manifest.report);
    for sample in &report.samples {
        assert!(
            sample.values.iter().all(|error_m| (error_m - 0.25).abs() < 1e-12),
            "{sample:?}"
        );
    }
    assert!(
        report.method().contains("of the ball's true position"),
        "{}",
        report.method()
    );
    assert!(
        report
            .present()
            .remarks
            .iter()
            .any(|remark| remark.contains("error (`true-position`, declared was `received`)")),
        "{:?}",
        report.present().remarks
    );
}

#[test]
fn the_error_is_of_what_the_controller_received_unless_another_is_asked_for() {
    let synthetic = with_plant_logs([0.1, 0.1]);
    let run = load_from(&synthetic.directory, None).unwrap();
    let report = analyse(&run, Traffic::default(), &run.manifest.report);
    assert!(
        report.samples[0].values.iter().all(|error_m| *error_m < 0.23),
        "{:?}",
        report.samples
    );
    assert!(!report.method().contains("true position"));
}

#[test]
fn a_table_says_what_other_settings_would_have_found() {
    let synthetic = with_plant_logs([0.1, 0.4]);
    let run = load_from(&synthetic.directory, None).unwrap();
    let other = load_from(&synthetic.directory, Some(ErrorOf::TruePosition)).unwrap();
    let settings = &run.manifest.report;
    let mut report = analyse(&run, Traffic::default(), settings);
    report.other_ways = other_ways(&report, &run, Some(&other));
    let table = report
        .present()
        .tables
        .into_iter()
        .find(|table| table.id == "sensitivity")
        .unwrap();
    let rows: Vec<String> = table.rows.iter().map(|row| row[..4].join(" ")).collect();
    // The controller received two windows that are far apart, and the ball was at the same place in both.
    assert_eq!(
        rows,
        [
            "as reported  1 of 1 0 of 0",
            "method asymptotic 1 of 1 0 of 0",
            "method paper 1 of 1 0 of 0",
            "metric mean-abs-x 1 of 1 0 of 0",
            "metric mean-abs-y 1 of 1 0 of 0",
            "metric mean-distance 1 of 1 0 of 0",
            "metric root-mean-square 1 of 1 0 of 0",
            "discard_periods 0 1 of 1 0 of 0",
            "error true-position 0 of 1 0 of 0",
        ]
    );
}

#[test]
fn a_run_without_the_plants_log_has_no_true_position() {
    let synthetic = Synthetic::new(&[Scenario::measured("x86-debian-native", &[0.1])]);
    let error = load_from(&synthetic.directory, Some(ErrorOf::TruePosition)).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("plant.csv, so the true error is not known"),
        "{error}"
    );
    assert!(error.hint().contains("`--error received`"), "{}", error.hint());
}

#[test]
fn a_plants_log_that_was_changed_is_not_used() {
    let synthetic = with_plant_logs([0.1, 0.1]);
    let path = synthetic
        .directory
        .window("x86-debian-native", 2)
        .join("plant.csv")
        .path();
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replacen("0.", "1.", 1)).unwrap();
    let run = load_from(&synthetic.directory, Some(ErrorOf::TruePosition)).unwrap();
    let WindowState::Broken { reason } = &run.scenarios[0].windows[1].state else {
        panic!("{:?}", run.scenarios[0].windows[1].state);
    };
    assert!(
        reason.starts_with("plant.csv cannot be used: it is not the file that was measured"),
        "{reason}"
    );
    let run = load_from(&synthetic.directory, None).unwrap();
    assert!(matches!(
        run.scenarios[0].windows[1].state,
        WindowState::Counted { .. }
    ));
}
