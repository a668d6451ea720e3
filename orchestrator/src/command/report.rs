//! `matrix report RUN`: tables and figures, at any time, from the run directory alone.

use std::path::PathBuf;

use clap::Args;
use reports::{
    ReadError,
    ks::Method,
    run_directory::RunDirectory,
    settings::{Metric, WarmUp},
};
use serde::de::DeserializeOwned;

use crate::{
    arguments::OutputArguments,
    exit::Exit,
    run::session,
    terminal::{self, Complaint},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct ReportArguments {
    /// The run directory.
    run: PathBuf,
    /// Another level than the matrix file's.
    #[arg(long)]
    alpha: Option<f64>,
    /// Another metric than the matrix file's: mean-abs-sum, mean-abs-x, mean-abs-y, mean-distance, root-mean-square.
    #[arg(long, value_parser = spelt::<Metric>)]
    metric: Option<Metric>,
    /// Another way to p-values than the matrix file's: exact, asymptotic, paper.
    #[arg(long, value_parser = spelt::<Method>)]
    method: Option<Method>,
    /// Another number of first periods to leave out than the matrix file's.
    #[arg(long, value_name = "N")]
    discard_periods: Option<u32>,
    /// What to do about windows that warm up for longer: flag, cut.
    #[arg(long, value_name = "WHAT", value_parser = spelt::<WarmUp>)]
    warm_up: Option<WarmUp>,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// As the matrix file spells it.
fn spelt<T: DeserializeOwned>(name: &str) -> Result<T, String> {
    serde_json::from_value(serde_json::Value::String(name.to_owned())).map_err(|error| error.to_string())
}

/// Makes and prints the report.
///
/// # Errors
/// When the run directory cannot be read or its report folder not written.
pub fn execute(arguments: &ReportArguments) -> Result<Exit, Complaint> {
    let run = reports::load(&arguments.run).map_err(|error| unreadable(&error))?;
    let mut settings = run.manifest.report.clone();
    if let Some(alpha) = arguments.alpha {
        if !(alpha > 0.0 && alpha < 1.0) {
            return Err(Complaint {
                what: format!("{alpha} is not a level").into(),
                hint: Some("give a number between 0 and 1, such as `--alpha 0.001`".to_owned()),
                exit: Exit::Wrong,
            });
        }
        settings.alpha = alpha;
    }
    settings.method = arguments.method.unwrap_or(settings.method);
    settings.metric = arguments.metric.unwrap_or(settings.metric);
    settings.discard_periods = arguments.discard_periods.unwrap_or(settings.discard_periods);
    settings.warm_up = arguments.warm_up.unwrap_or(settings.warm_up);
    let report = reports::analyse(&run, reports::traffic::read(&run), &settings);
    reports::write(&run, &report)
        .map_err(|error| Complaint::new(Exit::Infrastructure, &error, Some(error.hint().to_owned())))?;
    if arguments.output.json {
        terminal::json(&report.json());
    } else {
        terminal::result(&report.markdown());
    }
    Ok(Exit::Done)
}

/// The report at the end of a run, with what there is; keeps the run's exit code.
///
/// # Errors
/// When the report cannot be made.
pub fn after_run(directory: &RunDirectory, exit: Exit, output: OutputArguments) -> Result<Exit, Complaint> {
    execute(&ReportArguments {
        run: directory.path().to_owned(),
        alpha: None,
        metric: None,
        method: None,
        discard_periods: None,
        warm_up: None,
        output,
    })?;
    if !output.quiet {
        terminal::remark(&format!("run directory: {}", directory.path().display()));
        if exit != Exit::Done {
            terminal::remark(&session::how_to_go_on(directory.path()));
        }
    }
    Ok(exit)
}

/// A run directory that cannot be read.
pub(super) fn unreadable(error: &ReadError) -> Complaint {
    Complaint::new(Exit::Wrong, error, Some(error.hint()))
}
