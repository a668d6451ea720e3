//! How a report came about, in sentences that stand with its tables.

use record::{
    report_settings::{ErrorOf, Method, ReportSettings, WarmUp},
    run_directory::Revision,
};

use crate::{analysis::report::Report, input::run::RunPart};

impl Report {
    /// Which rules the experiment followed, in one sentence.
    fn dynamics(&self) -> String {
        let mut kinds: Vec<(&str, &[String], Vec<&str>)> = Vec::new();
        for scenario in &self.scenarios {
            let (name, overridden) = (scenario.dynamics.name(), scenario.overridden.as_slice());
            match kinds
                .iter_mut()
                .find(|kind| (kind.0, kind.1) == (name, overridden))
            {
                Some((.., letters)) => letters.push(&scenario.id),
                None => kinds.push((name, overridden, vec![&scenario.id])),
            }
        }
        let several = kinds.len() > 1;
        let described = kinds.iter().map(|(name, overridden, letters)| {
            let but = match overridden {
                [] => String::new(),
                _ => format!(" but for {}", overridden.join(", ")),
            };
            let of = if several {
                format!(" ({})", letters.join(", "))
            } else {
                String::new()
            };
            format!("{name}{but}{of}")
        });
        format!("Dynamics: {}.", described.collect::<Vec<_>>().join("; "))
    }

    /// Which run directories it is made of, and which `matrix` wrote them, a sentence for each.
    #[must_use]
    pub fn origins(&self) -> Vec<String> {
        let origin = |part: &RunPart| {
            let revision = part.matrix_revision.as_ref();
            let revision = revision.map_or_else(|| "unknown".to_owned(), Revision::to_string);
            let scenarios = match self.parts.len() {
                1 => String::new(),
                _ if part.scenarios.is_empty() => ": no scenario".to_owned(),
                _ => format!(": {}", part.scenarios.join(", ")),
            };
            format!(
                "Run {} of {} by matrix {}, revision {revision}{scenarios}.",
                part.run, part.created, part.matrix_version
            )
        };
        self.parts.iter().map(origin).collect()
    }

    /// How samples were taken and compared, in three sentences. Stands with every table.
    #[must_use]
    pub fn method(&self) -> String {
        let ReportSettings {
            alpha,
            metric,
            error,
            discard_periods,
            warm_up,
            ..
        } = &self.settings;
        let error = match error {
            ErrorOf::Received => "",
            ErrorOf::TruePosition => " of the ball's true position",
        };
        let discarded = match discard_periods {
            0 => "no period left out".to_owned(),
            1 => "the first period of each run left out".to_owned(),
            many => format!("the first {many} periods of each run left out"),
        };
        let cut = match warm_up {
            WarmUp::Flag => "",
            WarmUp::Cut => ", and those in which a window warms up (MSER)",
        };
        let in_the_limit: usize = self.tallies.iter().map(|tally| tally.in_the_limit).sum();
        let test = match (self.settings.method, in_the_limit) {
            (Method::Exact, 0) => "exact given the ties",
            (Method::Exact, _) => "exact given the ties, asymptotic where `comparisons.csv` says so",
            (Method::Asymptotic, _) => "p asymptotic (Kolmogorov's limit, ties not regarded)",
            (Method::Paper, _) => {
                "p as the paper's tools had it (limit with Stephens's correction, ties not regarded)"
            }
        };
        format!(
            "{} Metric: {}{error} over each period, in metres, {discarded}{cut}. Test: two-sample Kolmogorov-Smirnov, {test}; \
             rejected at p < {alpha}.",
            self.dynamics(),
            metric.formula()
        )
    }
}
