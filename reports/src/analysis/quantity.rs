//! What the values of a report's samples are: its metric, with the unit of the values and the one that tables show. The main type is
//! [`Quantity`].

use record::{
    experiment::{Compare, Metric},
    quantity::Length,
    report_settings::{ErrorOf, ReportSettings, TRACKING_ERROR, WarmUp},
    settings::Settings,
};

use crate::input::run::Run;

/// A metric of an experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Quantity {
    /// Its name.
    pub name: String,
    /// The unit of its values, as all files of numbers have them; empty for numbers without one.
    pub unit: String,
    /// What is compared of it.
    pub compare: Compare,
    /// Whether it is the error of the ball on the plate.
    pub is_tracking_error: bool,
    /// Where its values come from, in a sentence.
    pub origin: String,
    /// A shift that is smaller does not matter, in its unit.
    pub equivalence_margin: Option<f64>,
    /// The setting in which that margin is declared.
    pub margin_setting: &'static str,
    /// What an axis with its values is called.
    axis_name: String,
    /// What tables show, and what a value is multiplied with for it.
    shown: (String, f64),
}

impl Quantity {
    /// The tracking error of the ball on the plate.
    #[must_use]
    pub fn tracking_error(settings: &ReportSettings) -> Self {
        let error = match settings.error {
            ErrorOf::Received => "",
            ErrorOf::TruePosition => " of the ball's true position",
        };
        let discarded = match settings.discard_periods {
            0 => "no period left out".to_owned(),
            1 => "the first period of each run left out".to_owned(),
            many => format!("the first {many} periods of each run left out"),
        };
        let cut = match settings.warm_up {
            WarmUp::Flag => "",
            WarmUp::Cut => ", and those in which a window warms up (MSER)",
        };
        Self {
            name: TRACKING_ERROR.to_owned(),
            is_tracking_error: true,
            unit: "m".to_owned(),
            compare: Compare::Ks,
            origin: format!(
                "Metric: {}{error} over each period, in metres, {discarded}{cut}.",
                settings.metric.formula()
            ),
            equivalence_margin: settings.equivalence_margin.map(Length::metres),
            margin_setting: "`report.equivalence_margin`",
            axis_name: format!("error of a period, {}", settings.metric.formula()),
            shown: ("mm".to_owned(), 1e3),
        }
    }

    /// A metric of a user's experiment.
    #[must_use]
    pub fn of(metric: &Metric) -> Self {
        let column = metric.column.as_ref();
        let column = column.map_or_else(String::new, |column| format!("column `{column}` of "));
        let unit = match metric.unit.as_str() {
            "" => String::new(),
            unit => format!(", in {unit}"),
        };
        Self {
            name: metric.name.clone(),
            is_tracking_error: false,
            unit: metric.unit.clone(),
            compare: metric.compare,
            origin: format!("Metric: {}, {column}`{}`{unit}.", metric.name, metric.from),
            equivalence_margin: metric.equivalence_margin,
            margin_setting: "`equivalence_margin` of the metric",
            axis_name: metric.name.clone(),
            shown: (metric.unit.clone(), 1.0),
        }
    }

    /// Whether an experiment has exactly this metric.
    #[must_use]
    pub fn is_of(&self, settings: &Settings) -> bool {
        let Some(experiment) = &settings.experiment else {
            return self.is_tracking_error;
        };
        let same = |metric: &Metric| {
            metric.name == self.name && metric.unit == self.unit && metric.compare == self.compare
        };
        !self.is_tracking_error && experiment.metrics.iter().any(same)
    }

