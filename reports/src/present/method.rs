//! How a report came about, in sentences that stand with its tables.

use record::{report_settings::Method, run_directory::Revision};

use crate::{
    analysis::{measured_experiment::MeasuredExperiment, report::Report},
    input::run::RunPart,
    present::listing::listed,
};

impl Report {
    /// Which experiment was measured, in one sentence.
    fn experiment(&self) -> String {
        let mut kinds: Vec<(&MeasuredExperiment, Vec<&str>)> = Vec::new();
        for scenario in &self.scenarios {
            let same = |(experiment, _): &&mut (&MeasuredExperiment, Vec<&str>)| {
                experiment.description() == scenario.experiment.description()
            };
            match kinds.iter_mut().find(same) {
                Some((_, letters)) => letters.push(&scenario.id),
                None => kinds.push((&scenario.experiment, vec![&scenario.id])),
            }
        }
        let several = kinds.len() > 1;
        let described = kinds.iter().map(|(experiment, letters)| {
            let description = experiment.description();
            match several {
                true => format!("{description} ({})", listed(letters)),
                false => description,
            }
        });
        let topic = kinds
            .first()
            .map_or("Experiment", |(experiment, _)| experiment.topic());
        format!("{topic}: {}.", described.collect::<Vec<_>>().join("; "))
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
                _ => format!(": {}", listed(&part.scenarios)),
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
            "{} {} Test: two-sample Kolmogorov-Smirnov, {test}; rejected at p < {}.",
            self.experiment(),
            self.quantity.origin,
            self.settings.alpha
        )
    }
}
