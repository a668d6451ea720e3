//! What the scenarios of a report have in common and what tells them from each other, by their axes. The main type is [`Axes`].

use record::axis::{HARDWARE, OS, VIRTUALIZATION};

use crate::analysis::scenario::ScenarioReport;

/// The axes of some scenarios.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Axes {
    /// Those with the same value in all scenarios, with that value.
    pub(crate) common: Vec<(String, String)>,
    /// The others, in the order of the matrix file.
    pub(crate) varying: Vec<String>,
}

impl Axes {
    pub(crate) fn of(scenarios: &[ScenarioReport]) -> Self {
        let mut names: Vec<&String> = Vec::new();
        for name in scenarios.iter().flat_map(|scenario| scenario.axes.keys()) {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        let (mut common, mut varying) = (Vec::new(), Vec::new());
        for name in names {
            let mut values = scenarios.iter().map(|scenario| scenario.axis(name));
            let first = values.next().flatten();
            match first {
                Some(value) if values.all(|other| other.as_ref() == Some(&value)) => {
                    common.push((name.clone(), value));
                }
                _ => varying.push(name.clone()),
            }
        }
        Self { common, varying }
    }

    /// As if scenarios did not differ in these.
    pub(crate) fn without(&self, axes: &[&str]) -> Self {
        let others = self.varying.iter().filter(|axis| !axes.contains(&axis.as_str()));
        Self {
            common: self.common.clone(),
            varying: others.cloned().collect(),
        }
    }

    /// What tells a scenario from the others, such as `docker, delay 10ms`; empty where nothing does.
    pub(crate) fn name(&self, scenario: &ScenarioReport) -> String {
        let values = self.varying.iter().filter_map(|axis| {
            let value = scenario.axis(axis)?;
            Some(self.described(axis, &value))
        });
        values.collect::<Vec<_>>().join(", ")
    }

    /// The same, or the scenario's slug where nothing tells it from the others.
    pub(crate) fn label(&self, scenario: &ScenarioReport) -> String {
        match self.name(scenario) {
            nothing if nothing.is_empty() => scenario.slug.clone(),
            name => name,
        }
    }

    /// A value with the axis before it, but for those whose values say what they are of.
    pub(crate) fn described(&self, axis: &str, value: &str) -> String {
        match [HARDWARE, OS, VIRTUALIZATION].contains(&axis) {
            true => value.to_owned(),
            false => format!("{} {value}", self.heading(axis)),
        }
    }

    /// An axis's name in a heading: the last part of it, if no other axis ends in that.
    pub(crate) fn heading<'a>(&self, axis: &'a str) -> &'a str {
        let last = |axis: &'a str| axis.rsplit('.').next().unwrap_or(axis);
        let common = self.common.iter().map(|(name, _)| name);
        let mut others = self.varying.iter().chain(common).filter(|other| *other != axis);
        match others.any(|other| other.rsplit('.').next() == Some(last(axis))) {
            true => axis,
            false => last(axis),
        }
    }
}
