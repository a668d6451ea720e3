//! Numbers beside each other with their intervals: the shifts of all pairs of the family, each with the interval that holds for all at
//! once, and the band that does not matter, which a reader sees before any count; and the parts of a difference. The main type is
//! [`Forest`]; [`figure::forest`](super::figure) draws it and [`Forest::text`] is it for a terminal.

use statistics::effect::{Estimate, Interval};

use crate::{
    analysis::{
        contrast::{Contrast, Verdict},
        quantity::Quantity,
        replicates::{EnvironmentContrast, Replicates},
        report::Report,
    },
    explain::{Explanation, Line},
};

/// Pairs that are drawn.
const MOST_DRAWN: usize = 60;

/// By how much the second scenario of a pair is above the first, in the unit of analysis that its verdict has.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Shift {
    pub(crate) a: String,
    pub(crate) b: String,
    /// With the interval of the pair by itself.
    pub(crate) shift: Estimate,
    /// The interval that holds for all pairs of the family at once; none where so few windows or environments cannot have it.
    pub(crate) all: Option<Interval>,
    /// The p-value of that unit, adjusted by Holm's method; none where it has no test.
    pub(crate) p_holm: Option<f64>,
    pub(crate) verdict: Verdict,
}

impl Shift {
    /// Of each pair of the family.
    pub(crate) fn all(report: &Report) -> Vec<Self> {
        let pairs = report.contrasts.pairs.iter();
        let shift = |pair: &Contrast| match &report.replicates {
            None => Self::of_windows(pair),
            Some(replicates) => Self::of_environments(pair, replicates.find(&pair.a, &pair.b)),
        };
        pairs.map(shift).collect()
    }

    fn of_windows(pair: &Contrast) -> Self {
        Self {
            a: pair.a.clone(),
            b: pair.b.clone(),
            shift: pair.effect.shift,
            all: pair.simultaneous,
            p_holm: Some(pair.p_holm),
            verdict: pair.verdict,
        }
    }

    /// Windows of one environment share what it has of its own: an interval that takes them for independent is too short.
    fn of_environments(pair: &Contrast, found: Option<&EnvironmentContrast>) -> Self {
        let alone = |it: &EnvironmentContrast| it.interval.filter(|_| !it.is_simultaneous);
        Self {
            a: pair.a.clone(),
            b: pair.b.clone(),
            shift: Estimate {
                value: found.map_or(pair.effect.shift.value, |it| it.shift),
                interval: found.and_then(alone),
            },
            all: found.and_then(|it| it.interval.filter(|_| it.is_simultaneous)),
            p_holm: found.map(|it| it.p_holm),
            verdict: pair.verdict,
        }
    }
}

/// The confidence of each interval that holds for all pairs at once, 0 to 1.
pub(crate) fn simultaneous_confidence(report: &Report) -> f64 {
    let of_environments = |it: &Replicates| 1.0 - report.settings.alpha / it.pairs.len().max(1) as f64;
    report.replicates.as_ref().map_or_else(
        || report.contrasts.simultaneous_confidence(&report.settings),
        of_environments,
    )
}

/// The unit of the verdicts.
pub(crate) const fn unit(report: &Report) -> &'static str {
    match report.replicates {
        None => "window",
        Some(_) => "environment",
    }
}

/// What is drawn, in the unit that tables show.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Forest {
    /// From the top; never empty.
    pub(crate) rows: Vec<Row>,
    /// The equivalence margin.
    pub(crate) margin: Option<f64>,
    /// What is drawn, with the unit.
    pub(crate) heading: String,
    /// The same in a sentence or two.
    pub(crate) caption: String,
    /// What the interval of a row is.
    pub(crate) each: &'static str,
    /// What the interval is that holds for all rows at once; none if there is no such interval.
    pub(crate) all: Option<&'static str>,
}

/// One number.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Row {
    /// Both letters of a pair, or a factor.
    pub(crate) name: String,
    pub(crate) value: f64,
    /// The interval of the row by itself; none with a single window, and of environments only where none holds for all pairs.
    pub(crate) each: Option<(f64, f64)>,
    /// The interval that holds for all rows at once; none where so few windows cannot have it.
    pub(crate) all: Option<(f64, f64)>,
}

