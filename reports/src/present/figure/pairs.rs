//! Which pairs of windows are drawn. The main function is [`chosen`].
//!
//! Two scenarios have many pairs of windows. Unless windows are named, the pair is drawn whose distance is the median of all,
//! so that the figure is neither the best case nor the worst.

use std::collections::BTreeSet;

use plotters::style::RGBColor;
use record::{
    family::{Family, Member},
    report_settings::{DrawnPair, DrawnScenario},
};

use super::canvas::colour;
use crate::{
    analysis::{comparison::Comparison, report::Report, scenario::ScenarioReport},
    present::colours,
};

/// Pairs of scenarios that are drawn when none is named.
const MOST_BY_DEFAULT: usize = 12;

/// What is drawn, and what is to be said of what is not.
pub(crate) struct Chosen<'a> {
    pub(crate) pairs: Vec<WindowPair<'a>>,
    pub(crate) remarks: Vec<String>,
}

/// Two windows to draw.
pub(crate) struct WindowPair<'a> {
    /// Of both, as the comparison has them.
    pub(super) scenarios: [&'a ScenarioReport; 2],
    pub(super) comparison: Comparison<'a>,
    /// For the file's name: `b-h`, or `b2-h1` where windows were named.
    pub(super) name: String,
    /// Why these windows.
    pub(super) choice: &'static str,
}

/// The pairs that the settings name, or else the baseline scenarios beside each other and the scenarios that differ in virtualization
/// alone.
pub(crate) fn chosen(report: &Report) -> Chosen<'_> {
    let mut chosen = Chosen {
        pairs: Vec::new(),
        remarks: Vec::new(),
    };
    let named = &report.settings.figures;
    if named.is_empty() {
        let pairs = by_default(report);
        if pairs.len() > MOST_BY_DEFAULT {
            chosen.remarks.push(format!(
                "{} pairs of scenarios could be drawn, and the first {MOST_BY_DEFAULT} are. Name others in `report.figures` or \
                 with `matrix report --figures`.",
                pairs.len()
            ));
        }
        let pairs = pairs.into_iter().take(MOST_BY_DEFAULT);
        chosen.pairs = pairs
            .filter_map(|(a, b)| windows_of(report, [(a, None), (b, None)]))
            .collect();
        return chosen;
    }
    let mut names = BTreeSet::new();
    for pair in named {
        match drawable(report, pair) {
            Ok(found) if names.insert(found.name.clone()) => chosen.pairs.push(found),
            Ok(_) => {}
            Err(remark) => chosen.remarks.push(remark),
        }
    }
    chosen
}

/// A pair that is named, or why it is not drawn.
fn drawable<'a>(report: &'a Report, pair: &DrawnPair) -> Result<WindowPair<'a>, String> {
    let find = |side: &DrawnScenario| {
        let mut scenarios = report.scenarios.iter();
        let found = scenarios.find(|scenario| scenario.id == side.name || scenario.slug == side.name);
        let scenario = found.ok_or_else(|| {
            format!(
                "`report.figures` names `{}`, which is no scenario's letter or slug.",
                side.name
            )
        })?;
        let counts = |wanted: u32| scenario.windows.iter().any(|it| it.number == wanted && it.n > 0);
        match side.window {
            Some(window) if !counts(window) => Err(format!(
                "`report.figures` names `{side}`, and there is no window {window} of it that counts: the pair is not drawn."
            )),
            window => Ok((scenario, window)),
        }
    };
    let [a, b] = pair.sides();
    windows_of(report, [find(a)?, find(b)?]).ok_or_else(|| {
        format!("`report.figures` names `{a}` and `{b}`, of which no two windows are compared: the pair is not drawn.")
    })
}

