//! A report on one screen of a terminal of 80 columns: what was found, a row for each scenario, and what a reader must know. The rest
//! is in the report's folder. The function is [`render`].

use record::run_directory::EnvironmentRecord;

use super::markdown::{WIDTH, block, drawn, plain, wrapped};
use crate::{
    analysis::{
        contrast::Contrast,
        report::Report,
        scenario::{ScenarioReport, Standing},
    },
    present::{Presentation, axes::Axes, listing::listed},
};

/// Scenarios that are shown.
const MOST_SHOWN: usize = 40;
/// Columns of a scenario's plot, and the fewest that still show something.
const PLOT: [usize; 2] = [24, 9];
/// Scenarios that have their plots below, where there is no room beside.
const MOST_BELOW: usize = 12;
/// Scenarios of whose windows it is said why they are not valid.
const MOST_REASONS: usize = 6;
/// The column of the value.
const VALUE: usize = 3;
/// Between the cells of a row.
const APART: usize = 3;
/// What is not there.
const NONE: &str = "–";

pub(super) fn render(page: &Presentation<'_>) -> String {
    let report = page.report;
    let axes = Axes::of(&report.scenarios);
    let mut text = String::new();
    block(&mut text, &wrapped(&plain(&report.findings().join(" ")), "", ""));
    let (rows, has_plots) = scenarios(report, &axes);
    block(&mut text, &rows);
    block(
        &mut text,
        &wrapped(&plain(&legend(report, &axes, has_plots)), "", ""),
    );
    let mut items = unmeasured(report);
    items.extend(not_valid(report));
    items.extend(beside_baselines(report));
    items.extend(of_environments(report));
    // The first sentence of a remark says what there is to know; tables.md has it whole.
    items.extend(
        page.remarks
            .iter()
            .map(|remark| first_sentence(remark).to_owned()),
    );
    let items: Vec<String> = items
        .iter()
        .map(|item| wrapped(&plain(item), "- ", "  "))
        .collect();
    if !items.is_empty() {
        block(&mut text, &items.join("\n"));
    }
    text
}

/// A row for each scenario, with a plot of its values, or below where there is no room beside.
fn scenarios(report: &Report, axes: &Axes) -> (String, bool) {
    let shown: Vec<(&ScenarioReport, Option<Quantiles>)> = report
        .scenarios
        .iter()
        .take(MOST_SHOWN)
        .map(|scenario| (scenario, Quantiles::of(report, &scenario.id)))
        .collect();
    let mut rows = vec![heading(report)];
    rows.extend(
        shown
            .iter()
            .map(|(scenario, values)| row(report, axes, scenario, values.as_ref())),
    );
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column));
        cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    let taken: usize = (0..rows[0].len()).map(|column| width(column) + APART).sum();
    let [most, fewest] = PLOT;
    let room = WIDTH.saturating_sub(taken + APART + 1).min(most);
    let scale = Scale::of(shown.iter().filter_map(|(_, values)| values.as_ref()));
    let plots = |width: usize| {
        let plot = |values: &Option<Quantiles>| {
            let plot = scale.as_ref().zip(values.as_ref());
            plot.map_or_else(String::new, |(scale, values)| scale.plot(values, width))
        };
        shown.iter().map(|(_, values)| plot(values)).collect::<Vec<_>>()
    };
    let is_beside = room >= fewest;
    if scale.is_some() && is_beside {
        let plots = std::iter::once(String::new()).chain(plots(room));
        for (row, plot) in rows.iter_mut().zip(plots) {
            // Before the verdict.
            row.insert(row.len() - 1, plot);
        }
    }
    // Blanks at the ends of a plot are part of it.
    let mut rows = rows.into_iter().map(|row| {
        row.iter()
            .map(|text| text.replace('|', "\\|"))
            .collect::<Vec<_>>()
    });
    let head = rows.next().unwrap_or_default();
    let mut text = drawn(head, rows, (0..).map(|column| column == VALUE));
    let is_below = !is_beside && shown.len() <= MOST_BELOW;
    if scale.is_some() && is_below {
        let letters = shown.iter().map(|(scenario, _)| scenario.id.as_str());
        let names = letters
            .clone()
            .map(|letter| letter.chars().count())
            .max()
            .unwrap_or(0);
        let lines = letters
            .zip(plots(WIDTH - names - 2))
            .filter(|(_, plot)| !plot.is_empty());
        let lines = lines.map(|(letter, plot)| format!("{letter:names$}  {plot}").trim_end().to_owned());
        text.push_str("\n\n");
        text.push_str(&lines.collect::<Vec<_>>().join("\n"));
    }
    let more = report.scenarios.len().saturating_sub(MOST_SHOWN);
    if more > 0 {
        text.push_str(&format!("\n\nand {more} more scenarios."));
    }
    (text, scale.is_some() && (is_beside || is_below))
}

fn heading(report: &Report) -> Vec<String> {
    vec![
        String::new(),
        "scenario".to_owned(),
        "windows".to_owned(),
        report.quantity.heading(&report.quantity.name),
        match baselines(report).as_slice() {
            [one] => format!("against {}", one.id),
            _ => "verdict".to_owned(),
        },
    ]
}