    /// Those of some scenarios' settings, each once, in the order of the first that has them; never none.
    #[must_use]
    pub fn all<'a>(scenarios: impl IntoIterator<Item = &'a Settings>, report: &ReportSettings) -> Vec<Self> {
        let mut found: Vec<Self> = Vec::new();
        for settings in scenarios {
            let of_it = match &settings.experiment {
                None => vec![Self::tracking_error(report)],
                Some(experiment) => experiment.metrics.iter().map(Self::of).collect(),
            };
            for quantity in of_it {
                if found.iter().all(|other| other.name != quantity.name) {
                    found.push(quantity);
                }
            }
        }
        if found.is_empty() {
            found.push(Self::tracking_error(report));
        }
        found
    }

    /// Those of a run.
    #[must_use]
    pub fn of_run(run: &Run, report: &ReportSettings) -> Vec<Self> {
        let scenarios = run.scenarios.iter();
        Self::all(scenarios.map(|scenario| &scenario.planned.settings), report)
    }

    /// The one that a report is of first: the first whose distributions are compared, or the first at all.
    #[must_use]
    pub fn main(all: &[Self], report: &ReportSettings) -> Self {
        let compared = all.iter().find(|it| it.compare == Compare::Ks);
        let main = compared.or(all.first()).cloned();
        main.unwrap_or_else(|| Self::tracking_error(report))
    }

    /// The one that a run's report is of first.
    #[must_use]
    pub fn main_of_run(run: &Run, report: &ReportSettings) -> Self {
        Self::main(&Self::of_run(run, report), report)
    }

    /// A value in the unit that tables show.
    #[must_use]
    pub fn shown(&self, value: f64) -> f64 {
        value * self.shown.1
    }

    /// What an axis with its values is called, in the unit of files.
    #[must_use]
    pub fn axis(&self) -> String {
        self.with_file_unit(&self.axis_name)
    }

    /// A name of its values with the unit of files.
    #[must_use]
    pub fn with_file_unit(&self, name: &str) -> String {
        match self.unit.as_str() {
            "" => name.to_owned(),
            unit => format!("{name} ({unit})"),
        }
    }

    /// Its values, in a sentence.
    #[must_use]
    pub fn values_name(&self) -> String {
        match self.is_tracking_error {
            true => "errors".to_owned(),
            false => format!("values of {}", self.name),
        }
    }

    /// What one value is of, and several.
    #[must_use]
    pub const fn value_nouns(&self) -> [&'static str; 2] {
        match self.is_tracking_error {
            true => ["period", "periods"],
            false => ["value", "values"],
        }
    }

    /// What is shown of it, with the unit, such as `shift (mm)`.
    #[must_use]
    pub fn heading(&self, what: &str) -> String {
        match self.shown.0.as_str() {
            "" => what.to_owned(),
            unit => format!("{what} ({unit})"),
        }
    }

    /// A value with its sign, as a table has it: about three digits.
    #[must_use]
    pub fn signed(&self, value: f64) -> String {
        let digits = self.digits(value);
        match digits.starts_with('-') {
            true => digits,
            false => format!("+{digits}"),
        }
    }

    /// A value, as a table has it: about three digits, and no more than a cell takes.
    #[must_use]
    pub fn digits(&self, value: f64) -> String {
        let value = self.shown(value);
        match value.abs() {
            large if large >= 99_999.5 => format!("{value:.2e}"),
            large if large >= 99.95 => format!("{value:.0}"),
            middle if middle >= 9.995 => format!("{value:.1}"),
            small if small > 0.0 && small < 0.005 => format!("{value:.1e}"),
            _ => format!("{value:.2}"),
        }
    }

    /// A standard deviation, as a table has it.
    #[must_use]
    pub fn magnitude(&self, deviation: f64) -> String {
        let shown = self.shown(deviation);
        match shown.abs() {
            small if small > 0.0 && small < 0.000_5 => format!("{shown:.1e}"),
            large if large >= 99_999.5 => format!("{shown:.2e}"),
            _ => format!("{shown:.3}"),
        }
    }

    /// The same with its unit.
    #[must_use]
    pub fn magnitude_text(&self, deviation: f64) -> String {
        self.with_unit(self.magnitude(deviation))
    }

    /// So many of its values, in words.
    #[must_use]
    pub fn count(&self, values: impl std::fmt::Display) -> String {
        let [one, many] = self.value_nouns();
        let values = values.to_string();
        match values.as_str() {
            "1" => format!("1 {one}"),
            _ => format!("{values} {many}"),
        }
    }

    /// A value with its unit, as a sentence has it.
    #[must_use]
    pub fn text(&self, value: f64) -> String {
        self.with_unit(self.digits(value))
    }

    /// The same with its sign.
    #[must_use]
    pub fn signed_text(&self, value: f64) -> String {
        self.with_unit(self.signed(value))
    }

    /// The equivalence margin with its unit, as it was written.
    #[must_use]
    pub fn margin(&self) -> Option<String> {
        let margin = self.equivalence_margin?;
        // In millimetres no margin has more digits than this, and 0.3 has no more than one.
        let written = (self.shown(margin) * 1e9).round() / 1e9;
        Some(self.with_unit(written.to_string()))
    }

    /// A number that is in the shown unit already, with that unit.
    fn with_unit(&self, number: String) -> String {
        match self.shown.0.as_str() {
            "" => number,
            unit => format!("{number} {unit}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    fn error() -> Quantity {
        Quantity::tracking_error(&ReportSettings {
            equivalence_margin: Some(Length::from_millimetres(0.3)),
            ..ReportSettings::default()
        })
    }

    fn step_time() -> Quantity {
        let metric = r#"{"name": "step_time", "unit": "ms", "from": "errors.csv", "column": "step_ms"}"#;
        Quantity::of(&serde_json::from_str(metric).unwrap())
    }

    #[rstest]
    #[case(-0.1234, "-123")]
    #[case(0.012_34, "+12.3")]
    #[case(-0.000_004, "-4.0e-3")]
    #[case(0.009_999, "+10.0")]
    #[case(0.0, "+0.00")]
    #[case(123.4, "+1.23e5")]
    fn a_shift_has_a_sign_and_about_three_digits(#[case] value: f64, #[case] cell: &str) {
        assert_eq!(error().signed(value), cell);
    }

    #[test]
    fn a_metric_of_the_users_has_its_own_unit_and_the_error_is_shown_in_millimetres() {
        assert_eq!(
            (error().heading("shift"), error().text(0.25)),
            ("shift (mm)".to_owned(), "250 mm".to_owned())
        );
        assert_eq!(error().margin().as_deref(), Some("0.3 mm"));
        assert_eq!(step_time().heading("shift"), "shift (ms)");
        assert_eq!(step_time().text(1.5), "1.50 ms");
        assert_eq!(
            step_time().origin,
            "Metric: step_time, column `step_ms` of `errors.csv`, in ms."
        );
        let bare = Quantity {
            shown: (String::new(), 1.0),
            ..step_time()
        };
        assert_eq!(
            (bare.heading("shift"), bare.text(1.5)),
            ("shift".to_owned(), "1.50".to_owned())
        );
    }
}
