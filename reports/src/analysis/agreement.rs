//! Metrics that are compared byte for byte: which scenarios have the same in windows of the same number, as groups, and where the
//! others part from them. The main type is [`Agreement`].

use std::collections::BTreeMap;

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
    /// The numbers of the windows that count in every scenario with data: those that are compared.
    pub windows: Vec<u32>,
    /// Scenarios that have the same in all these windows, by letter; the first group has the first scenario.
    pub groups: Vec<Group>,
    /// The scenarios without a window that counts.
    pub without_data: Vec<String>,
}

/// Scenarios that agree with each other.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Group {
    /// Their letters.
    pub scenarios: Vec<String>,
    /// In how many of the windows they have the same as the first group.
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
        let scenarios = run
            .scenarios
            .iter()
            .map(|scenario| (scenario, files(scenario, metric)));
        let (with, without): (Vec<_>, Vec<_>) = scenarios.partition(|(_, files)| !files.is_empty());
        let (_, first) = with.first().cloned().unzip();
        let first: Files<'_> = first.unwrap_or_default();
        let in_all = |window: &u32| with.iter().all(|(_, files)| files.contains_key(window));
        let windows: Vec<u32> = first.keys().copied().filter(in_all).collect();
        let mut groups: Vec<(Vec<&str>, Group)> = Vec::new();
        for (scenario, files) in &with {
            let contents: Vec<&FileContent> = windows
                .iter()
                .filter_map(|window| files.get(window).copied())
                .collect();
            let sums: Vec<&str> = contents.iter().map(|content| content.sha256.as_str()).collect();
            let letter = scenario.planned.id.clone();
            if let Some((_, group)) = groups.iter_mut().find(|(known, _)| *known == sums) {
                group.scenarios.push(letter);
                continue;
            }
            let beside_first = windows
                .iter()
                .filter_map(|window| Some((*window, *first.get(window)?)));
            let beside_first: Vec<_> = beside_first.zip(contents).collect();
            let is_same = |a: &FileContent, b: &FileContent| a.sha256 == b.sha256;
            let same_as_first = beside_first.iter().filter(|((_, a), b)| is_same(a, b)).count();
            let parts = beside_first
                .iter()
                .find(|((_, a), b)| !is_same(a, b))
                .map(|((window, a), b)| Parting::of(*window, a, b));
            let group = Group {
                scenarios: vec![letter],
                same_as_first,
                parts,
            };
            groups.push((sums, group));
        }
        Self {
            metric: metric.to_owned(),
            windows,
            groups: groups.into_iter().map(|(_, group)| group).collect(),
            without_data: without
                .iter()
                .map(|(scenario, _)| scenario.planned.id.clone())
                .collect(),
        }
    }
}

fn files<'a>(scenario: &'a ScenarioRun, metric: &str) -> Files<'a> {
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
}
