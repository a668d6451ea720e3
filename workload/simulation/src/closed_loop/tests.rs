//! The closed loop against an independent simulation, and against what its order of things gives by hand.

use record::{platform_model::Quantiles, quantity::TimeSpan, settings::Dynamics};
use rstest::rstest;

use super::*;

fn settings(phase_ms: u64) -> Settings {
    let mut settings = Settings::of(Dynamics::Robust);
    settings.control.phase = TimeSpan::from_millis(phase_ms);
    settings
}

fn fixed(settings: &Settings, one_way_us: u64) -> Simulation {
    Simulation::new(settings, &Platform::fixed(Duration::from_micros(one_way_us)), 0)
}

/// Each packet takes up to `jitter_us` more or less, and none is lost.
fn jittered(settings: &Settings, one_way_us: u64, jitter_us: u64, seed: u64) -> Simulation {
    let mut platform = Platform::fixed(Duration::ZERO);
    platform.network.impairment.delay_ns = one_way_us * 500;
    platform.network.impairment.jitter_ns = jitter_us * 500;
    Simulation::new(settings, &platform, seed)
}

struct Errors {
    true_x_m: f64,
    received_x_m: f64,
    steps_at_limit: usize,
}

/// Over the second period; the first is left out.
fn errors(settings: &Settings, one_way_us: u64) -> Errors {
    let steps = settings.steps_per_period() as usize;
    let period: Vec<SimulatedStep> = fixed(settings, one_way_us).skip(steps).take(steps).collect();
    let mean = |error: fn(&SimulatedStep) -> f64| {
        period.iter().map(|step| error(step).abs()).sum::<f64>() / steps as f64
    };
    Errors {
        true_x_m: mean(|step| step.row.reference_x_m - step.true_position_m[0]),
        received_x_m: mean(|step| step.row.reference_x_m - step.row.x_m),
        steps_at_limit: period.iter().filter(|step| step.at_angle_limit).count(),
    }
}

#[test]
fn with_20_ms_each_way_the_true_error_is_that_of_the_independent_simulation() {
    let errors = errors(&settings(0), 20_000);
    assert!((errors.true_x_m - 0.118).abs() < 0.0005, "{}", errors.true_x_m);
    assert!(
        (errors.received_x_m - 0.1204).abs() < 0.0005,
        "{}",
        errors.received_x_m
    );
    assert_eq!(errors.steps_at_limit, 0);
}

/// See the module's header for why this is not the independent simulation's 0.144.
#[test]
fn with_40_ms_each_way_the_loop_is_in_a_limit_cycle() {
    let errors = errors(&settings(0), 40_000);
    assert!(errors.steps_at_limit > 100, "{}", errors.steps_at_limit);
    assert!((errors.true_x_m - 0.1173).abs() < 0.002, "{}", errors.true_x_m);
    assert!(
        (errors.received_x_m - 0.1222).abs() < 0.002,
        "{}",
        errors.received_x_m
    );
}

#[rstest]
#[case::exact(20_000)]
#[case::a_little_more(20_300)]
#[case::late_by_jitter(23_000)]
#[case::early_by_jitter(17_000)]
fn half_a_step_of_phase_keeps_the_loop_linear(#[case] one_way_us: u64) {
    let errors = errors(&settings(10), one_way_us);
    assert_eq!(errors.steps_at_limit, 0);
    assert!(
        (errors.received_x_m - 0.1204).abs() < 0.0005,
        "{}",
        errors.received_x_m
    );
}

#[test]
fn without_phase_a_microsecond_more_of_delay_is_a_limit_cycle() {
    assert_eq!(errors(&settings(0), 20_000).steps_at_limit, 0);
    assert!(errors(&settings(0), 20_001).steps_at_limit > 0);
}

/// With a short period the plate has more to do: the amplitude must shrink with it.
#[rstest]
#[case::quick(0.4, false)]
#[case::nearly_too_much(0.6, false)]
#[case::too_much(1.0, true)]
fn with_a_period_of_4_s_the_loop_is_linear_up_to_0_6_m(#[case] amplitude_m: f64, #[case] limited: bool) {
    let mut settings = settings(10);
    settings.period = TimeSpan::from_secs(4);
    settings.reference.amplitude_m = amplitude_m;
    let mut run = fixed(&settings, 20_300).take(1600);
    assert_eq!(run.any(|step| step.at_angle_limit), limited);
}

/// The property that the choice of dynamics is about. The way there and back is 36 to 44 ms before, so that some answers
/// come in time for the second control step after the command and some for the third, and 46 to 54 ms after.
#[test]
fn a_longer_way_moves_the_authors_error_and_not_the_robust_one() {
    let mean_m = |dynamics, one_way_us| {
        let mut settings = Settings::of(dynamics);
        settings.control.phase = TimeSpan::from_millis(10);
        let steps = settings.steps_per_period() as usize;
        let rows = jittered(&settings, one_way_us, 2_000, 1)
            .skip(steps)
            .take(8 * steps);
        let error =
            |row: ControlRow| (row.reference_x_m - row.x_m).abs() + (row.reference_y_m - row.y_m).abs();
        rows.map(|step| error(step.row)).sum::<f64>() / (8 * steps) as f64
    };
    let moved = |dynamics| mean_m(dynamics, 25_000) - mean_m(dynamics, 20_000);
    assert!(moved(Dynamics::Author) > 0.001, "{}", moved(Dynamics::Author));
    assert!(
        moved(Dynamics::Robust).abs() < 0.000_02,
        "{}",
        moved(Dynamics::Robust)
    );
}

