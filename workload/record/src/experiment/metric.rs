//! What a command measures: which file of a window has it, and how windows are compared in it. The main type is [`Metric`].

use serde::{Deserialize, Serialize};

use crate::{layout, name::name};

/// One metric.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Metric {
    /// Its name, in reports and in files.
    #[serde(deserialize_with = "name")]
    pub name: String,
    /// The unit of its values, such as `mm`; left out for numbers without one.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
    /// The file in `{window.folder}` that has it.
    #[serde(deserialize_with = "name")]
    pub from: String,
    /// The column with the values, in a CSV file whose first line names its columns. Left out, each line of the file is a value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub column: Option<String>,
    /// How windows are compared in it.
    #[serde(default)]
    pub compare: Compare,
    /// A shift of its mean that is smaller does not matter, in its unit; a verdict says so.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub equivalence_margin: Option<f64>,
}

/// How windows are compared in a metric.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Compare {
    /// The distributions of their values, by exact two-sample Kolmogorov-Smirnov tests.
    #[default]
    Ks,
    /// Byte for byte: windows of the same number are to be the same in every scenario.
    Identical,
}

impl Metric {
    /// A unit is no longer, in bytes.
    const LONGEST_UNIT: usize = 20;
    /// What `matrix drift` follows of every scenario beside its metrics: the time that it took to make its environment.
    pub const PROVISIONING: &str = "provisioning";
    /// A column's name is no longer, in bytes.
    const LONGEST_COLUMN: usize = 200;

    /// What does not fit together: the field, why, and what to write.
    pub(super) fn problem(&self) -> Option<(&'static str, String, &'static str)> {
        let name = &self.name;
        let has_controls = |text: &str| text.chars().any(char::is_control);
        if name == Self::PROVISIONING {
            let what = format!("`{name}` is what `matrix drift` calls the time to make an environment");
            return Some(("name", what, "give the metric another name"));
        }
        if self.compare == Compare::Identical && self.column.is_some() {
            let what = format!("`{name}` compares files byte for byte, in which a column means nothing");
            return Some(("column", what, "take `column` out, or write `compare: ks`"));
        }
        if self.compare == Compare::Identical && !self.unit.is_empty() {
            let what = format!("`{name}` compares files byte for byte, which have no unit");
            return Some(("unit", what, "take `unit` out, or write `compare: ks`"));
        }
        if self.compare == Compare::Identical && self.equivalence_margin.is_some() {
            let what = format!("`{name}` compares files byte for byte, of which nothing is immaterial");
            return Some((
                "equivalence_margin",
                what,
                "take `equivalence_margin` out, or write `compare: ks`",
            ));
        }
        if self
            .equivalence_margin
            .is_some_and(|margin| !margin.is_finite() || margin <= 0.0)
        {
            let what = format!("the equivalence margin of `{name}` is no shift");
            return Some((
                "equivalence_margin",
                what,
                "write a number above 0, in the unit of the metric",
            ));
        }
        if self.unit.len() > Self::LONGEST_UNIT || has_controls(&self.unit) {
            let what = format!("the unit of `{name}` is no unit");
            return Some(("unit", what, "write a short one, such as `mm`"));
        }
        if self.from.starts_with(layout::WINDOW) || layout::is_printed(&self.from) {
            let what = format!("`{}` is a file that `matrix` writes", self.from);
            return Some(("from", what, "let the command write to a file of another name"));
        }
        match &self.column {
            Some(column)
                if column.is_empty() || column.len() > Self::LONGEST_COLUMN || has_controls(column) =>
            {
                let what = format!("the column of `{name}` cannot be a column's name");
                Some(("column", what, "write the name as the file's first line has it"))
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    fn metric() -> Metric {
        Metric {
            name: "step_time".to_owned(),
            unit: "ms".to_owned(),
            from: "errors.csv".to_owned(),
            column: Some("step_ms".to_owned()),
            compare: Compare::Ks,
            equivalence_margin: None,
        }
    }

    #[test]
    fn a_metric_without_a_unit_or_a_column_is_one() {
        let metric: Metric = serde_json::from_str(r#"{"name": "count", "from": "count.txt"}"#).unwrap();
        assert_eq!((metric.problem(), metric.compare), (None, Compare::Ks));
    }

    #[rstest]
    #[case(Metric { compare: Compare::Identical, ..metric() }, "in which a column means nothing")]
    #[case(Metric { compare: Compare::Identical, column: None, ..metric() }, "which have no unit")]
    #[case(Metric { name: "provisioning".to_owned(), ..metric() }, "the time to make an environment")]
    #[case(Metric { equivalence_margin: Some(-1.0), ..metric() }, "is no shift")]
    #[case(
        Metric { compare: Compare::Identical, column: None, unit: String::new(), equivalence_margin: Some(1.0), ..metric() },
        "nothing is immaterial"
    )]
    #[case(Metric { unit: "furlongs per fortnight".to_owned(), ..metric() }, "is no unit")]
    #[case(Metric { unit: "\u{1b}[31m".to_owned(), ..metric() }, "is no unit")]
    #[case(Metric { from: "window.json".to_owned(), ..metric() }, "is a file that `matrix` writes")]
    #[case(Metric { column: Some(String::new()), ..metric() }, "cannot be a column's name")]
    fn what_does_not_fit_is_said(#[case] metric: Metric, #[case] words: &str) {
        let (_, what, _) = metric.problem().unwrap();
        assert!(what.contains(words), "{what}");
    }

    #[rstest]
    #[case(r#"{"name": "a", "from": "../x"}"#)]
    #[case(r#"{"name": "a", "from": "sub/x"}"#)]
    #[case(r#"{"name": "a/b", "from": "x"}"#)]
    #[case(r#"{"name": "a"}"#)]
    #[case(r#"{"name": "a", "from": "x", "compare": "same"}"#)]
    fn what_leaves_its_folder_or_is_not_known_is_no_metric(#[case] text: &str) {
        assert!(serde_json::from_str::<Metric>(text).is_err());
    }
}
