//! A setting of the report that an option of the command line gives in the place of a run's, read as the matrix file's
//! `report:` section is. The main type is [`ReportOption`].

use std::sync::Arc;

use record::{report_settings::ReportSettings, run_directory::PlannedScenario};

use super::{
    Diagnostics, Places, check_alpha,
    source::{Source, Span, Spanned},
    tree::{Content, Entry, Node},
    typing, yaml,
};
use crate::plan::report_names;

type Check = fn(&Places<'_>, &ReportSettings, &[PlannedScenario], &mut Diagnostics);

/// An option and the setting that it gives.
#[derive(Debug, Clone, Copy)]
pub struct ReportOption {
    /// Such as `--discard-periods`.
    name: &'static str,
    /// The setting's key in `report:`.
    key: &'static str,
    check: Check,
}

impl ReportOption {
    /// `--alpha`.
    pub const ALPHA: Self = Self::new("--alpha", "alpha", |places, report, _, found| {
        check_alpha(places, report, found);
    });
    /// `--metric`.
    pub const METRIC: Self = Self::new("--metric", "metric", fits);
    /// `--error`.
    pub const ERROR: Self = Self::new("--error", "error", fits);
    /// `--method`.
    pub const METHOD: Self = Self::new("--method", "method", fits);
    /// `--discard-periods`.
    pub const DISCARD_PERIODS: Self = Self::new("--discard-periods", "discard_periods", fits);
    /// `--warm-up`.
    pub const WARM_UP: Self = Self::new("--warm-up", "warm_up", fits);
    /// `--baseline`.
    pub const BASELINE: Self = Self::new("--baseline", "baseline", report_names::check_baseline);
    /// `--family`.
    pub const FAMILY: Self = Self::new("--family", "family", report_names::check_family);
    /// `--figures`.
    pub const FIGURES: Self = Self::new("--figures", "figures", report_names::check_figures);

    const fn new(name: &'static str, key: &'static str, check: Check) -> Self {
        Self { name, key, check }
    }

    /// As it is typed.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        self.name
    }

    /// Whether it says nothing of a user's command.
    #[must_use]
    pub fn is_of_the_ball(&self) -> bool {
        ReportSettings::OF_THE_BALL.contains(&self.key)
    }

    /// The settings with this one replaced by what a person wrote, and what is odd about it and yet no error. `scenarios` are
    /// those that it can name.
    ///
    /// # Errors
    /// All that is wrong with it, at its place behind the option.
    pub fn apply(
        &self,
        text: &str,
        settings: &ReportSettings,
        scenarios: &[PlannedScenario],
    ) -> Result<(ReportSettings, Diagnostics), Diagnostics> {
        let source = Arc::new(Source::new(self.name, text));
        let value = match text.trim() {
            "" => nothing(),
            _ => yaml::parse(&source)?,
        };
        let mut report = serde_json::to_value(settings)
            .map_or(Node::empty_mapping(Span::default()), |settings| {
                Node::of_json(&settings)
            });
        report.insert(self.key, value.span, value);
        let settings: ReportSettings = typing::read(&source, &report)?;
        let tree = Node {
            span: report.span,
            content: Content::Mapping(vec![Entry {
                key: Spanned::new(super::sections::REPORT.to_owned(), Span::default()),
                value: report,
            }]),
        };
        let places = Places {
            source: &source,
            tree: &tree,
        };
        let mut found = Diagnostics::new();
        (self.check)(&places, &settings, scenarios, &mut found);
        found.unless_errors(settings)
    }
}