#[test]
fn the_author_s_plant_answers_a_command_with_the_state_of_its_newest_tick() {
    let rows: Vec<ControlRow> = fixed(&Settings::of(Dynamics::Author), 20_000)
        .take(5)
        .map(|step| step.row)
        .collect();
    // The command of step 0 arrives after 20 ms and its answer after 40, in time for step 2.
    assert_eq!((rows[1].state_seq, rows[2].state_seq), (0, 1));
    assert_eq!(
        (rows[2].state_stamp_ns, rows[2].state_received_ns),
        (0, 40_000_000)
    );
    assert_eq!(
        (rows[3].state_stamp_ns, rows[4].state_stamp_ns),
        (20_000_000, 40_000_000)
    );
}

#[test]
fn a_state_arrives_as_old_as_the_delay_and_the_schedule_make_it() {
    let rows: Vec<ControlRow> = fixed(&settings(10), 20_000)
        .take(4)
        .map(|step| step.row)
        .collect();
    assert_eq!((rows[0].state_seq, rows[0].state_stamp_ns), (0, 0));
    // Stamped at the plant's tick, 10 ms before the first control step; received 20 ms later.
    assert_eq!(
        (
            rows[1].state_seq,
            rows[1].state_stamp_ns,
            rows[1].state_received_ns
        ),
        (1, -10_000_000, 10_000_000)
    );
    assert_eq!((rows[3].scheduled_ns, rows[3].state_seq), (60_000_000, 3));
}

fn often_late(share: f64, length_ms: u64) -> TickLateness {
    TickLateness {
        late: Quantiles::sometimes(share, TimeSpan::from_millis(length_ms)),
        ..TickLateness::default()
    }
}

#[test]
fn the_same_seed_gives_the_same_run_and_another_does_not() {
    let settings = Settings::default();
    let run = |seed| -> Vec<SimulatedStep> {
        let platform = Platform {
            controller: often_late(0.01, 50),
            plant: often_late(0.01, 50),
            ..Platform::ideal(&settings)
        };
        Simulation::new(&settings, &platform, seed).take(500).collect()
    };
    assert_eq!(run(7), run(7));
    assert_ne!(run(7), run(8));
}

#[test]
fn messages_do_not_overtake_each_other() {
    let seqs: Vec<u64> = jittered(&Settings::of(Dynamics::Robust), 100_000, 100_000, 3)
        .take(2000)
        .map(|step| step.row.state_seq)
        .collect();
    assert!(seqs.is_sorted());
}

/// On the paper's links with Nagle a loss is noticed after a quarter of a second, and the states wait for it.
#[test]
fn a_lost_message_keeps_the_author_s_loop_without_a_new_state_for_a_quarter_of_a_second() {
    let settings = Settings::of(Dynamics::Author);
    let rows: Vec<ControlRow> = Simulation::new(&settings, &Platform::ideal(&settings), 1)
        .take(5000)
        .map(|step| step.row)
        .collect();
    let stale = rows.chunk_by(|a, b| a.state_seq == b.state_seq).map(<[_]>::len);
    // Steps of 20 ms.
    assert!((13..60).contains(&stale.max().unwrap()));
    let lossless = {
        let mut settings = settings.clone();
        settings.network.loss = record::quantity::Fraction::from_percent(0.0);
        settings
    };
    let rows: Vec<ControlRow> = Simulation::new(&lossless, &Platform::ideal(&lossless), 1)
        .skip(10)
        .take(5000)
        .map(|step| step.row)
        .collect();
    let stale = rows.chunk_by(|a, b| a.state_seq == b.state_seq).map(<[_]>::len);
    assert!(stale.max().unwrap() <= 6);
}

#[test]
fn a_stall_of_five_steps_loses_the_author_s_ticks_and_none_of_the_robust() {
    let rows = |dynamics| -> Vec<ControlRow> {
        let settings = Settings::of(dynamics);
        let platform = Platform {
            controller: often_late(0.02, 100),
            plant: often_late(0.02, 100),
            ..Platform::ideal(&settings)
        };
        Simulation::new(&settings, &platform, 5)
            .take(1000)
            .map(|step| step.row)
            .collect()
    };
    let missing = |rows: &[ControlRow]| rows.last().unwrap().step + 1 - rows.len() as u64;
    assert_eq!(missing(&rows(Dynamics::Robust)), 0);
    assert!(missing(&rows(Dynamics::Author)) > 50);
}