impl Row {
    fn of(pair: &Shift, quantity: &Quantity) -> Self {
        let shown = |interval: Interval| (quantity.shown(interval.low), quantity.shown(interval.high));
        Self {
            name: format!("{}–{}", pair.a, pair.b),
            value: quantity.shown(pair.shift.value),
            each: pair.shift.interval.map(shown),
            all: pair.all.map(shown),
        }
    }
}

impl Forest {
    /// None where no pair of the family has data.
    pub(crate) fn of(report: &Report) -> Option<Self> {
        let pairs = Shift::all(report);
        let mut sizes: Vec<f64> = pairs.iter().map(|pair| pair.shift.value.abs()).collect();
        sizes.sort_by(|a, b| b.total_cmp(a));
        let smallest_drawn = sizes.get(MOST_DRAWN - 1).copied().unwrap_or(0.0);
        let drawn = pairs
            .iter()
            .filter(|pair| pair.shift.value.abs() >= smallest_drawn);
        let rows: Vec<Row> = drawn
            .map(|pair| Row::of(pair, &report.quantity))
            .take(MOST_DRAWN)
            .collect();
        (!rows.is_empty()).then(|| Self {
            caption: caption(report, &rows, pairs.len() - rows.len()),
            rows,
            margin: report
                .quantity
                .equivalence_margin
                .map(|margin| report.quantity.shown(margin)),
            heading: report
                .quantity
                .heading(&format!("shift of the {} means", unit(report))),
            each: "each pair by itself",
            all: Some("all pairs at once"),
        })
    }

    /// The parts of a difference.
    pub(crate) fn of_explanation(explained: &Explanation, quantity: &Quantity) -> Self {
        let row = |line: Line<'_>| Row {
            name: line.words.to_owned(),
            value: quantity.shown(line.m),
            each: line
                .interval_m
                .map(|[low, high]| (quantity.shown(low), quantity.shown(high))),
            all: None,
        };
        Self {
            rows: explained.lines().into_iter().map(row).collect(),
            margin: None,
            heading: quantity.heading("part of the difference of the means"),
            caption: format!("{} {}", explained.sentence(), explained.method()),
            each: "95 % interval",
            all: None,
        }
    }

    /// From the lowest to the highest of all that is drawn and 0, with some room.
    pub(crate) fn range(&self) -> (f64, f64) {
        let of_row = |row: &Row| {
            let ends = [row.each, row.all].into_iter().flatten();
            let mut values = vec![row.value];
            values.extend(ends.flat_map(|(low, high)| [low, high]));
            values
        };
        let margins = self.margin.into_iter().flat_map(|margin| [-margin, margin]);
        let values: Vec<f64> = self.rows.iter().flat_map(of_row).chain(margins).collect();
        let low = values.iter().copied().fold(0.0, f64::min);
        let high = values.iter().copied().fold(0.0, f64::max);
        let room = if high > low { 0.04 * (high - low) } else { 1.0 };
        (low - room, high + room)
    }

    /// The same for a terminal so many columns wide: `=` the interval of each pair, `-` the one for all at once, `o` the shift, `|`
    /// no shift, and `:` the margin.
    pub(crate) fn text(&self, width: usize) -> String {
        let name_width = self
            .rows
            .iter()
            .map(|row| row.name.chars().count())
            .max()
            .unwrap_or(0);
        let numbers: Vec<String> = self.rows.iter().map(|row| format!("{:+.3}", row.value)).collect();
        let number_width = numbers.iter().map(String::len).max().unwrap_or(0);
        let columns = width.saturating_sub(name_width + number_width + 4).max(11);
        let (low, high) = self.range();
        let place = |value: f64| {
            let share = (value - low) / (high - low);
            ((share * (columns - 1) as f64).round() as usize).min(columns - 1)
        };
        let line = |row: &Row| {
            let mut cells = vec![' '; columns];
            let mut fill = |interval: Option<(f64, f64)>, with: char| {
                if let Some((from, to)) = interval {
                    cells[place(from)..=place(to)].fill(with);
                }
            };
            fill(row.all, '-');
            fill(row.each, '=');
            for margin in self.margin.into_iter().flat_map(|margin| [-margin, margin]) {
                cells[place(margin)] = ':';
            }
            cells[place(0.0)] = '|';
            cells[place(row.value)] = 'o';
            String::from_iter(cells)
        };
        let lines = self.rows.iter().zip(&numbers).map(|(row, number)| {
            let line = format!("{:name_width$}  {number:>number_width$}  {}", row.name, line(row));
            line.trim_end().to_owned()
        });
        lines.collect::<Vec<_>>().join("\n")
    }
}

