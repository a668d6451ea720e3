//! What a report found, in sentences that say no more than was measured: [`Report::findings`].

use std::collections::BTreeSet;

use statistics::{effect::Interval, power::fewest_windows, replicates::fewest_rounds};

use crate::{
    analysis::{
        agreement::Agreement,
        contrast::Verdict,
        expectation::{ExpectedMean, Miss},
        report::Report,
        scenario::{ScenarioReport, Standing},
    },
    present::{
        axes::Axes,
        forest::{Shift, percent, simultaneous_confidence, unit},
        listing::listed,
        sweep::Sweep,
        table::p_in_words,
    },
};

/// Pairs, and scenarios, up to which each is named.
const MOST_NAMED: usize = 6;

/// Lines of sweeps that are told.
const MOST_LINES: usize = 3;

/// The verdicts in the order in which they are told.
const ORDER: [Verdict; 7] = [
    Verdict::DifferMaterially,
    Verdict::Differ,
    Verdict::DifferByUnknown,
    Verdict::DifferLevelOpen,
    Verdict::Immaterial,
    Verdict::NotToldApart,
    Verdict::CannotTell,
];

impl Report {
    /// What was found on the declared family, in sentences: which scenarios differ, by how much and how sure that is; then what is open
    /// and what would settle it; then what a reader should doubt. What could not be measured is never no difference.
    #[must_use]
    pub fn findings(&self) -> Vec<String> {
        let mut sentences = self.not_as_expected();
        sentences.extend(self.agreements.iter().map(agreement));
        let has_pairs = !self.contrasts.pairs.is_empty();
        if has_pairs {
            sentences.extend(self.of_pairs());
        }
        sentences.extend(self.of_sweeps());
        if !has_pairs && self.agreements.is_empty() {
            sentences.push(self.nothing_to_compare());
        }
        for other in &self.others {
            // All that is not as expected, and the first that was found.
            let told = other.not_as_expected().len().max(1);
            let told = other.findings().into_iter().take(told);
            sentences.extend(told.map(|finding| format!("{}: {finding}", other.quantity.name)));
        }
        sentences.extend(self.disturbed());
        if let Some(first) = sentences.first_mut().filter(|_| self.is_simulated()) {
            first.insert_str(0, "Simulated, not measured: ");
        }
        sentences
    }

    /// What the matrix file expects otherwise (`report.expect`), the first sentences of all.
    fn not_as_expected(&self) -> Vec<String> {
        let axes = Axes::of(&self.scenarios);
        let misses: Vec<_> = self
            .expected
            .iter()
            .filter_map(|it| Some((it, it.miss()?)))
            .collect();
        let named = misses.iter().take(MOST_NAMED);
        let mut sentences: Vec<String> = named.map(|(it, miss)| self.miss(&axes, it, *miss)).collect();
        sentences.extend(match misses.len().saturating_sub(MOST_NAMED) {
            0 => None,
            1 => Some("1 further mean is not as expected.".to_owned()),
            many => Some(format!("{many} further means are not as expected.")),
        });
        sentences
    }

    fn miss(&self, axes: &Axes, mean: &ExpectedMean, miss: Miss) -> String {
        let quantity = &self.quantity;
        let bound = if miss.is_below { "at least" } else { "at most" };
        let interval = mean.mean.interval.map_or_else(String::new, |interval| {
            format!(
                " [{}, {}]",
                quantity.digits(interval.low),
                quantity.digits(interval.high)
            )
        });
        let open = match miss.is_sure {
            true => "",
            false => ", which the spread of its windows leaves open",
        };
        let name = self.named(axes, &mean.scenario);
        format!(
            "Not as expected: the {} of {name} is {}{interval}, and {bound} {} is expected{open}.",
            quantity.name,
            quantity.text(mean.mean.value),
            quantity.text(miss.limit),
        )
    }

    /// A scenario's letter, with its name where it has one.
    fn named(&self, axes: &Axes, letter: &str) -> String {
        let scenario = self.scenarios.iter().find(|scenario| scenario.id == letter);
        match scenario.map(|scenario| axes.name(scenario)).unwrap_or_default() {
            nothing if nothing.is_empty() => letter.to_owned(),
            name => format!("{letter} ({name})"),
        }
    }

    fn nothing_to_compare(&self) -> String {
        let with_data = self.scenarios.iter().filter(|it| it.windows_counted() > 0);
        let unlike: BTreeSet<&str> = self
            .setup_differences
            .iter()
            .flat_map(|unlike| unlike.fields.iter().map(String::as_str))
            .collect();
        if with_data.count() > 1 && !unlike.is_empty() {
            return format!(
                "No two scenarios ran the same experiment, so that no pair is compared: they differ in {}. Name the pairs that you want to \
                 have compared all the same (`report.family`).",
                Vec::from_iter(unlike).join(", ")
            );
        }
        let completed = self
            .scenarios
            .iter()
            .filter(|it| it.standing == Standing::Completed);
        format!(
            "No two scenarios of the family have windows that count: nothing can be said of a difference ({} of {} scenarios completed).",
            completed.count(),
            self.scenarios.len()
        )
    }

