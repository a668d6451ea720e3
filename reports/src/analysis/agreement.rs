//! Metrics that are compared byte for byte: which scenarios have the same in windows of the same number, as groups, and where the
//! others part from them. The main type is [`Agreement`].

use std::collections::{BTreeMap, BTreeSet};

use record::experiment::Compare;

use crate::{
    analysis::quantity::Quantity,
    input::{
        run::{Run, ScenarioRun},
        window_data::{FileContent, MetricData},
    },
};

/// A metric that is compared byte for byte.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Agreement {
    /// Its name.
    pub metric: String,
    /// The numbers of the windows of the first scenario that are compared with those of others, or all of them if there are no others.
    pub windows: Vec<u32>,
    /// Scenarios that have the same in every window that both have, by letter; the first group has the first scenario.
    pub groups: Vec<Group>,
    /// The scenarios without a window that counts.
    pub without_data: Vec<String>,
}

/// Scenarios that agree with each other.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Group {
    /// Their letters.
    pub scenarios: Vec<String>,
    /// How many windows the first of them and the first scenario both have.
    pub compared: usize,
    /// In how many of these it has the same as the first scenario.
    pub same_as_first: usize,
    /// Where they part from the first group first; none for that group itself.
    pub parts: Option<Parting>,
}

/// The first place in which two files are not the same.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Parting {
    /// The window.
    pub window: u32,
    /// The byte, from 0; none if what is kept of both is the same.
    pub byte: Option<u64>,
    /// The line of that byte, from 1.
    pub line: u64,
    /// What the first group has there: the line's next characters.
    pub first: String,
    /// What this group has there.
    pub this: String,
}

/// A scenario's files, by window.
type Files<'a> = BTreeMap<u32, &'a FileContent>;

impl Agreement {
    /// Of each metric of a run that is compared byte for byte.
    #[must_use]
    pub fn all(run: &Run, quantities: &[Quantity]) -> Vec<Self> {
        let identical = quantities
            .iter()
            .filter(|quantity| quantity.compare == Compare::Identical);
        identical.map(|quantity| Self::of(run, &quantity.name)).collect()
    }

    fn of(run: &Run, metric: &str) -> Self {
        let scenarios = run.scenarios.iter();
        let scenarios = scenarios.map(|scenario| (scenario.planned.id.as_str(), files(scenario, metric)));
        Self::among(metric, scenarios)
    }

    /// Of scenarios, by letter, with their files.
    fn among<'a>(metric: &str, scenarios: impl Iterator<Item = (&'a str, Files<'a>)>) -> Self {
        let (with, without): (Vec<_>, Vec<_>) = scenarios.partition(|(_, files)| !files.is_empty());
        let (_, first) = with.first().cloned().unzip();
        let first: Files<'_> = first.unwrap_or_default();
        let is_same = |a: &FileContent, b: &FileContent| a.sha256 == b.sha256;
        let mut compared = BTreeSet::new();
        let mut groups: Vec<(&Files<'_>, Group)> = Vec::new();
        for (position, (letter, files)) in with.iter().enumerate() {
            let letter = (*letter).to_owned();
            let beside_first = common(&first, files);
            if position > 0 {
                compared.extend(beside_first.iter().map(|(window, ..)| *window));
            }
            // A scenario whose windows are none of another's is not said to agree with it.
            let agrees = |known: &Files<'_>| {
                let both = common(known, files);
                !both.is_empty() && both.iter().all(|(_, a, b)| is_same(a, b))
            };
            if let Some((_, group)) = groups.iter_mut().find(|(known, _)| agrees(known)) {
                group.scenarios.push(letter);
                continue;
            }
            let parts = beside_first.iter().find(|(_, a, b)| !is_same(a, b));
            let group = Group {
                scenarios: vec![letter],
                compared: beside_first.len(),
                same_as_first: beside_first.iter().filter(|(_, a, b)| is_same(a, b)).count(),
                parts: parts.map(|(window, a, b)| Parting::of(*window, a, b)),
            };
            groups.push((files, group));
        }
        let windows: Vec<u32> = match with.len() {
            0 | 1 => first.keys().copied().collect(),
            _ => compared.into_iter().collect(),
        };
        Self {
            metric: metric.to_owned(),
            windows,
            groups: groups.into_iter().map(|(_, group)| group).collect(),
            without_data: without.iter().map(|(letter, _)| (*letter).to_owned()).collect(),
        }
    }
}

/// The windows that both have, with what each has in them.
fn common<'a>(a: &Files<'a>, b: &Files<'a>) -> Vec<(u32, &'a FileContent, &'a FileContent)> {
    let both = a
        .iter()
        .filter_map(|(window, of_a)| Some((*window, *of_a, *b.get(window)?)));
    both.collect()
}