fn row(report: &Report, axes: &Axes, scenario: &ScenarioReport, values: Option<&Quantiles>) -> Vec<String> {
    vec![
        scenario.id.clone(),
        plain(&axes.label(scenario)),
        windows(scenario),
        values.map_or_else(|| NONE.to_owned(), |values| report.quantity.digits(values.mean)),
        against_baseline(report, scenario),
    ]
}

/// How many count, and what is wrong with them.
fn windows(scenario: &ScenarioReport) -> String {
    let counted = scenario.windows_counted();
    let all = match scenario.windows.len() {
        0 => return scenario.standing.name().to_owned(),
        all if counted == all => counted.to_string(),
        all => format!("{counted} of {all}"),
    };
    let suspect = match scenario.windows_suspect() {
        0 => String::new(),
        some => format!(", {some} suspect"),
    };
    match scenario.standing {
        Standing::Completed => format!("{all}{suspect}"),
        standing if counted == 0 => standing.name().to_owned(),
        standing => format!("{all}{suspect}, {}", standing.name()),
    }
}

/// The baseline scenarios of which the family has a pair.
fn baselines(report: &Report) -> Vec<&ScenarioReport> {
    let has_pair = |scenario: &&ScenarioReport| {
        let mut pairs = report.contrasts.pairs.iter();
        pairs.any(|pair| pair.a == scenario.id || pair.b == scenario.id)
    };
    report.baseline().filter(has_pair).collect()
}

/// The verdict of each pair with a baseline scenario, those with the same verdict together.
fn against_baseline(report: &Report, scenario: &ScenarioReport) -> String {
    let baselines = baselines(report);
    // One that nothing is compared with, as each setting of a sweep by itself, is no baseline to a reader.
    if scenario.is_baseline && baselines.iter().any(|it| it.id == scenario.id) {
        return "baseline".to_owned();
    }
    let verdicts = together(baselines.iter().filter_map(|baseline| {
        let pair = report.contrasts.find(&baseline.id, &scenario.id)?;
        Some((pair.verdict.name(), baseline.id.as_str()))
    }));
    let words = verdicts.iter().map(|(verdict, letters)| match baselines.len() {
        1 => (*verdict).to_owned(),
        _ => format!("{verdict} ({})", listed(letters)),
    });
    match verdicts.is_empty() {
        true => NONE.to_owned(),
        false => words.collect::<Vec<_>>().join("; "),
    }
}

/// That the rows have no place for pairs of two baseline scenarios, or of none, where there are such.
fn beside_baselines(report: &Report) -> Option<String> {
    let baselines: Vec<&str> = baselines(report).iter().map(|it| it.id.as_str()).collect();
    let pairs = &report.contrasts.pairs;
    let is_baseline = |id: &String| baselines.contains(&id.as_str());
    let is_in_a_row = |pair: &&Contrast| is_baseline(&pair.a) != is_baseline(&pair.b);
    let beside = pairs.len() - pairs.iter().filter(is_in_a_row).count();
    (beside > 0 && !baselines.is_empty()).then(|| {
        format!(
            "The rows have the verdicts against {}. `contrasts.csv` has all {} pairs, also the {beside} that are in no row.",
            listed(&baselines),
            pairs.len(),
        )
    })
}

/// What all scenarios have in common, and what the columns are.
fn legend(report: &Report, axes: &Axes, has_plots: bool) -> String {
    let common = axes
        .common
        .iter()
        .map(|(axis, value)| axes.described(axis, value));
    let common: Vec<String> = common.collect();
    let mut text = match common.is_empty() {
        true => String::new(),
        false => format!("All scenarios: {}. ", common.join(", ")),
    };
    text.push_str(&report.method());
    if !has_plots {
        return text;
    }
    text.push_str(" Beside the mean: from the 5 % to the 95 % quantile, the quartiles (`=`) and the median (`o`) of all values.");
    text
}

/// Why scenarios have no window, those with the same reason together.
fn unmeasured(report: &Report) -> Vec<String> {
    let reasons = together(report.scenarios.iter().filter_map(|scenario| {
        let reason = scenario.reason.as_deref()?;
        let why = (scenario.standing.name(), reason, scenario.hint.as_deref());
        Some((why, scenario.id.as_str()))
    }));
    let lines = reasons.into_iter().map(|((standing, reason, hint), letters)| {
        let hint = hint.map_or_else(String::new, |hint| format!(". To do: {hint}"));
        format!("{} {standing}: {reason}{hint}", listed(&letters))
    });
    lines.collect()
}

