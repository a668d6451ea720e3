//! What `matrix` prints with `--json`, held against the JSON Schema that `matrix schema NAME` prints. The main function is
//! [`assert_described`].

use serde_json::{Map, Value};

use crate::Workplace;

/// The schema of that name.
///
/// # Panics
/// When `matrix schema` does not print JSON.
#[must_use]
pub fn schema(workplace: &Workplace, name: &str) -> Value {
    let ran = workplace.run(&["schema", name]);
    serde_json::from_str(&ran.out)
        .unwrap_or_else(|error| panic!("`matrix schema {name}` prints JSON: {error}\n{ran:?}"))
}

/// Fails unless the schema of that name has every key of a document, and the document every key that the schema requires.
///
/// # Panics
/// When one of them is missing.
pub fn assert_described(workplace: &Workplace, name: &str, document: &Value) {
    let root = schema(workplace, name);
    let found = differences(&root, &root, document, "");
    assert!(found.is_empty(), "{name}: {found:#?}\n{document:#}");
}

/// Keys that are in the document and not in the schema, and those that are required and not there, each with its path.
fn differences(root: &Value, schema: &Value, value: &Value, path: &str) -> Vec<String> {
    if let Some(reference) = schema["$ref"].as_str() {
        let there = root.pointer(reference.trim_start_matches('#'));
        let there = there.unwrap_or_else(|| panic!("{reference} is in the schema"));
        return differences(root, there, value, path);
    }
    if let Some(choices) = schema["anyOf"].as_array().or(schema["oneOf"].as_array()) {
        let found = choices
            .iter()
            .map(|choice| differences(root, choice, value, path));
        return found.min_by_key(Vec::len).unwrap_or_default();
    }
    match value {
        Value::Object(fields) => in_object(root, schema, fields, path),
        Value::Array(items) => items
            .iter()
            .enumerate()
            .flat_map(|(at, item)| {
                let own = schema["prefixItems"].get(at).unwrap_or(&schema["items"]);
                differences(root, own, item, &format!("{path}[{at}]"))
            })
            .collect(),
        _ => Vec::new(),
    }
}

fn in_object(root: &Value, schema: &Value, fields: &Map<String, Value>, path: &str) -> Vec<String> {
    // What is free, such as the facts of an environment.
    if schema["type"].is_null() && schema["properties"].is_null() {
        return Vec::new();
    }
    let is_object = match &schema["type"] {
        Value::Array(kinds) => kinds.iter().any(|kind| kind == "object"),
        kind => kind.is_null() || kind == "object",
    };
    if !is_object {
        return vec![format!("{path} is not described as an object")];
    }
    let mut found = Vec::new();
    for (name, value) in fields {
        let path = format!("{path}.{name}");
        match (&schema["properties"][name], &schema["additionalProperties"]) {
            (Value::Null, Value::Null | Value::Bool(false)) => found.push(format!("{path} is not described")),
            (Value::Null, any) => found.extend(differences(root, any, value, &path)),
            (own, _) => found.extend(differences(root, own, value, &path)),
        }
    }
    let required = schema["required"].as_array().into_iter().flatten();
    let missing = required
        .filter_map(Value::as_str)
        .filter(|name| !fields.contains_key(*name));
    found.extend(missing.map(|name| format!("{path}.{name} is missing")));
    found
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_key_too_many_and_one_too_few_are_found_wherever_they_are() {
        let schema = json!({
            "type": "object",
            "properties": {
                "list": {"type": "array", "items": {"$ref": "#/$defs/One"}},
                "free": {"description": "Anything."},
                "map": {"type": "object", "additionalProperties": {"$ref": "#/$defs/One"}},
            },
            "required": ["list"],
            "$defs": {
                "One": {
                    "anyOf": [
                        {"type": "object", "properties": {"a": {"type": "number"}}, "required": ["a"]},
                        {"type": "null"},
                    ],
                },
            },
        });
        let found = |document: &Value| differences(&schema, &schema, document, "");
        let none: [&str; 0] = [];
        assert_eq!(
            found(&json!({"list": [{"a": 1}, null], "free": {"x": 1}, "map": {"y": null}})),
            none
        );
        assert_eq!(
            found(&json!({"map": {"y": {"a": 1, "b": 2}}})),
            [".map.y.b is not described", ".list is missing"]
        );
        assert_eq!(found(&json!({"list": [{}]})), [".list[0].a is missing"]);
        assert_eq!(
            found(&json!({"list": [], "map": {"y": {"a": {"b": 2}}}})),
            [".map.y.a is not described as an object"]
        );
        assert_eq!(
            found(&json!({"list": [{"a": 1}], "more": 1})),
            [".more is not described"]
        );
    }
}
