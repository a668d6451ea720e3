//! The records of a run, changed as a host that lies would: whole JSON, with other values in some places.
//!
//! The bytes name places and values, four a change: which file, which of its values (two bytes), and what it becomes, from
//! [`EDGES`]. Arithmetic that overflows is behind parsers that refuse nearly all that a fuzzer of bytes makes of them.

use std::cell::RefCell;

use serde_json::{Value, json};

use crate::recorded::{self, Recorded};

/// What a value becomes.
const EDGES: [fn(&Value) -> Value; 24] = [
    |_| Value::Null,
    |_| json!(0),
    |_| json!(-1),
    |_| json!(1),
    |_| json!(u64::MAX),
    |_| json!(u64::MAX - 1),
    |_| json!(i64::MAX),
    |_| json!(i64::MIN),
    |_| json!(u32::MAX),
    |_| json!(1_u64 << 32),
    |_| json!(1_u64 << 53),
    |_| json!(f64::MAX),
    |_| json!(f64::MIN_POSITIVE),
    |_| json!(-0.0),
    |_| json!(1e-9),
    |_| json!(true),
    |_| json!(""),
    |_| json!(".."),
    |_| json!("a/../../b"),
    |_| json!("\u{1b}]0;a\u{7}\u{202e}<b>&|=$(c)"),
    |_| json!("9".repeat(4000)),
    |_| json!([]),
    |_| json!({}),
    // Twice as much of it.
    |value| match value {
        Value::Array(values) => values.iter().chain(values).cloned().collect(),
        Value::Number(number) => number.as_f64().map_or(Value::Null, |number| json!(number * 2.0)),
        other => json!([other, other]),
    },
];

thread_local! {
    /// Copied once: each input changes some files and puts them back.
    static RUN: RefCell<Option<Recorded>> = const { RefCell::new(None) };
}

/// Changes what the bytes say and has the run loaded, analysed and written.
pub fn changed(bytes: &[u8]) {
    RUN.with_borrow_mut(|run| {
        let run = run.get_or_insert_with(Recorded::copy);
        for change in bytes.chunks_exact(4).take(8) {
            let [file, high, low, edge] = change else {
                continue;
            };
            run.change(usize::from(*file), |document| {
                let which = usize::from(u16::from_be_bytes([*high, *low]));
                let places = count(document);
                if let Some(place) = nth(document, &mut (which % places)) {
                    *place = EDGES[usize::from(*edge) % EDGES.len()](place);
                }
            });
        }
        run.use_it();
        run.put_back();
    });
}

/// How many values a document has, itself among them.
fn count(value: &Value) -> usize {
    1 + match value {
        Value::Array(values) => values.iter().map(count).sum(),
        Value::Object(fields) => fields.values().map(count).sum::<usize>(),
        _ => 0,
    }
}

/// The one with that number; `left` are those before it.
fn nth<'a>(value: &'a mut Value, left: &mut usize) -> Option<&'a mut Value> {
    if *left == 0 {
        return Some(value);
    }
    *left -= 1;
    match value {
        Value::Array(values) => values.iter_mut().find_map(|value| nth(value, left)),
        Value::Object(fields) => fields.values_mut().find_map(|value| nth(value, left)),
        _ => None,
    }
}

/// Some values of each record as the largest number, and some of each edge. Each has a whole run reported: a fuzzer first reads
/// all of them.
pub fn changes() -> Vec<Vec<u8>> {
    let files = u8::try_from(recorded::RECORDS.len()).unwrap_or(u8::MAX);
    let edges = u8::try_from(EDGES.len()).unwrap_or(u8::MAX);
    let largest = (0..files).flat_map(|file| (0..120).step_by(11).map(move |place| vec![file, 0, place, 4]));
    let edge = (0..edges).map(|edge| {
        (0..8)
            .flat_map(|n| [n % files, 0, n.wrapping_mul(31), edge])
            .collect()
    });
    largest.chain(edge).collect()
}
