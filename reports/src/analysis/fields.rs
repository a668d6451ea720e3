//! Two records held against each other, field by field. The functions are [`differing`] and [`leaves`].

use std::collections::BTreeSet;

use serde_json::{Map, Value};

/// The fields that are not the same of two records, by their dotted paths, with what each has; null where it has none.
pub(crate) fn differing(first: &Value, second: &Value) -> Vec<(String, Value, Value)> {
    let mut fields = Vec::new();
    note("", first, second, &mut fields);
    fields
}

fn note(path: &str, first: &Value, second: &Value, fields: &mut Vec<(String, Value, Value)>) {
    match (first, second) {
        (Value::Object(a), Value::Object(b)) => {
            let names: BTreeSet<&String> = a.keys().chain(b.keys()).collect();
            for name in names {
                let path = match path {
                    "" => name.clone(),
                    path => format!("{path}.{name}"),
                };
                let of = |map: &Map<String, Value>| map.get(name).cloned().unwrap_or_default();
                note(&path, &of(a), &of(b), fields);
            }
        }
        (a, b) if a == b => {}
        (a, b) => fields.push((path.to_owned(), a.clone(), b.clone())),
    }
}

/// Each field of a record by its dotted path. One that holds others is in it too, as an empty object.
pub(crate) fn leaves(record: &Value) -> Vec<(String, Value)> {
    let mut found = Vec::new();
    collect("", record, &mut found);
    found
}

fn collect(path: &str, value: &Value, found: &mut Vec<(String, Value)>) {
    let Value::Object(fields) = value else {
        found.push((path.to_owned(), value.clone()));
        return;
    };
    found.push((path.to_owned(), Value::Object(Map::new())));
    for (name, inner) in fields {
        match path {
            "" => collect(name, inner, found),
            path => collect(&format!("{path}.{name}"), inner, found),
        }
    }
}
