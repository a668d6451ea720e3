//! `matrix calibrate RUN`: how often each method finds a difference where there is none, for data like that of the run.

use std::{fmt::Write, path::PathBuf};

use clap::Args;
use record::exit::matrix::Exit;
use reports::{
    analysis::{
        calibration::{self, Calibration, Model, Rate},
        quantity::Quantity,
        sample,
    },
    input::run::ScenarioRun,
};
use schemars::JsonSchema;
use serde::Serialize;

use crate::cli::{
    command::{options::OutputArguments, report::unreadable},
    completion, plain_log,
    run_argument::run_argument,
    terminal::{self, CommandError},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct CalibrateArguments {
    /// The run directory.
    #[arg(value_parser = run_argument(), add = completion::runs())]
    run: PathBuf,
    /// How many made-up experiments without a difference each method is tried on.
    #[arg(long, value_name = "N", default_value_t = 400, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    repeats: u32,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// How often each method finds a difference where there is none, for data like that of a run.
#[derive(Debug, Serialize, JsonSchema)]
#[schemars(title = "matrix calibrate --json")]
pub struct CalibrateDocument {
    /// Whether one of the scenarios is simulated, not measured.
    simulated: bool,
    /// What the windows of the run are like.
    model: Model,
    /// Of the orders of each scenario's windows, the share whose levels go as smoothly as in the order in which they were measured;
    /// a small one shows windows that drift or remember. Null where no scenario has three windows.
    p_of_order: Option<f64>,
    /// Each method on each kind of data.
    rates: Vec<RateRecord>,
}

/// How often a method finds a difference.
#[derive(Debug, Serialize, JsonSchema)]
struct RateRecord {
    /// The method.
    method: String,
    /// The kind of data.
    data: &'static str,
    /// The level that the method is to hold.
    nominal: f64,
    /// Trials that it rejected.
    rejected: usize,
    /// Trials; 0 where no p can be below the level.
    trials: usize,
    /// Independent trials that these are worth at least: pairs that share a window are not independent.
    independent: usize,
    /// Lower end of Wilson's 95 % interval of the rate, of the independent trials, 0 to 1.
    low: f64,
    /// Upper end of that interval.
    high: f64,
}

/// Tries the methods and prints their rates.
///
/// # Errors
/// When the run directory cannot be read, or has no two windows of one scenario.
pub fn execute(arguments: &CalibrateArguments) -> Result<Exit, CommandError> {
    let run = reports::load(&arguments.run).map_err(|error| unreadable(&error))?;
    let settings = &run.manifest.report;
    let quantity = Quantity::main_of_run(&run, settings);
    let samples = sample::samples(&run, settings, &quantity);
    let found = calibration::calibrate(&samples, settings, arguments.repeats as usize).ok_or_else(|| {
        CommandError {
            what: "no scenario of this run has two windows that count and differ".into(),
            hint: Some("`matrix calibrate` compares windows of one scenario: measure two or more".to_owned()),
            exit: Exit::Wrong,
        }
    })?;
    let simulated = run.scenarios.iter().any(ScenarioRun::is_simulated);
    if arguments.output.json {
        terminal::json(&document(&found, simulated));
    } else {
        let mark = plain_log::if_simulated(simulated);
        terminal::result(&as_text(&found, &quantity, mark));
    }
    Ok(Exit::Done)
}

fn document(found: &Calibration, simulated: bool) -> CalibrateDocument {
    let rates = found.rates.iter().map(|rate| {
        let (low, high) = rate.interval();
        RateRecord {
            method: rate.method.clone(),
            data: rate.data,
            nominal: rate.nominal,
            rejected: rate.rejected,
            trials: rate.trials,
            independent: rate.independent,
            low,
            high,
        }
    });
    CalibrateDocument {
        simulated,
        model: found.model,
        p_of_order: found.p_of_order,
        rates: rates.collect(),
    }
}

fn as_text(found: &Calibration, quantity: &Quantity, mark: &str) -> String {
    let model = &found.model;
    let mut text = format!(
        "{} scenarios of {} windows of {} values{mark}\nwithin windows: standard deviation {}, lag 1 {:.2}\nwindow \
         levels: standard deviation {} beyond that, 95 % interval [{}, {}]\n",
        model.scenarios,
        model.windows,
        model.values,
        quantity.magnitude_text(model.within),
        model.phi,
        quantity.magnitude_text(model.between),
        quantity.magnitude(model.between_low),
        quantity.magnitude(model.between_high),
    );
    if let Some(p) = found.p_of_order {
        let _ = writeln!(
            text,
            "order of the windows: p = {p:.4} of levels that go as smoothly"
        );
    }
    text.push_str("\nfalse positives, with Wilson's 95 % interval\n");
    let mut data = "";
    for rate in &found.rates {
        if rate.data != data {
            data = rate.data;
            let _ = writeln!(text, "\n{data}");
        }
        let _ = writeln!(text, "{}", line(rate));
    }
    text
}

fn line(rate: &Rate) -> String {
    let (low, high) = rate.interval();
    // What is asked for is outside of what was found.
    let verdict = match (rate.nominal < low, rate.nominal > high) {
        _ if rate.trials == 0 => "cannot",
        (true, _) => "too often",
        (_, true) => "seldom",
        _ => "",
    };
    let line = format!(
        "  {:26} {:>6} of {:<6} at {:<5} [{low:.3}, {high:.3}] {verdict}",
        rate.method,
        rate.share()
            .map_or_else(|| "–".to_owned(), |share| format!("{share:.4}")),
        rate.trials,
        rate.nominal,
    );
    line.trim_end().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_fits_a_terminal_and_says_which_way_it_is_off() {
        let rate = |rejected| Rate {
            method: "energy, windows permuted".to_owned(),
            data: calibration::SHIFTED,
            nominal: 0.05,
            rejected,
            trials: 400,
            independent: 400,
        };
        assert!(line(&rate(200)).ends_with("too often"), "{}", line(&rate(200)));
        assert!(line(&rate(0)).ends_with("seldom"));
        assert!(line(&rate(20)).ends_with(']'));
        let never = Rate {
            trials: 0,
            independent: 0,
            ..rate(0)
        };
        assert!(line(&never).ends_with("cannot"), "{}", line(&never));
        assert!(line(&rate(200)).chars().count() <= 80, "{}", line(&rate(200)));
    }
}