/// Why windows are not valid: of each scenario the first that is suspect, the first that is invalid, and so on, with how many are so.
fn not_valid(report: &Report) -> Vec<String> {
    let mut lines = Vec::new();
    for scenario in &report.scenarios {
        let verdicts = scenario.verdicts();
        let mut told: Vec<&str> = Vec::new();
        for first in &verdicts {
            if told.contains(&first.verdict) {
                continue;
            }
            told.push(first.verdict);
            let alike = scenario
                .windows
                .iter()
                .filter(|window| window.verdict == first.verdict);
            let others = alike.count().saturating_sub(first.count);
            let others = match others {
                0 => String::new(),
                1 => format!(" One more is {}.", first.verdict),
                more => format!(" {more} more are {}.", first.verdict),
            };
            lines.push(format!(
                "{} {first}: {}{others}",
                scenario.id,
                record::window::reasons_in_one_line(first.reasons)
            ));
        }
    }
    let more = lines.len().saturating_sub(MOST_REASONS);
    lines.truncate(MOST_REASONS);
    lines.extend((more > 0).then(|| format!("{more} more scenarios have windows that are not valid.")));
    let is_left_out = more > 0 || lines.iter().any(|line| line.contains(" more "));
    lines.extend(is_left_out.then(|| "`tables.md` says of every window why it is not valid.".to_owned()));
    lines
}

/// What is to be said of the scenarios' environments, those of which the same is to be said together.
fn of_environments(report: &Report) -> Vec<String> {
    let remarks = together(report.scenarios.iter().flat_map(|scenario| {
        let remarks = scenario.environment.iter().flat_map(EnvironmentRecord::remarks);
        remarks.map(|remark| (remark, scenario.id.as_str()))
    }));
    let lines = remarks.into_iter();
    lines
        .map(|(remark, letters)| format!("{}: {remark}", listed(&letters)))
        .collect()
}

/// The letters of which the same is to be said, in the order in which it is said first.
fn together<'a, T: PartialEq>(said: impl Iterator<Item = (T, &'a str)>) -> Vec<(T, Vec<&'a str>)> {
    let mut groups: Vec<(T, Vec<&str>)> = Vec::new();
    for (what, letter) in said {
        match groups.iter_mut().find(|(other, _)| *other == what) {
            Some((_, letters)) => letters.push(letter),
            None => groups.push((what, vec![letter])),
        }
    }
    groups
}

fn first_sentence(text: &str) -> &str {
    match text.find(". ") {
        Some(end) => &text[..=end],
        None => text,
    }
}

/// The values of a scenario.
struct Quantiles {
    /// Of the window means.
    mean: f64,
    /// The values that 5, 25, 50, 75 and 95 % do not exceed.
    at: [f64; 5],
}

impl Quantiles {
    /// None without a value.
    fn of(report: &Report, scenario: &str) -> Option<Self> {
        let samples = report.samples.iter().filter(|sample| sample.scenario == scenario);
        let mut values: Vec<f64> = samples.flat_map(|sample| sample.values.iter().copied()).collect();
        values.sort_by(f64::total_cmp);
        let last = values.len().checked_sub(1)?;
        let quantile = |share: f64| values.get((share * last as f64).round() as usize).copied();
        Some(Self {
            mean: statistics::effect::level(&report.levels(scenario))?,
            at: [
                quantile(0.05)?,
                quantile(0.25)?,
                quantile(0.5)?,
                quantile(0.75)?,
                quantile(0.95)?,
            ],
        })
    }
}

/// From the lowest to the highest that is plotted.
struct Scale {
    low: f64,
    high: f64,
}

impl Scale {
    /// None where nothing is to be plotted, or all of it in one place.
    fn of<'a>(all: impl Iterator<Item = &'a Quantiles>) -> Option<Self> {
        let mut scale = Self {
            low: f64::INFINITY,
            high: f64::NEG_INFINITY,
        };
        for Quantiles {
            at: [low, .., high], ..
        } in all
        {
            scale.low = scale.low.min(*low);
            scale.high = scale.high.max(*high);
        }
        (scale.low < scale.high).then_some(scale)
    }

    /// `-` from the 5 % to the 95 % quantile, `=` between the quartiles, `o` the median.
    fn plot(&self, values: &Quantiles, width: usize) -> String {
        let place = |value: f64| {
            let share = (value - self.low) / (self.high - self.low);
            ((share * (width - 1) as f64).round() as usize).min(width - 1)
        };
        let [from, lower, median, upper, to] = values.at.map(place);
        let mut cells = vec![' '; width];
        cells[from..=to].fill('-');
        cells[lower..=upper].fill('=');
        cells[median] = 'o';
        String::from_iter(cells)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plot_has_quartiles_within_tails_and_the_median_within_quartiles() {
        let scale = Scale { low: 0.0, high: 10.0 };
        let values = Quantiles {
            mean: 4.0,
            at: [1.0, 3.0, 4.0, 6.0, 9.0],
        };
        assert_eq!(scale.plot(&values, 11), " --=o==--- ");
        assert_eq!(Scale::of(std::iter::empty()).map(|it| it.low), None);
    }

    #[test]
    fn the_first_sentence_of_a_remark_ends_before_the_second() {
        assert_eq!(
            first_sentence("ONE: it is 0.5 of all. See below."),
            "ONE: it is 0.5 of all."
        );
        assert_eq!(first_sentence("no end"), "no end");
    }
}