/// What is drawn, with so many pairs left out.
fn caption(report: &Report, rows: &[Row], left_out: usize) -> String {
    let unit = unit(report);
    let confidence = percent(simultaneous_confidence(report));
    let all = match rows.iter().any(|row| row.all.is_some()) {
        true => format!("Thin: the interval of {confidence} that holds for all pairs at once"),
        false => format!("None holds for all pairs at once: so few {unit}s cannot have one of {confidence}"),
    };
    let band = match report.quantity.margin() {
        Some(margin) => format!("the band of ±{margin} does not matter"),
        None => format!(
            "no band that does not matter is declared ({})",
            report.quantity.margin_setting
        ),
    };
    let left_out = match left_out {
        0 => String::new(),
        some => format!(" Not drawn: the {} with the smallest shifts.", pairs(some)),
    };
    format!(
        "By how much the {unit} means of the second scenario are larger. Thick: the interval of each pair by itself. {all}; \
         {band}.{left_out}"
    )
}

fn pairs(count: usize) -> String {
    match count {
        1 => "1 pair".to_owned(),
        many => format!("{many} pairs"),
    }
}

/// With as many places as tell it from 100 %.
pub(crate) fn percent(confidence: f64) -> String {
    let places = ((-(1.0 - confidence).log10()).ceil().clamp(2.0, 8.0) as usize).saturating_sub(1);
    let text = format!("{:.places$}", confidence * 100.0);
    let text = if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.')
    } else {
        &text
    };
    format!("{text} %")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn forest() -> Forest {
        let row = |name: &str, value: f64, each: f64, all: Option<f64>| Row {
            name: name.to_owned(),
            value,
            each: Some((value - each, value + each)),
            all: all.map(|all| (value - all, value + all)),
        };
        Forest {
            rows: vec![row("a–b", 0.5, 1.0, Some(2.0)), row("a–ca", 6.0, 1.0, None)],
            margin: Some(2.0),
            heading: "shift of the window means (mm)".to_owned(),
            caption: "the band of ±2 mm does not matter".to_owned(),
            each: "each pair by itself",
            all: Some("all pairs at once"),
        }
    }

    #[test]
    fn a_terminal_shows_the_shift_both_intervals_no_shift_and_the_margin() {
        let text = forest().text(42);
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines.iter().all(|line| line.chars().count() <= 42), "{text}");
        assert_eq!(
            lines,
            [
                "a–b   +0.500   :---==|o===:-",
                "a–ca  +6.000   :     |    :       ===o==="
            ]
        );
    }

    #[test]
    fn its_range_has_all_ends_and_no_shift_in_it() {
        let (low, high) = forest().range();
        assert!(
            low < -2.0 && low > -3.0 && high > 7.0 && high < 8.0,
            "{low} {high}"
        );
    }

    #[rstest::rstest]
    #[case(0.95, "95 %")]
    #[case(0.999, "99.9 %")]
    #[case(1.0 - 0.05 / 36.0, "99.86 %")]
    #[case(1.0 - 0.001 / 36.0, "99.9972 %")]
    #[case::none(f64::NAN, "NaN %")]
    fn a_confidence_is_told_from_certainty(#[case] confidence: f64, #[case] text: &str) {
        assert_eq!(percent(confidence), text);
    }
}
