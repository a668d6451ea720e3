//! `matrix schema NAME`: the JSON Schema of a file that a person writes, or of what a command prints with `--json`.

use clap::{Args, ValueEnum, builder::PossibleValue};
use record::exit::matrix::Exit;
use reports::{ReportDocument, drift::DriftDocument, messages::Messages, replay::ReplayDocument};
use schemars::{JsonSchema, generate::SchemaSettings};
use serde_json::Value;

use super::{
    calibrate::CalibrateDocument, check::CheckDocument, clean::CleanDocument, doctor::DoctorDocument,
    explain::ExplainDocument, ks::KsDocument, plan::PlanDocument, prune::PruneDocument,
    redact::RedactDocument, resume::ResumeDocument, runs::RunsDocument, status::StatusDocument,
};
use crate::{
    cli::terminal::{self, ErrorDocument},
    matrix_file,
    provider::Catalogue,
};

/// What it takes.
#[derive(Debug, Args)]
pub struct SchemaArguments {
    /// Of which file or output.
    #[arg(value_enum, value_name = "NAME", default_value = "matrix")]
    of: Schema,
}

/// A schema.
#[derive(Debug, Clone, Copy)]
struct Schema {
    name: &'static str,
    /// What it describes.
    of: &'static str,
    make: fn(Catalogue) -> Value,
}

/// All of them: first the files, then the outputs.
const SCHEMAS: &[Schema] = &[
    Schema {
        name: "matrix",
        of: "Matrix files",
        make: matrix_file::schema,
    },
    Schema {
        name: "drift",
        of: "`drift.yaml`, the changes that `matrix drift` is told of",
        make: |_| reports::drift::schema(),
    },
    Schema {
        name: "report",
        of: "`report.json`, and `--json` of `matrix report`, `matrix run` and `matrix resume`",
        make: output::<ReportDocument<'static>>,
    },
    Schema {
        name: "plan",
        of: "`matrix plan --json`, and `matrix run --dry-run --json`",
        make: output::<PlanDocument<'static>>,
    },
    Schema {
        name: "check",
        of: "`matrix check --json`",
        make: output::<CheckDocument<'static>>,
    },
    Schema {
        name: "status",
        of: "`matrix status --json`",
        make: output::<StatusDocument<'static>>,
    },
    Schema {
        name: "runs",
        of: "`matrix runs --json`",
        make: output::<RunsDocument>,
    },
    Schema {
        name: "prune",
        of: "`matrix prune --json`",
        make: output::<PruneDocument>,
    },
    Schema {
        name: "resume",
        of: "`matrix resume --dry-run --json`",
        make: output::<ResumeDocument<'static>>,
    },
    Schema {
        name: "redact",
        of: "`matrix redact --json`",
        make: output::<RedactDocument<'static>>,
    },
    Schema {
        name: "messages",
        of: "`matrix messages --json`",
        make: output::<Messages>,
    },
    Schema {
        name: "explain",
        of: "`matrix explain --json`",
        make: output::<ExplainDocument<'static>>,
    },
    Schema {
        name: "replay",
        of: "`matrix replay --json`",
        make: output::<ReplayDocument>,
    },
    Schema {
        name: "calibrate",
        of: "`matrix calibrate --json`",
        make: output::<CalibrateDocument>,
    },
    Schema {
        name: "drift-result",
        of: "`matrix drift --json`",
        make: output::<DriftDocument<'static>>,
    },
    Schema {
        name: "ks",
        of: "`matrix ks --json`",
        make: output::<KsDocument>,
    },
    Schema {
        name: "clean",
        of: "`matrix clean --json`",
        make: output::<CleanDocument<'static>>,
    },
    Schema {
        name: "doctor",
        of: "`matrix doctor --json`",
        make: output::<DoctorDocument<'static>>,
    },
    Schema {
        name: "error",
        of: "What a command with `--json` prints if it fails",
        make: output::<ErrorDocument<'static>>,
    },
];

impl ValueEnum for Schema {
    fn value_variants<'a>() -> &'a [Self] {
        SCHEMAS
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let value = PossibleValue::new(self.name).help(self.of);
        // A schema has the name of its command, and one command had another.
        Some(match self.name {
            "calibrate" => value.alias("selftest"),
            _ => value,
        })
    }
}

/// The JSON Schema (draft 2020-12) of what is written: a field that is always written is required, also where it may be null.
fn output<T: JsonSchema>(_: Catalogue) -> Value {
    let settings = SchemaSettings::draft2020_12().for_serialize();
    settings.into_generator().into_root_schema_for::<T>().to_value()
}

/// Prints a JSON Schema.
#[must_use]
pub fn execute(arguments: &SchemaArguments, catalogue: Catalogue) -> Exit {
    terminal::json(&(arguments.of.make)(catalogue));
    Exit::Done
}
