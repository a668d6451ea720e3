//! What several commands take.

use std::path::{Path, PathBuf};

use clap::{Args, ValueHint};

use crate::{
    cli::{completion, session::ProgressDisplay},
    plan::{Selection, order::Order},
    preparation::PlanRequest,
};

/// Which scenarios, and in which order.
#[derive(Debug, Clone, Default, Args)]
pub struct SelectionArguments {
    /// A profile of the matrix file.
    #[arg(long, value_name = "NAME", add = completion::profiles())]
    pub profile: Option<String>,
    /// Only scenarios that match: a letter, a slug, `axis=value` or a value; `*` and `?` stand for anything. May be repeated.
    #[arg(long, value_name = "PATTERN", add = completion::scenarios_of_file())]
    pub only: Vec<String>,
    /// Not the scenarios that match.
    #[arg(long, value_name = "PATTERN", add = completion::scenarios_of_file())]
    pub skip: Vec<String>,
    /// How scenarios are put in order.
    #[arg(long, value_enum, value_name = "HOW", default_value = "randomised")]
    pub order: Order,
    /// Seed of the order in which scenarios run.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Compute all scenarios in virtual time on this machine, and measure none.
    #[arg(long)]
    pub simulated: bool,
    /// Put each simulated scenario on the platform that `DIR/SLUG.yaml` describes.
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub platforms: Option<PathBuf>,
}

impl SelectionArguments {
    /// The plan of these scenarios of a matrix file.
    #[must_use]
    pub fn request<'a>(&'a self, file: &'a Path) -> PlanRequest<'a> {
        PlanRequest {
            file,
            profile: self.profile.as_deref(),
            selection: Selection {
                only: self.only.clone(),
                skip: self.skip.clone(),
            },
            order: self.order,
            seed: self.seed,
            simulated: self.simulated,
            platforms: self.platforms.as_deref(),
        }
    }
}

/// How to say it.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct OutputArguments {
    /// Print the result as JSON.
    #[arg(long)]
    pub json: bool,
    /// Print nothing but the result and errors.
    #[arg(long)]
    pub quiet: bool,
}

impl OutputArguments {
    /// What is shown of a run that goes on.
    pub const fn progress(self) -> ProgressDisplay {
        if self.quiet {
            ProgressDisplay::Nothing
        } else {
            ProgressDisplay::Progress
        }
    }
}
