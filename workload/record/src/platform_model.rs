//! What a platform does to the experiment, in figures: what a simulated scenario has in place of a machine. The main type is
//! [`PlatformModel`].
//!
//! It knows nothing of the links, which are the settings'. Without any figure it is the ideal platform: all happens when it is due.

use serde::{Deserialize, Serialize};

use crate::quantity::{Fraction, TimeSpan};

/// A platform.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct PlatformModel {
    /// Where the figures come from, for a reader.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub about: String,
    /// How late the controller's ticks begin.
    pub controller: TickLateness,
    /// How late the plant's ticks begin.
    pub plant: TickLateness,
    /// When everything on the machine stands still.
    pub stalls: StallModel,
    /// What a packet takes through both hosts' kernels and whatever carries it, beside what the links delay.
    pub stack: TimeSpan,
    /// From a segment's arrival to the program's having read it.
    pub reading: Quantiles,
}

/// How late the ticks of a loop begin.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct TickLateness {
    /// From due to begun, of all ticks.
    pub late: Quantiles,
    /// How probable it is that a tick is as late as the tick before; otherwise it does not depend on it. It is the correlation of
    /// successive ticks.
    pub persistence: Fraction,
}

/// Times at which the whole machine stands still: ticks and readings that fall due meanwhile wait for the end.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct StallModel {
    /// How many begin in an hour, each independently.
    pub per_hour: f64,
    /// How long they last.
    pub length: Quantiles,
}

/// A distribution of times, as its quantiles: pairs of a probability and the time that is not exceeded with it, from 0 to 1 and
/// ascending. Between two the distribution is uniform; two of one time are an atom, and two of one probability a gap. Without any, each
/// time is 0.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(transparent)]
pub struct Quantiles(pub Vec<Quantile>);

/// A probability, and the time that is not exceeded with it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(expecting = "a pair of a probability and a time, such as `[0.5, 60us]`")]
pub struct Quantile(pub f64, pub TimeSpan);

impl StallModel {
    /// In each part of a second one begins at most.
    pub const PARTS_OF_A_SECOND: u32 = 100;
    /// One in each part.
    pub const MOST_PER_HOUR: f64 = (3600 * Self::PARTS_OF_A_SECOND) as f64;
}

impl Quantiles {
    /// No distribution needs more to be told from another.
    const MOST: usize = 1000;
    /// No tick is later, and no stall longer: half a minute.
    const LONGEST: TimeSpan = TimeSpan::from_secs(30);

    /// Always that time.
    #[must_use]
    pub fn always(time: TimeSpan) -> Self {
        Self(vec![Quantile(0.0, time), Quantile(1.0, time)])
    }

    /// That time with a probability, otherwise 0.
    #[must_use]
    pub fn sometimes(probability: f64, time: TimeSpan) -> Self {
        let zero = TimeSpan::default();
        let points = [
            (0.0, zero),
            (1.0 - probability, zero),
            (1.0 - probability, time),
            (1.0, time),
        ];
        Self(points.map(|(p, time)| Quantile(p, time)).to_vec())
    }

    /// The time at a probability, in nanoseconds: linear between two points. At a gap it is that above.
    #[must_use]
    pub fn at_ns(&self, probability: f64) -> i64 {
        let above = self.0.partition_point(|Quantile(p, _)| *p <= probability);
        let below = above.checked_sub(1).and_then(|below| self.0.get(below));
        let ns = |time: TimeSpan| i64::try_from(time.as_nanos()).unwrap_or(i64::MAX);
        match (below, self.0.get(above)) {
            (Some(Quantile(p, time)), Some(Quantile(next_p, next))) => {
                let share = (probability - p) / (next_p - p);
                let step = ns(*next).saturating_sub(ns(*time)) as f64;
                ns(*time).saturating_add((share * step) as i64)
            }
            (Some(Quantile(_, time)), None) | (None, Some(Quantile(_, time))) => ns(*time),
            (None, None) => 0,
        }
    }

    /// What is wrong with them, and what to write.
    fn problem(&self) -> Option<(String, &'static str)> {
        let (first, last) = (self.0.first()?, self.0.last()?);
        let is_probability = |p: f64| (0.0..=1.0).contains(&p);
        if let Some(Quantile(p, _)) = self.0.iter().find(|Quantile(p, _)| !is_probability(*p)) {
            return Some((format!("{p} is no probability"), "write numbers from 0 to 1"));
        }
        if self.0.len() > Self::MOST {
            let most = Self::MOST;
            return Some((
                format!("{} quantiles are more than {most}", self.0.len()),
                "write fewer: what lies between two is taken to be uniform",
            ));
        }
        if first.0 > 0.0 || last.0 < 1.0 {
            return Some((
                format!("the quantiles reach from {} to {}", first.0, last.0),
                "begin with the shortest time at 0 and end with the longest at 1, such as `[[0, 20us], [0.5, 60us], [1, 2ms]]`",
            ));
        }
        if !self
            .0
            .is_sorted_by(|a, b| a.0 <= b.0 && a.1.as_nanos() <= b.1.as_nanos())
        {
            return Some((
                "the quantiles do not ascend".to_owned(),
                "write them in the order of their probabilities; a longer time belongs to a higher one",
            ));
        }
        if last.1.as_nanos() > Self::LONGEST.as_nanos() {
            return Some((
                format!("{} is longer than any platform takes", last.1),
                "write at most `30s`",
            ));
        }
        None
    }
}