    /// What the metric does along swept settings, with means of windows and their intervals.
    fn of_sweeps(&self) -> Vec<String> {
        let sweeps = Sweep::all(self);
        let mut lines: Vec<_> = sweeps
            .iter()
            .map(|sweep| sweep.told(&self.quantity.name).into_iter())
            .collect();
        // One of each swept setting before the second of any.
        let mut told = Vec::new();
        loop {
            let next: Vec<String> = lines.iter_mut().filter_map(Iterator::next).collect();
            if next.is_empty() {
                break;
            }
            told.extend(next);
        }
        let more = told.split_off(told.len().min(MOST_LINES.max(sweeps.len()))).len();
        told.extend(match more {
            0 => None,
            1 => Some("The figures of the sweeps have 1 line more.".to_owned()),
            many => Some(format!("The figures of the sweeps have {many} lines more.")),
        });
        if told.iter().any(|line| line.contains('[')) {
            told.push("Brackets: the mean's interval of 95 % over windows.".to_owned());
        }
        told
    }

    fn of_pairs(&self) -> Vec<String> {
        let axes = Axes::of(&self.scenarios);
        let pairs = Shift::all(self);
        let with = |verdict: &Verdict| -> Vec<&Shift> {
            pairs.iter().filter(|pair| pair.verdict == *verdict).collect()
        };
        let groups = ORDER.iter().map(|verdict| (*verdict, with(verdict)));
        let mut sentences: Vec<String> = groups
            .filter_map(|(verdict, group)| self.of_group(&axes, verdict, &group))
            .collect();
        sentences.extend(self.what_would_settle(&pairs));
        sentences.extend(match self.contrasts.without_data.len() {
            0 => None,
            1 => Some("1 further pair has no data.".to_owned()),
            many => Some(format!("{many} further pairs have no data.")),
        });
        sentences
    }

    /// The pairs with one verdict, with the largest difference among them.
    fn of_group(&self, axes: &Axes, verdict: Verdict, group: &[&Shift]) -> Option<String> {
        let sizes = |pair: &&&Shift| pair.shift.value.abs();
        let largest = group.iter().max_by(|a, b| sizes(a).total_cmp(&sizes(b)))?;
        let what = self.in_words(verdict);
        let difference = self.difference(axes, largest);
        Some(match group {
            [one] => format!("{} and {} {what}: {difference}.", one.a, one.b),
            many => {
                let mut text = format!(
                    "{} of {} pairs of scenarios {what}{}",
                    many.len(),
                    self.contrasts.pairs.len(),
                    named(many)
                );
                text.push_str("; the largest difference: ");
                text.push_str(&difference);
                text.push('.');
                text
            }
        })
    }

    fn in_words(&self, verdict: Verdict) -> String {
        let margin = self.quantity.margin().unwrap_or_default();
        let unit = unit(self);
        match verdict {
            Verdict::DifferMaterially => format!("differ by more than {margin}, which matters"),
            Verdict::Differ => "differ".to_owned(),
            Verdict::DifferByUnknown => format!("differ, and it is open whether by more than {margin}"),
            Verdict::DifferLevelOpen => {
                format!("differ, and it is open whether in the mean or only in the spread of their {unit}s")
            }
            Verdict::Immaterial => format!("differ by no more than {margin}, which does not matter"),
            Verdict::NotToldApart => "are not told apart, which is not the same as no difference".to_owned(),
            Verdict::CannotTell => {
                format!("cannot be told apart by so few {unit}s, however large the difference")
            }
        }
    }

    /// How large the difference of a pair is, and how sure that is.
    fn difference(&self, axes: &Axes, pair: &Shift) -> String {
        let name = |letter: &str| self.named(axes, letter);
        let (shift, quantity) = (pair.shift.value, &self.quantity);
        let size = match shift {
            smaller if smaller < 0.0 => "smaller than",
            larger if larger > 0.0 => "larger than",
            _ => "different from",
        };
        // After "smaller" numbers are how much smaller; where the interval goes both ways, each end says which it is.
        let ends = |interval: Interval| {
            let [low, high] = [interval.low, interval.high].map(|end| quantity.digits(end.abs()));
            match (interval.low < 0.0, interval.high > 0.0) {
                (true, true) => format!("[{low} smaller, {high} larger]"),
                (true, false) => format!("[{high}, {low}]"),
                (false, _) => format!("[{low}, {high}]"),
            }
        };
        let all = pair.all.map(|interval| {
            match self.contrasts.pairs.len() {
                1 => format!(
                    " {}, {} interval",
                    ends(interval),
                    percent(simultaneous_confidence(self))
                ),
                // Each is wider than that, so that all of them hold with it.
                _ => format!(
                    " {}, interval that holds for all pairs at once with {}",
                    ends(interval),
                    percent(1.0 - self.settings.alpha)
                ),
            }
        });
        let alone = pair
            .shift
            .interval
            .map(|interval| format!(" {}, {} interval", ends(interval), percent(interval.confidence)));
        let interval = all.or(alone).unwrap_or_default();
        let p = pair
            .p_holm
            .map_or_else(String::new, |p| format!(", {}", p_in_words(p)));
        format!(
            "the {} of {} is {} {size} that of {}{interval}{p}",
            quantity.name,
            name(&pair.b),
            quantity.text(shift.abs()),
            name(&pair.a)
        )
    }