pub(crate) fn files<'a>(scenario: &'a ScenarioRun, metric: &str) -> Files<'a> {
    let of_window = scenario
        .counted()
        .filter_map(|(window, _, data)| match data.metric(metric) {
            Some(MetricData::Bytes(content)) => Some((window, content)),
            _ => None,
        });
    of_window.collect()
}

impl Parting {
    fn of(window: u32, a: &FileContent, b: &FileContent) -> Self {
        let (first, this) = (a.beginning.as_slice(), b.beginning.as_slice());
        let shorter = first.len().min(this.len());
        let differ = first.iter().zip(this).position(|(a, b)| a != b);
        // One may be the beginning of the other.
        let at = differ.or_else(|| (first.len() != this.len()).then_some(shorter));
        let before = first.get(..at.unwrap_or(shorter)).unwrap_or_default();
        // What is shown begins with its line, since a digit alone says little.
        let line_begins = before
            .iter()
            .rposition(|byte| *byte == b'\n')
            .map_or(0, |at| at + 1);
        let from = line_begins.max(before.len().saturating_sub(20));
        Self {
            window,
            byte: at.map(|at| at as u64),
            line: 1 + before.iter().filter(|byte| **byte == b'\n').count() as u64,
            first: shown(first, from),
            this: shown(this, from),
        }
    }
}

/// Some characters from there to the line's end, without what a terminal would obey.
fn shown(content: &[u8], from: usize) -> String {
    const MOST: usize = 40;
    let rest = content.get(from..).unwrap_or_default();
    let line = rest.split(|byte| *byte == b'\n').next().unwrap_or_default();
    let line = line.get(..MOST).unwrap_or(line);
    let text = String::from_utf8_lossy(line);
    text.chars().flat_map(char::escape_debug).collect()
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    fn content(bytes: &[u8]) -> FileContent {
        FileContent {
            sha256: format!("{bytes:?}"),
            bytes: bytes.len() as u64,
            beginning: bytes.to_vec(),
        }
    }

    #[rstest]
    #[case(b"x 1.00\ny 2.25\n", b"x 1.00\ny 2.50\n", Some(11), 2, "y 2.25", "y 2.50")]
    #[case(b"1\n2\n", b"1\n2\n3\n", Some(4), 3, "", "3")]
    #[case(b"", b"1", Some(0), 1, "", "1")]
    #[case(b"\xff\x00", b"\xff\x1b", Some(1), 1, "\u{fffd}\\0", "\u{fffd}\\u{1b}")]
    fn two_files_part_at_a_byte_and_a_line(
        #[case] a: &[u8],
        #[case] b: &[u8],
        #[case] byte: Option<u64>,
        #[case] line: u64,
        #[case] first: &str,
        #[case] this: &str,
    ) {
        let found = Parting::of(3, &content(a), &content(b));
        assert_eq!((found.byte, found.line), (byte, line));
        assert_eq!((found.first.as_str(), found.this.as_str()), (first, this));
    }

    #[test]
    fn of_what_is_the_same_as_far_as_it_is_kept_no_byte_is_named() {
        let mut longer = content(b"same");
        longer.bytes = 5 << 20;
        assert_eq!(Parting::of(1, &content(b"same"), &longer).byte, None);
    }

    /// A scenario, and what it has in windows of these numbers.
    type Has<'a> = (&'a str, &'a [(u32, &'a [u8])]);

    fn among(scenarios: &[Has<'_>]) -> Vec<(Vec<String>, usize, usize)> {
        let kept: Vec<_> = scenarios
            .iter()
            .map(|(letter, windows)| {
                (
                    *letter,
                    windows
                        .iter()
                        .map(|(window, bytes)| (*window, content(bytes)))
                        .collect::<Vec<_>>(),
                )
            })
            .collect();
        let files = kept.iter().map(|(letter, windows)| {
            let files: Files<'_> = windows
                .iter()
                .map(|(window, content)| (*window, content))
                .collect();
            (*letter, files)
        });
        let agreement = Agreement::among("state", files);
        let group = |group: &Group| (group.scenarios.clone(), group.compared, group.same_as_first);
        agreement.groups.iter().map(group).collect()
    }

    #[test]
    fn a_window_that_one_scenario_lacks_hides_no_difference_between_two_others() {
        let groups = among(&[
            ("a", &[(1, b"x"), (2, b"y")]),
            ("b", &[(1, b"x"), (2, b"z")]),
            ("c", &[(1, b"x")]),
        ]);
        assert_eq!(
            groups,
            [(vec!["a".into(), "c".into()], 2, 2), (vec!["b".into()], 2, 1)]
        );
    }

    #[test]
    fn scenarios_without_a_window_in_common_are_not_said_to_agree() {
        let groups = among(&[("a", &[(1, b"x")]), ("b", &[(2, b"x")])]);
        assert_eq!(groups, [(vec!["a".into()], 1, 1), (vec!["b".into()], 0, 0)]);
    }
}