impl PlatformModel {
    /// No packet takes longer beside the links.
    const LONGEST_STACK: TimeSpan = TimeSpan::from_secs(10);

    /// What is wrong with the figures: the path of each below this one, what, and what to write.
    #[must_use]
    pub fn problems(&self) -> Vec<(&'static str, String, &'static str)> {
        let quantiles = [
            ("controller.late", &self.controller.late),
            ("plant.late", &self.plant.late),
            ("stalls.length", &self.stalls.length),
            ("reading", &self.reading),
        ];
        let mut problems: Vec<_> = quantiles
            .into_iter()
            .filter_map(|(path, quantiles)| {
                let (what, hint) = quantiles.problem()?;
                Some((path, what, hint))
            })
            .collect();
        let per_hour = self.stalls.per_hour;
        if !(0.0..=StallModel::MOST_PER_HOUR).contains(&per_hour) {
            problems.push((
                "stalls.per_hour",
                format!("a platform does not stand still {per_hour} times an hour"),
                "write a number from 0 to 360000",
            ));
        } else if per_hour > 0.0 && self.stalls.length.0.is_empty() {
            // The other way round there are no stalls: one who sweeps their number leaves the length where it is.
            problems.push((
                "stalls.length",
                format!("{per_hour} stalls an hour have no length"),
                "add `length` beside `per_hour`, such as `length: [[0, 10ms], [1, 40ms]]`, or write `per_hour: 0` for no stalls",
            ));
        }
        if self.stack.as_nanos() > Self::LONGEST_STACK.as_nanos() {
            problems.push((
                "stack",
                format!("{} is longer than any platform takes", self.stack),
                "write at most `10s`",
            ));
        }
        problems
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    fn quantiles(text: &str) -> Quantiles {
        serde_json::from_str(text).unwrap()
    }

    #[rstest]
    #[case(r"[]", &[(0.0, 0), (0.5, 0), (1.0, 0)])]
    #[case(r#"[[0, "1us"], [0.5, "3us"], [1, "103us"]]"#, &[(0.0, 1_000), (0.25, 2_000), (0.5, 3_000), (0.75, 53_000), (1.0, 103_000)])]
    // An atom of a half at 2 µs, then a gap up to 10 µs.
    #[case(
        r#"[[0, "2us"], [0.5, "2us"], [0.5, "10us"], [1, "10us"]]"#,
        &[(0.0, 2_000), (0.499, 2_000), (0.5, 10_000), (1.0, 10_000)]
    )]
    fn a_time_is_that_of_its_probability(#[case] text: &str, #[case] times: &[(f64, i64)]) {
        let quantiles = quantiles(text);
        let found: Vec<_> = times.iter().map(|(p, _)| (*p, quantiles.at_ns(*p))).collect();
        assert_eq!(found, times);
    }

    #[test]
    fn what_happens_sometimes_has_its_share() {
        let times = Quantiles::sometimes(0.25, TimeSpan::from_millis(10));
        assert_eq!(
            [0.0, 0.7, 0.76, 1.0].map(|p| times.at_ns(p)),
            [0, 0, 10_000_000, 10_000_000]
        );
        assert_eq!(times.problem(), None);
    }

    #[test]
    fn a_platform_without_figures_is_ideal_and_in_order() {
        let model: PlatformModel = serde_json::from_str("{}").unwrap();
        assert_eq!((model.problems(), model.reading.at_ns(0.9)), (Vec::new(), 0));
    }

    #[rstest]
    #[case(r#"{"stalls": {"per_hour": 0, "length": [[0, "1ms"], [1, "1ms"]]}}"#)]
    #[case(r#"{"stalls": {"per_hour": 100, "length": [[0, "1ms"], [1, "1ms"]]}}"#)]
    fn a_length_of_stalls_may_stand_beside_any_number_of_them(#[case] text: &str) {
        let model: PlatformModel = serde_json::from_str(text).unwrap();
        assert_eq!(model.problems(), []);
    }

    #[rstest]
    #[case(
        r#"{"controller": {"late": [[0.1, "1us"], [1, "2us"]]}}"#,
        "controller.late",
        "reach from 0.1 to 1"
    )]
    #[case(
        r#"{"plant": {"late": [[0, "1us"], [0.5, "2us"]]}}"#,
        "plant.late",
        "reach from 0 to 0.5"
    )]
    #[case(r#"{"reading": [[0, "3us"], [1, "2us"]]}"#, "reading", "do not ascend")]
    #[case(
        r#"{"reading": [[0, "3us"], [1.5, "4us"]]}"#,
        "reading",
        "1.5 is no probability"
    )]
    #[case(r#"{"reading": [[0, "3us"], [1, "31s"]]}"#, "reading", "31s is longer")]
    #[case(r#"{"stalls": {"per_hour": -1}}"#, "stalls.per_hour", "-1 times an hour")]
    #[case(
        r#"{"stalls": {"per_hour": 2}}"#,
        "stalls.length",
        "2 stalls an hour have no length"
    )]
    #[case(r#"{"stack": "11s"}"#, "stack", "11s is longer")]
    fn figures_that_no_platform_has_are_told_with_their_place(
        #[case] text: &str,
        #[case] path: &str,
        #[case] words: &str,
    ) {
        let model: PlatformModel = serde_json::from_str(text).unwrap();
        let problems = model.problems();
        let [(found, what, _)] = problems.as_slice() else {
            panic!("{problems:?}");
        };
        assert_eq!(*found, path);
        assert!(what.contains(words), "{what}");
    }
}
