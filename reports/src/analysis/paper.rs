//! What the paper printed (S. L. Remy, *Assessing virtualization effects in simulations of distributed robotics*, 2017): its nine
//! scenarios and the counts of its Tables III to V, for a run that has the same scenarios.

use polars::{df, error::PolarsResult, frame::DataFrame};

use crate::analysis::scenario::ScenarioReport;

/// The scenarios of the paper's Table II, in its order: letter, names of the hardware, names of the operating system,
/// virtualization.
pub(crate) const SCENARIOS: [(&str, &[&str], &[&str], &str); 9] = [
    ("a", I686, UBUNTU, "docker"),
    ("b", I686, UBUNTU, "native"),
    ("c", I686, UBUNTU, "virtualbox"),
    ("d", INTEL_I7, OSX, "docker"),
    ("e", INTEL_I7, OSX, "native"),
    ("f", INTEL_I7, OSX, "virtualbox"),
    ("g", ARM64, UBUNTU, "docker"),
    ("h", ARM64, UBUNTU, "native"),
    ("i", ARM64, UBUNTU, "virtualbox"),
];
const I686: &[&str] = &["i686"];
const INTEL_I7: &[&str] = &["intel-i7", "i7"];
const ARM64: &[&str] = &["arm64", "arm64-qemu", "qemu"];
const UBUNTU: &[&str] = &["ubuntu"];
const OSX: &[&str] = &["osx"];

/// Rejections that the paper printed: of a scenario with itself (Table III, of 6), of two scenarios (Tables IV and V, of 16). In
/// Table V "Ubuntu, VirtualBox" is taken for i; see `present/table/against_controls.rs`.
const PUBLISHED: [(&str, &str, u32); 18] = [
    ("b", "b", 0),
    ("c", "c", 3),
    ("d", "d", 3),
    ("f", "f", 3),
    ("g", "g", 1),
    ("h", "h", 0),
    ("i", "i", 0),
    ("b", "h", 0),
    ("d", "f", 9),
    ("g", "i", 1),
    ("b", "f", 0),
    ("b", "i", 0),
    ("b", "d", 10),
    ("b", "g", 2),
    ("f", "h", 1),
    ("h", "i", 0),
    ("d", "h", 7),
    ("g", "h", 0),
];

/// For each scenario the letter of the paper's that has the same hardware, operating system and virtualization. None if it is
/// no scenario of the paper, or one of several that would be the same one, as in a sweep over another axis.
pub(crate) fn letters(scenarios: &[ScenarioReport]) -> Vec<Option<&'static str>> {
    let found: Vec<_> = scenarios.iter().map(letter).collect();
    let is_only = |letter: &str| found.iter().filter(|other| **other == Some(letter)).count() == 1;
    found
        .iter()
        .map(|letter| letter.filter(|letter| is_only(letter)))
        .collect()
}

/// The letters of the paper's scenarios that a run has not.
pub(crate) fn missing(scenarios: &[ScenarioReport]) -> Vec<&'static str> {
    let there = letters(scenarios);
    let all = SCENARIOS.iter().map(|(letter, ..)| *letter);
    all.filter(|letter| !there.contains(&Some(letter))).collect()
}

fn letter(scenario: &ScenarioReport) -> Option<&'static str> {
    // The paper measured nothing but the ball on the plate.
    if !scenario.experiment.is_ball() {
        return None;
    }
    let is = |axis: &str, names: &[&str]| {
        let value = scenario.axis(axis);
        value.is_some_and(|value| names.contains(&value.to_ascii_lowercase().as_str()))
    };
    let same = SCENARIOS.iter().find(|(_, hardware, os, virtualization)| {
        is("hardware", hardware)
            && is("os", os)
            && scenario.virtualization().eq_ignore_ascii_case(virtualization)
    });
    same.map(|(letter, ..)| *letter)
}

/// The counts as a frame: `a_paper`, `b_paper` and `published`.
pub(crate) fn published() -> PolarsResult<DataFrame> {
    df![
        "a_paper" => PUBLISHED.map(|(a, ..)| a),
        "b_paper" => PUBLISHED.map(|(_, b, _)| b),
        "published" => PUBLISHED.map(|(.., rejected)| rejected),
    ]
}
