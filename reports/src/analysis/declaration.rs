//! Whether a report is made by other settings than its run declared before anything was measured. The function is [`remark`].

use record::report_settings::ReportSettings;
use serde_json::{Value, json};

use crate::analysis::fields;

/// That the settings are not those that were declared, each with both values; none if they are the same.
pub(crate) fn remark(declared: &ReportSettings, used: &ReportSettings) -> Option<String> {
    // What is written only where it is used is left out of one of them and is its default there.
    let differing = fields::differing(&values(declared), &values(used));
    let differing: Vec<String> = differing
        .into_iter()
        .map(|(field, declared, used)| {
            format!(
                "{field} (`{}`, declared was `{}`)",
                spelt(&used),
                spelt(&declared)
            )
        })
        .collect();
    (!differing.is_empty()).then(|| {
        format!(
            "DIFFERS FROM WHAT WAS DECLARED: {}. What is chosen when the data is known is no test of what was declared before.",
            differing.join(", ")
        )
    })
}

fn values(settings: &ReportSettings) -> Value {
    let mut values = json!({
        "error": settings.error,
        "warm_up": settings.warm_up,
        "figures": settings.figures,
        "family": settings.family,
        "equivalence_margin": settings.equivalence_margin,
        "seed": settings.seed,
    });
    if let (Some(values), Ok(Value::Object(written))) =
        (values.as_object_mut(), serde_json::to_value(settings))
    {
        values.extend(written);
    }
    // One setting, whatever axes it names.
    values["baseline"] = Value::String(spelt(&json!(settings.baseline)));
    values
}

/// As a matrix file has it.
fn spelt(value: &Value) -> String {
    match value {
        Value::Null => "nothing".to_owned(),
        Value::String(text) => text.clone(),
        Value::Array(items) => format!("[{}]", items.iter().map(spelt).collect::<Vec<_>>().join(", ")),
        Value::Object(entries) => {
            let entries: Vec<String> = entries
                .iter()
                .map(|(key, value)| format!("{key}: {}", spelt(value)))
                .collect();
            format!("{{{}}}", entries.join(", "))
        }
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use record::{
        family::Family,
        report_settings::{DrawnPair, Metric},
    };

    use super::*;

    #[test]
    fn each_setting_that_is_not_the_declared_one_is_named_with_both_values() {
        let declared = ReportSettings::default();
        assert_eq!(remark(&declared, &declared), None);
        let used = ReportSettings {
            alpha: 0.2,
            metric: Metric::MeanAbsX,
            baseline: [("os".to_owned(), "debian".to_owned())].into(),
            figures: vec![DrawnPair("b/2".parse().unwrap(), "h".parse().unwrap())],
            family: Family::AgainstBaseline,
            ..declared.clone()
        };
        let said = remark(&declared, &used).unwrap();
        assert!(
            said.starts_with(
                "DIFFERS FROM WHAT WAS DECLARED: alpha (`0.2`, declared was `0.001`), baseline (`{os: debian}`, declared was \
                 `{virtualization: native}`), family (`against-baseline`, declared was `all`), figures (`[[b/2, h]]`, declared was \
                 `[]`), metric (`mean-abs-x`, declared was `mean-abs-sum`)."
            ),
            "{said}"
        );
    }
}