/// Of two scenarios' windows that fit, the pair of the median D.
fn windows_of<'a>(
    report: &'a Report,
    wanted: [(&'a ScenarioReport, Option<u32>); 2],
) -> Option<WindowPair<'a>> {
    let fits = |(scenario, window): (&ScenarioReport, Option<u32>), id: &str, number: u32| {
        scenario.id == id && window.is_none_or(|window| window == number)
    };
    // Which of the wanted is the comparison's first.
    let order = |it: &Comparison<'_>| {
        [[0, 1], [1, 0]]
            .into_iter()
            .find(|[a, b]| fits(wanted[*a], it.a, it.a_window) && fits(wanted[*b], it.b, it.b_window))
    };
    let comparison = report.comparisons.of_median_d(|it| order(it).is_some())?;
    let order = order(&comparison)?;
    let name = order.map(|side| {
        let (scenario, window) = wanted[side];
        match window {
            None => scenario.id.clone(),
            Some(window) => format!("{}{window}", scenario.id),
        }
    });
    Some(WindowPair {
        scenarios: order.map(|side| wanted[side].0),
        comparison,
        name: name.join("-"),
        choice: match wanted.map(|(_, window)| window) {
            [None, None] => "Of all their pairs of windows it is the one of the median D",
            [Some(_), Some(_)] => "The windows were named",
            _ => "Of the pairs of the named window it is the one of the median D",
        },
    })
}

/// Of all windows of two scenarios that are compared, or else of one, the pair of the median D.
pub(super) fn of_median_d(report: &Report) -> Option<WindowPair<'_>> {
    let find = |id: &str| report.scenarios.iter().find(|scenario| scenario.id == id);
    let comparisons = &report.comparisons;
    let between = comparisons.of_median_d(|it| it.a != it.b);
    let comparison = between.or_else(|| comparisons.of_median_d(|it| it.a == it.b))?;
    Some(WindowPair {
        scenarios: [find(comparison.a)?, find(comparison.b)?],
        comparison,
        name: String::new(),
        choice: "Of all pairs of windows it is the one of the median D",
    })
}

/// The paper's kinds of pairs, which ran the same experiment and have data: the baseline scenarios beside each other, then those that
/// differ in virtualization alone. Where there are none of them, each scenario against each baseline scenario.
fn by_default(report: &Report) -> Vec<(&ScenarioReport, &ScenarioReport)> {
    let scenarios = &report.scenarios;
    let members: Vec<Member<'_>> = scenarios
        .iter()
        .map(|it| Member::new(&it.id, &it.slug, it.is_baseline, &it.axes))
        .collect();
    let of = |family: &Family, wanted: fn(&ScenarioReport, &ScenarioReport) -> bool| {
        let pairs = family.pairs(&members).into_iter();
        let pairs = pairs.filter_map(|(a, b)| scenarios.get(a).zip(scenarios.get(b)));
        let pairs = pairs.filter(|(a, b)| {
            wanted(a, b)
                && report.tally(&a.id, &b.id).is_some()
                && report.setup_differences(&a.id, &b.id).is_empty()
        });
        pairs.collect::<Vec<_>>()
    };
    let both = |a: &ScenarioReport, b: &ScenarioReport| a.is_baseline && b.is_baseline;
    let mut pairs = of(&Family::All, both);
    // Two of the baseline on one platform are among those already.
    pairs.extend(of(&Family::SamePlatform, |a, b| {
        !(a.is_baseline && b.is_baseline)
    }));
    if pairs.is_empty() {
        pairs = of(&Family::AgainstBaseline, |_, _| true);
    }
    pairs
}

impl WindowPair<'_> {
    /// Those of its scenarios.
    pub(super) fn colours(&self, report: &Report) -> [RGBColor; 2] {
        colours::of_two(report, self.scenarios.map(|scenario| scenario.id.as_str())).map(colour)
    }

    /// Both samples in ascending order, in metres.
    pub(super) fn samples(&self, report: &Report) -> [Vec<f64>; 2] {
        let it = &self.comparison;
        [(it.a, it.a_window), (it.b, it.b_window)].map(|(scenario, window)| {
            let mut samples = report.samples.iter();
            let found = samples.find(|sample| sample.scenario == scenario && sample.window == window);
            let mut values = found.map(|sample| sample.values.clone()).unwrap_or_default();
            values.sort_by(f64::total_cmp);
            values
        })
    }

    /// What each of the windows is called, such as `b x86-64-debian-12-native, window 2`.
    pub(super) fn names(&self) -> [String; 2] {
        let windows = [self.comparison.a_window, self.comparison.b_window];
        let [a, b] = self.scenarios;
        [(a, windows[0]), (b, windows[1])]
            .map(|(it, window)| format!("{} {}, window {window}", it.id, it.slug))
    }

    pub(super) fn is_simulated(&self) -> bool {
        self.scenarios.iter().any(|scenario| scenario.is_simulated)
    }
}
