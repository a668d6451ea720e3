//! The JSON Schema of the matrix file, for editors that complete and check while one writes.
//!
//! The sections' own types give their own parts; what is free in a matrix file, the axes, is written here.

use record::{
    experiment::CommandExperiment, report_settings::ReportSettings, settings::Settings,
    topology::LinkSettings,
};
use schemars::{generate::SchemaSettings, json_schema};
use serde_json::{Value, json};

use super::{hosts::HostEntry, sweep::setting_paths};
use crate::provider::{Catalogue, ProviderSettings};

/// The JSON Schema (draft 2020-12) of a matrix file for these providers.
#[must_use]
pub fn schema(catalogue: Catalogue) -> Value {
    let mut generator = SchemaSettings::draft2020_12().into_generator();
    let workload = generator.subschema_for::<Settings>();
    let experiment = generator.subschema_for::<CommandExperiment>();
    let report = generator.subschema_for::<ReportSettings>();
    let providers = generator.subschema_for::<ProviderSettings>();
    let host = generator.subschema_for::<HostEntry>();
    let matrix = matrix(catalogue);
    let profile = json_schema!({
        "description": "Overrides, laid over the sections of the file when the profile is chosen.",
        "type": ["object", "null"],
        "additionalProperties": false,
        "properties": {
            "matrix": matrix, "experiment": experiment, "workload": workload, "report": report, "providers": providers,
        },
    });
    let mut definitions = generator.take_definitions(true);
    let sections = definitions.get_mut("ProviderSettings");
    if let Some(Value::Object(sections)) = sections.and_then(|it| it.get_mut("properties")) {
        for kind in catalogue.outside() {
            sections.insert(kind.name.to_owned(), json!({ "type": ["object", "null"] }));
        }
    }
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Matrix file",
        "description": "One experiment in all combinations of hardware, operating system and virtualization.",
        "type": "object",
        "additionalProperties": false,
        "required": ["matrix"],
        "properties": {
            "matrix": matrix,
            "hosts": {
                "description": "The machines and what each offers; this machine when left out.",
                "type": "object",
                "minProperties": 1,
                "additionalProperties": { "anyOf": [host, { "type": "null" }] },
            },
            "experiment": {
                "description": "An experiment of your own: a command that is run for each window. The ball on the plate when left out.",
                "anyOf": [experiment, { "type": "null" }],
            },
            "workload": workload,
            "report": report,
            "providers": providers,
            "profiles": {
                "description": "Named overrides, chosen with `--profile`.",
                "type": ["object", "null"],
                "additionalProperties": profile,
            },
        },
        "$defs": definitions,
    })
}

/// The `matrix` section: axes are free keys, the known ones described.
fn matrix(catalogue: Catalogue) -> Value {
    let value = json!({ "type": ["string", "number", "boolean"] });
    let axis = json!({ "type": "array", "minItems": 1, "uniqueItems": true, "items": value });
    let virtualization = json!({ "enum": catalogue.names().collect::<Vec<_>>() });
    let pattern = json!({ "anyOf": [value, { "type": "array", "minItems": 1, "items": value }] });
    let labels = json!({
        "description": "Axes that change nothing but names.",
        "type": ["object", "null"],
        "additionalProperties": axis,
    });
    let mut properties = json!({
        "hardware": with_description(&axis, "Hardware that hosts offer; the hosts give it when left out."),
        "os": with_description(&axis, "Operating systems that hosts offer; the hosts give them when left out."),
        "virtualization": {
            "description": "What the environments are made with; `native` when left out.",
            "type": "array", "minItems": 1, "uniqueItems": true, "items": virtualization,
        },
        "labels": labels,
        "exclude": {
            "description": "Combinations that are not run: those with one of the values named for each axis. `*` and `?` stand for any.",
            "type": ["array", "null"],
            "items": {
                "type": "object",
                "minProperties": 1,
                "properties": {
                    "labels": { "type": "object", "additionalProperties": pattern },
                    "reason": { "type": "string", "description": "Why; stands in every report." },
                },
                "additionalProperties": pattern,
            },
        },
        "include": {
            "description": "Values added to the combinations they fit, or combinations of their own.",
            "type": ["array", "null"],
            "items": {
                "type": "object",
                "minProperties": 1,
                "properties": {
                    "labels": { "type": "object", "additionalProperties": value },
                    "virtualization": virtualization,
                },
                "additionalProperties": value,
            },
        },
    });
    for path in setting_paths() {
        let description = format!("Sweeps the workload's `{path}`.");
        if let Some(properties) = properties.as_object_mut() {
            properties.insert(path.clone(), with_description(&axis, &description));
        }
    }
    let parameter = with_description(&axis, "Sweeps a parameter of the experiment.");
    let link = with_description(&axis, "Sweeps what one link of the network does.");
    json!({
        "description": "Axes are lists of values; every combination is a scenario.",
        "type": ["object", "null"],
        "properties": properties,
        "patternProperties": { "^parameters\\.": parameter, (link_pattern()): link },
        "additionalProperties": false,
    })
}

/// What a setting of one link looks like, as [`LinkSettings::is_path`] has it.
fn link_pattern() -> String {
    let fields = LinkSettings::FIELDS.join("|");
    format!(r"^network\.(hosts|switches)\.[a-z][a-z0-9-]*\.({fields})$")
}

fn with_description(schema: &Value, description: &str) -> Value {
    let mut described = json!({ "description": description });
    if let (Some(described), Some(schema)) = (described.as_object_mut(), schema.as_object()) {
        described.extend(schema.clone());
    }
    described
}
