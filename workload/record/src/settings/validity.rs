//! From where on a window is suspect or invalid: the `validity:` section of the settings. One table has the rules, a row each;
//! [`ValiditySettings`] and what [`judge`] finds follow from it. docs/validity.md says where the defaults come from.

mod limits;
mod verdict;

use serde::{Deserialize, Serialize};

use self::verdict::Findings;
pub use self::{
    limits::{Limit, Limits},
    verdict::{Expectation, judge},
};
use crate::{
    quantity::{Bytes, Fraction, TimeSpan},
    window::{CaptureRecord, ConditionsRecord, LoopRecord, WindowRecord},
};

/// Makes [`ValiditySettings`] of the rows. Each group is a method that looks for findings in what its parameters name, and a
/// constant with the names of its rules; a row in it is a rule:
///
/// ```text
/// /// What is limited: the text in the schema.
/// setting: Unit {
///     limits: those that hold when nothing is written,
///     in_unit_of_measured: the limit in the unit of `measured`, if that is another one,
///     measured: none where the platform hides it,
///     finding: the sentence without its stop, from what was measured in words,
/// }
/// ```
///
/// Rows are in the order of the settings, and of the reasons in `window.json`, where those of the verdict come first.
macro_rules! rules {
    ($(
        $(#[$about:meta])*
        $group:ident($($parameter:ident: $kind:ty),+) named $names:ident {
            $(
                $(#[$comment:meta])*
                $rule:ident: $unit:ident {
                    limits: $limits:expr,
                    $(in_unit_of_measured: $convert:expr,)?
                    measured: $measured:expr,
                    finding: $finding:expr,
                }
            )+
        }
    )+) => {
        /// What each rule allows. A window above a `suspect` limit counts and is marked, one above an `invalid` limit is kept
        /// and never counts. What is missing from a window makes it invalid whatever is written here.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
        #[serde(deny_unknown_fields, default)]
        pub struct ValiditySettings {
            $($($(#[$comment])* pub $rule: Limits<$unit>,)+)+
        }

        impl Default for ValiditySettings {
            fn default() -> Self {
                Self { $($($rule: $limits,)+)+ }
            }
        }

        impl ValiditySettings {
            $(
                $(#[$about])*
                ///
                /// The rules of it, by their names in the settings.
                pub const $names: &[&str] = &[$(stringify!($rule)),+];
            )+

            /// The rules whose `invalid` limit lies below their `suspect` limit, by the dotted path of the former.
            #[must_use]
            pub fn crossed(&self) -> Vec<&'static str> {
                let rules = [$($(
                    (concat!("validity.", stringify!($rule), ".invalid"), self.$rule.are_crossed()),
                )+)+];
                rules
                    .into_iter()
                    .filter_map(|(path, crossed)| crossed.then_some(path))
                    .collect()
            }

            $(
                $(#[$about])*
                fn $group(&self, findings: &mut Findings, $($parameter: $kind),+) {
                    $(findings.rule(self.$rule$(.map($convert))?, $measured, $finding);)+
                }
            )+
        }
    };
}

rules! {
    /// How one of the two loops held its schedule.
    timing(who: &str, done: &LoopRecord, step_ns: i64) named TIMING {
        /// Share of a loop's steps that began a whole step late or more.
        missed_deadlines: Fraction {
            limits: Limits::both(percent(0.1), percent(5.0)),
            measured: Some(share(done.missed_deadlines, done.steps)),
            finding: |missed| format!("The {who} missed {missed} of its deadlines"),
        }

        /// How late 99 % of a loop's steps began at most, as a share of a step.
        lateness: Fraction {
            limits: Limits::suspect(percent(10.0)),
            in_unit_of_measured: |share| span((share.probability() * step_ns as f64).round() as u64),
            measured: Some(span(nanoseconds(done.lateness_p99_ns))),
            finding: |lateness| format!("1 % of the {who}'s steps began more than {lateness} late"),
        }
    }

    /// What concerns the window as a whole.
    whole(record: &WindowRecord, step_ns: i64) named WHOLE {
        /// The longest time without a control step, in steps.
        gap_steps: u32 {
            limits: Limits::both(5, 50),
            in_unit_of_measured: |steps| span(nanoseconds(step_ns) * u64::from(steps)),
            measured: record.loops().map(|loops| span(nanoseconds(loops.longest_gap_ns))),
            finding: |gap| format!("For {gap} no control step was done"),
        }

        /// How late the emulator let 99 % of the packets go at most.
        release_lateness: TimeSpan {
            limits: Limits::both(TimeSpan::from_millis(1), TimeSpan::from_millis(10)),
            measured: record.releases.map(|releases| span(releases.lateness_p99_ns)),
            finding: |lateness| format!("The network let 1 % of the packets go more than {lateness} late"),
        }

        /// By how much the wall clock was set, either way.
        clock_step: TimeSpan {
            limits: Limits::suspect(TimeSpan::from_millis(1)),
            measured: Some(span(record.clock_jump_ns.unsigned_abs())),
            finding: |step| {
                let way = if record.clock_jump_ns < 0 { "back" } else { "forward" };
                format!("The wall clock was set {way} by {step}")
            },
        }
    }

    /// What one of the captures lacks.
    capture(capture: &CaptureRecord) named CAPTURE {
        /// Share of a capture's packets that the kernel dropped.
        capture_dropped: Fraction {
            limits: Limits::suspect(percent(0.0)),
            measured: Some(share(capture.dropped, capture.dropped + capture.packets)),
            finding: |share| {
                let (dropped, host) = (capture.dropped, capture.host);
                format!("The kernel dropped {dropped} packets of the capture on {host}, {share}")
            },
        }
    }

    /// What else happened on the machine.
    conditions(seen: &ConditionsRecord) named CONDITIONS {
        /// Share of the processors' time that a hypervisor gave to others.
        steal: Fraction {
            limits: Limits::suspect(percent(1.0)),
            measured: seen.steal_share.map(fraction),
            finding: |stolen| format!("A hypervisor gave {stolen} of the processors' time to others"),
        }

        /// Share of the window in which a quota of the control group held the workload up.
        throttled: Fraction {
            limits: Limits::suspect(percent(0.1)),
            measured: seen.throttled_share.map(fraction),
            finding: |share| {
                format!("A quota of the control group held the workload up for {share} of the window")
            },
        }

        /// How often a processor slowed down since it was too hot.
        thermal_throttles: u64 {
            limits: Limits::suspect(0),
            measured: seen.thermal_throttles,
            finding: |times| format!("Processors slowed down {times} times since they were too hot"),
        }

        /// Share of the processors' time that others on the machine used.
        other_load: Fraction {
            limits: Limits::suspect(percent(10.0)),
            measured: seen.other_load_share.map(fraction),
            finding: |share| format!("Others on the machine used {share} of the processors' time"),
        }

        /// Share of the window in which something on the machine waited for memory.
        memory_pressure: Fraction {
            limits: Limits::suspect(percent(1.0)),
            measured: seen.memory_pressure_share.map(fraction),
            finding: |share| format!("Something on the machine waited for memory in {share} of the window"),
        }

        /// Pages of the workload that had to be read from a disk.
        major_faults: u64 {
            limits: Limits::suspect(10),
            measured: Some(seen.major_faults),
            finding: |pages| format!("{pages} pages of the workload had to be read from a disk"),
        }

        /// What the machine swapped, in and out.
        swapped: Bytes {
            limits: Limits::suspect(Bytes::new(1 << 20)),
            measured: seen.swapped_bytes.map(Bytes::new),
            finding: |size| format!("The machine swapped {size}"),
        }
    }
}

fn percent(percent: f64) -> Fraction {
    Fraction::from_percent(percent)
}

/// From a share of 1.
fn fraction(share: f64) -> Fraction {
    percent(share * 100.0)
}

fn share(part: u64, whole: u64) -> Fraction {
    percent(part as f64 / whole.max(1) as f64 * 100.0)
}

fn span(nanoseconds: u64) -> TimeSpan {
    TimeSpan::from(std::time::Duration::from_nanos(nanoseconds))
}

/// What began early was not late.
fn nanoseconds(signed: i64) -> u64 {
    u64::try_from(signed).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    #[test]
    fn a_rule_is_written_with_both_limits_and_the_others_keep_theirs() {
        let text =
            r#"{"steal": {"suspect": "3%", "invalid": "never"}, "gap_steps": {"suspect": 7, "invalid": 9}}"#;
        let settings: ValiditySettings = serde_json::from_str(text).unwrap();
        assert_eq!(settings.steal, Limits::suspect(Fraction::from_percent(3.0)));
        assert_eq!(settings.gap_steps, Limits::both(7, 9));
        assert_eq!(settings.swapped, ValiditySettings::default().swapped);
    }

    #[test]
    fn limits_read_back_as_they_were_written() {
        let settings = ValiditySettings::default();
        let text = serde_json::to_string(&settings).unwrap();
        assert!(
            text.contains(r#""clock_step":{"suspect":"1ms","invalid":"never"}"#),
            "{text}"
        );
        assert_eq!(serde_json::from_str::<ValiditySettings>(&text).unwrap(), settings);
    }

    #[rstest]
    #[case::no_unit(r#"{"clock_step": {"suspect": 5, "invalid": "never"}}"#, "has no unit")]
    #[case::one_forgotten(r#"{"steal": {"suspect": "3%"}}"#, "missing field `invalid`")]
    #[case::no_number(r#"{"gap_steps": {"suspect": "often", "invalid": "never"}}"#, "invalid type")]
    fn what_is_no_limit_is_refused_in_the_values_own_words(#[case] text: &str, #[case] words: &str) {
        let error = serde_json::from_str::<ValiditySettings>(text)
            .unwrap_err()
            .to_string();
        assert!(error.contains(words), "{error}");
    }

    #[test]
    fn limits_the_wrong_way_round_are_found() {
        assert_eq!(ValiditySettings::default().crossed(), Vec::<&str>::new());
        let settings = ValiditySettings {
            gap_steps: Limits::both(9, 7),
            ..ValiditySettings::default()
        };
        assert_eq!(settings.crossed(), ["validity.gap_steps.invalid"]);
    }

    #[test]
    fn the_docs_have_a_row_for_each_rule_with_its_limits_and_their_reason() {
        let docs = include_str!("../../../../docs/validity.md");
        let cell =
            |limit: &serde_json::Value| limit.as_str().map_or_else(|| limit.to_string(), str::to_owned);
        let defaults = serde_json::to_value(ValiditySettings::default()).unwrap();
        let rules = defaults.as_object().unwrap().iter();
        let wanted: Vec<_> = rules
            .map(|(rule, limits)| {
                [
                    format!("`{rule}`"),
                    cell(&limits["suspect"]),
                    cell(&limits["invalid"]),
                ]
            })
            .collect();
        let table = docs.lines().skip_while(|line| !line.starts_with("| rule |"));
        let rows = table.skip(2).take_while(|line| line.starts_with('|'));
        let found: Vec<_> = rows
            .map(|row| {
                let cells: Vec<_> = row.split('|').map(str::trim).collect();
                [1, 3, 4].map(|column| cells[column].to_owned())
            })
            .collect();
        assert_eq!(found, wanted);
        for [rule, ..] in wanted {
            assert!(
                docs.contains(&format!("\n**{rule}.** ")),
                "{rule}: where its limits come from"
            );
        }
    }
}