/// What its type takes is right.
fn fits(_: &Places<'_>, _: &ReportSettings, _: &[PlannedScenario], _: &mut Diagnostics) {}

/// What an empty text is.
fn nothing() -> Node {
    Node::of_json(&serde_json::Value::Null)
}

#[cfg(test)]
mod tests {
    use record::settings::Settings;
    use rstest::rstest;

    use super::*;

    fn scenarios() -> Vec<PlannedScenario> {
        let scenario = |id: &str, virtualization: &str| PlannedScenario {
            id: id.to_owned(),
            slug: format!("debian-{virtualization}"),
            axes: [("virtualization".to_owned(), virtualization.into())]
                .into_iter()
                .collect(),
            host: None,
            pool: Vec::new(),
            feasible: true,
            reason: None,
            fix: None,
            not_selected: None,
            simulated: false,
            settings: Settings::default(),
        };
        vec![scenario("a", "native"), scenario("b", "docker")]
    }

    #[rstest]
    #[case::figures(
        ReportOption::FIGURES,
        "[[b, a], [a/1, debian-docker/4]]",
        r#"[["b","a"],["a/1","debian-docker/4"]]"#
    )]
    #[case::baseline(
        ReportOption::BASELINE,
        "{virtualization: docker}",
        r#"{"virtualization":"docker"}"#
    )]
    #[case::family(ReportOption::FAMILY, "against-baseline", r#""against-baseline""#)]
    #[case::pairs(ReportOption::FAMILY, "[[a, b]]", r#"[["a","b"]]"#)]
    #[case::metric(ReportOption::METRIC, "mean-abs-x", r#""mean-abs-x""#)]
    #[case::error(ReportOption::ERROR, "true-position", r#""true-position""#)]
    #[case::alpha(ReportOption::ALPHA, "0.01", "0.01")]
    fn an_option_takes_what_the_matrix_file_takes(
        #[case] option: ReportOption,
        #[case] text: &str,
        #[case] value: &str,
    ) {
        let (settings, warnings) = option
            .apply(text, &ReportSettings::default(), &scenarios())
            .unwrap();
        assert!(warnings.is_empty());
        let mut expected = serde_json::to_value(ReportSettings::default()).unwrap();
        expected[option.key] = serde_json::from_str(value).unwrap();
        assert_eq!(serde_json::to_value(settings).unwrap(), expected);
    }

    #[rstest]
    #[case::no_such_scenario(ReportOption::FIGURES, "[[a, b], [a, c]]")]
    #[case::no_such_window(ReportOption::FIGURES, "[[a/1, b/5]]")]
    #[case::no_window(ReportOption::FIGURES, "[[a/one, b]]")]
    #[case::no_pair(ReportOption::FIGURES, "[[a]]")]
    #[case::three(ReportOption::FIGURES, "[[a, b, a]]")]
    #[case::no_list(ReportOption::FIGURES, "a")]
    #[case::not_yaml(ReportOption::FIGURES, "[[a, b]")]
    #[case::nothing(ReportOption::FAMILY, "")]
    #[case::misspelt_family(ReportOption::FAMILY, "against-baselin")]
    #[case::family_of_no_scenario(ReportOption::FAMILY, "[[a, z]]")]
    #[case::misspelt_metric(ReportOption::METRIC, "mean-abs")]
    #[case::misspelt_error(ReportOption::ERROR, "true")]
    #[case::alpha_out_of_range(ReportOption::ALPHA, "5")]
    #[case::baseline_on_no_axis(ReportOption::BASELINE, "{virtualisation: native}")]
    #[case::baseline_that_is_a_word(ReportOption::BASELINE, "native")]
    fn what_is_wrong_is_shown_behind_the_option(#[case] option: ReportOption, #[case] text: &str) {
        let found = option
            .apply(text, &ReportSettings::default(), &scenarios())
            .unwrap_err();
        let thread = std::thread::current();
        let case = thread
            .name()
            .and_then(|name| name.rsplit("::").next())
            .unwrap_or_default();
        let name = case.splitn(3, '_').nth(2).unwrap_or_default();
        insta::with_settings!({ description => text, omit_expression => true }, {
            insta::assert_snapshot!(name, found);
        });
    }

    #[test]
    fn a_baseline_that_no_scenario_is_is_a_warning() {
        let text = "{virtualization: kvm}";
        let (_, warnings) = ReportOption::BASELINE
            .apply(text, &ReportSettings::default(), &scenarios())
            .unwrap();
        assert!(
            warnings.to_string().contains("the baseline is empty"),
            "{warnings}"
        );
    }
}
