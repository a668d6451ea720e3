//! What explains an environment, made fit to be kept. The function is [`of`].

use serde_json::{Map, Value};

use super::Environment;

/// A version is some ten characters, a list of warnings some hundred.
const LONGEST: usize = 1000;
/// Entries of a list.
const MOST: usize = 100;

/// An environment's facts, with a bound on each: hosts and engines answer as they like.
#[must_use]
pub fn of(environment: &dyn Environment) -> Map<String, Value> {
    bounded_entries(environment.facts())
}

fn bounded_entries(entries: Map<String, Value>) -> Map<String, Value> {
    let entries = entries.into_iter().take(MOST);
    entries.map(|(name, value)| (name, bounded(value))).collect()
}

fn bounded(value: Value) -> Value {
    match value {
        Value::String(text) => Value::String(bounded_text(&text)),
        Value::Array(values) => values.into_iter().take(MOST).map(bounded).collect(),
        Value::Object(entries) => Value::Object(bounded_entries(entries)),
        plain => plain,
    }
}

fn bounded_text(text: &str) -> String {
    let in_one_line = text.chars().map(|c| if c.is_control() { ' ' } else { c });
    in_one_line.take(LONGEST).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn what_a_host_answers_is_cut_and_has_no_control_characters() {
        let answered = json!({
            "version": "1.2\u{1b}[31m\n3",
            "parts": {"driver": "x".repeat(5000)},
            "warnings": vec!["w"; 500],
            "count": 7,
        });
        let kept = bounded(answered);
        assert_eq!(kept["version"], "1.2 [31m 3");
        assert_eq!(kept["parts"]["driver"].as_str().unwrap().len(), LONGEST);
        assert_eq!(kept["warnings"].as_array().unwrap().len(), MOST);
        assert_eq!(kept["count"], 7);
    }
}