    fn what_would_settle(&self, pairs: &[Shift]) -> Option<String> {
        let has = |wanted: &[Verdict]| pairs.iter().any(|pair| wanted.contains(&pair.verdict));
        let unit = unit(self);
        if has(&[Verdict::CannotTell]) {
            let alpha = self.settings.alpha / pairs.len().max(1) as f64;
            let needed = match self.replicates {
                None => fewest_windows(alpha),
                Some(_) => fewest_rounds(alpha),
            };
            let fewer = match pairs.len() {
                1 => "",
                _ => ", or fewer if fewer pairs are declared (`report.family`)",
            };
            return needed.map(|needed| match self.measured_windows() {
                Some(measured) if measured >= needed && self.replicates.is_none() => format!(
                    "It takes {needed} windows of each scenario that count: so many were measured, and too many of them are invalid."
                ),
                _ => format!("It takes {needed} {unit}s of each scenario or more (`{unit}s: {needed}` below `workload:`){fewer}."),
            });
        }
        let open = [
            Verdict::NotToldApart,
            Verdict::DifferByUnknown,
            Verdict::DifferLevelOpen,
        ];
        match self.quantity.margin() {
            _ if !has(&open) => None,
            Some(margin) => Some(format!(
                "More {unit}s narrow the interval, until it lies within ±{margin}, which does not matter here, or outside."
            )),
            None => Some(format!(
                "More {unit}s narrow the intervals. Declare from which size on a difference matters ({}) to have them judged by it.",
                self.quantity.margin_setting
            )),
        }
    }

    /// The windows of the measured scenario that has the fewest of them, whether they count or not.
    fn measured_windows(&self) -> Option<usize> {
        let windows = self.scenarios.iter().map(|scenario| scenario.windows.len());
        windows.filter(|windows| *windows > 0).min()
    }

    /// The scenarios of which windows are not valid: their numbers may be of what disturbed them.
    fn disturbed(&self) -> Option<String> {
        let invalid = self.named_windows(|it| (it.windows.len() - it.windows_counted(), it.windows.len()));
        let suspect = self.named_windows(|it| (it.windows_suspect(), it.windows_counted()));
        let invalid = invalid.map(|named| format!("Invalid windows, which do not count: {named}. "));
        let suspect = suspect
            .map(|named| format!("Suspect windows, in which something disturbed the measurement: {named}. "));
        (invalid.is_some() || suspect.is_some()).then(|| {
            format!(
                "{}{}Measure again on an idle machine before you rely on them.",
                invalid.unwrap_or_default(),
                suspect.unwrap_or_default()
            )
        })
    }

    /// The scenarios that have some of these windows, of so many.
    fn named_windows(&self, of: impl Fn(&ScenarioReport) -> (usize, usize)) -> Option<String> {
        let some: Vec<String> = self
            .scenarios
            .iter()
            .filter_map(|scenario| {
                let (some, all) = of(scenario);
                (some > 0).then(|| format!("{some} of {all} of {}", scenario.id))
            })
            .collect();
        (!some.is_empty()).then(|| listed(&some))
    }
}

/// Whether a metric that is compared byte for byte is the same.
fn agreement(agreement: &Agreement) -> String {
    let metric = &agreement.metric;
    if agreement.windows.is_empty() {
        return format!("No window of {metric} counts in two scenarios: nothing can be said of it.");
    }
    let mut groups = agreement.groups.iter().map(|group| listed(&group.scenarios));
    let first = groups.next().unwrap_or_default();
    let others: Vec<String> = groups.collect();
    match others.is_empty() {
        true => format!("{metric} is the same, byte for byte, in {first}."),
        false => format!(
            "{metric} is not the same, byte for byte: something else than in {first} is in {}.",
            others.join(", and again something else in ")
        ),
    }
}

fn named(pairs: &[&Shift]) -> String {
    match pairs.len() {
        few if few <= MOST_NAMED => {
            let names: Vec<String> = pairs
                .iter()
                .map(|pair| format!("{}–{}", pair.a, pair.b))
                .collect();
            format!(" ({})", names.join(", "))
        }
        _ => String::new(),
    }
}
