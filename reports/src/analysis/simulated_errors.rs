//! What a report would compare of a simulated window. The function is [`period_errors_m`].

use record::{
    report_settings::{ErrorOf, ReportSettings},
    run_directory::PeriodError,
    settings::Settings,
};
use simulation::closed_loop::{Platform, Simulation};

/// The errors of the periods of so many control steps, in metres, after the periods that the report leaves out.
#[must_use]
pub fn period_errors_m(
    settings: &Settings,
    report: &ReportSettings,
    error: ErrorOf,
    platform: &Platform,
    (steps, seed): (u64, u64),
) -> Vec<f64> {
    let per_period = settings.steps_per_period().max(1);
    let first = u64::from(report.discard_periods) * per_period;
    let counted = Simulation::new(settings, platform, seed)
        .skip_while(|step| step.row.step < first)
        .take_while(|step| step.row.step < first + steps);
    let mut periods_m = Vec::new();
    let mut under_way_m: Vec<[f64; 2]> = Vec::new();
    let mut period = None;
    let mean = |errors_m: &mut Vec<[f64; 2]>| report.metric.of(&PeriodError::mean(errors_m.drain(..)));
    for step in counted {
        let row = step.row;
        let number = row.step / per_period;
        if period.replace(number).is_some_and(|before| before != number) {
            periods_m.push(mean(&mut under_way_m));
        }
        let [x_m, y_m] = match error {
            ErrorOf::Received => [row.x_m, row.y_m],
            ErrorOf::TruePosition => step.true_position_m,
        };
        under_way_m.push([row.reference_x_m - x_m, row.reference_y_m - y_m]);
    }
    if !under_way_m.is_empty() {
        periods_m.push(mean(&mut under_way_m));
    }
    periods_m
}
