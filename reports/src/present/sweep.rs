//! The metric against a swept setting: one line for all scenarios that are alike in all else. The main type is [`Sweep`].

use record::quantity::{BitRate, Frequency, TimeSpan};
use statistics::effect::{level, mean_interval};

use crate::{
    analysis::{report::Report, scenario::ScenarioReport},
    present::axes::Axes,
};

/// An axis whose values are numbers.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Sweep {
    /// The axis's name.
    pub(crate) axis: String,
    /// What it is called at the figure's axis, with the unit.
    pub(crate) heading: String,
    /// The unit of its values; empty if they have none.
    unit: String,
    /// Never empty.
    pub(crate) lines: Vec<Line>,
}

/// Scenarios that differ in the swept setting alone.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Line {
    /// What tells them from those of other lines; empty if there are no others.
    pub(crate) name: String,
    /// By the setting's value.
    pub(crate) points: Vec<Point>,
}

/// A scenario.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Point {
    /// The setting's value.
    pub(crate) x: f64,
    /// The mean of the window means, in the unit that tables show.
    pub(crate) mean: f64,
    /// Student's interval of that mean over the windows, which takes them for independent; none with one window.
    pub(crate) interval: Option<(f64, f64)>,
    /// Both in words, with the unit.
    text: String,
}

impl Sweep {
    /// Those of a report: each axis with two values or more that are numbers of one unit.
    pub(crate) fn all(report: &Report) -> Vec<Self> {
        let axes = Axes::of(&report.scenarios);
        let found = axes
            .varying
            .iter()
            .filter_map(|axis| Self::of(report, &axes, axis));
        found.collect()
    }

    fn of(report: &Report, axes: &Axes, axis: &str) -> Option<Self> {
        let measured: Vec<(&ScenarioReport, Vec<f64>)> = report
            .scenarios
            .iter()
            .map(|scenario| (scenario, report.levels(&scenario.id)))
            .filter(|(_, levels)| !levels.is_empty())
            .collect();
        let texts: Option<Vec<String>> = measured.iter().map(|(scenario, _)| scenario.axis(axis)).collect();
        let (values, unit) = in_one_unit(&texts?)?;
        let others = axes.without(&[axis]);
        let mut lines: Vec<Line> = Vec::new();
        for ((scenario, levels), x) in measured.iter().zip(&values) {
            let name = others.name(scenario);
            let point = Point::of(report, levels, *x)?;
            match lines.iter_mut().find(|line| line.name == name) {
                Some(line) => line.points.push(point),
                None => lines.push(Line {
                    name,
                    points: vec![point],
                }),
            }
        }
        for line in &mut lines {
            line.points.sort_by(|a, b| a.x.total_cmp(&b.x));
        }
        let is_swept = lines.iter().any(|line| {
            let (first, last) = (line.points.first(), line.points.last());
            first.zip(last).is_some_and(|(first, last)| first.x < last.x)
        });
        let heading = match unit.as_str() {
            "" => axis.to_owned(),
            unit => format!("{axis} ({unit})"),
        };
        is_swept.then(|| Self {
            axis: axis.to_owned(),
            heading,
            unit,
            lines,
        })
    }

    /// From where to where the metric goes along each line, a sentence each.
    pub(crate) fn told(&self, metric: &str) -> Vec<String> {
        let lines = self.lines.iter();
        lines.filter_map(|line| self.line_told(line, metric)).collect()
    }

    fn line_told(&self, line: &Line, metric: &str) -> Option<String> {
        let (first, last) = (line.points.first()?, line.points.last()?);
        if first.x >= last.x {
            return None;
        }
        let of = match line.name.as_str() {
            "" => String::new(),
            name => format!(" of {name}"),
        };
        let unit = match self.unit.as_str() {
            "" => String::new(),
            "%" => " %".to_owned(),
            unit => format!(" {unit}"),
        };
        // Between the ends it may be further off than at both.
        let between = line.points.iter().filter(|it| {
            let beyond = |end: &Point| (it.mean - end.mean).is_sign_positive();
            it.mean != first.mean && it.mean != last.mean && beyond(first) == beyond(last)
        });
        let distance = |it: &&Point| (it.mean - first.mean).abs().min((it.mean - last.mean).abs());
        let furthest = between.max_by(|a, b| distance(a).total_cmp(&distance(b)));
        let furthest = furthest.map_or_else(String::new, |it| {
            format!(", and is {} at {}{unit}", it.text, it.x)
        });
        Some(format!(
            "As {} goes from {} to {}{unit}, the {metric}{of} goes from {} to {}{furthest}.",
            self.axis, first.x, last.x, first.text, last.text
        ))
    }
}

impl Point {
    fn of(report: &Report, levels: &[f64], x: f64) -> Option<Self> {
        let quantity = &report.quantity;
        let mean = level(levels)?;
        let interval = mean_interval(levels);
        let ends = interval.map(|it| format!(" [{}, {}]", quantity.digits(it.low), quantity.digits(it.high)));
        Some(Self {
            x,
            mean: quantity.shown(mean),
            interval: interval.map(|it| (quantity.shown(it.low), quantity.shown(it.high))),
            text: format!("{}{}", quantity.text(mean), ends.unwrap_or_default()),
        })
    }
}

/// The numbers of some texts, and their unit; none if one is no number, or they have no unit in common.
fn in_one_unit(texts: &[String]) -> Option<(Vec<f64>, String)> {
    let split: Vec<(&str, &str)> = texts.iter().map(|text| number_and_unit(text)).collect();
    let (_, unit) = split.first()?;
    if split.iter().all(|(_, other)| other == unit) {
        let numbers: Option<Vec<f64>> = split.iter().map(|(number, _)| number.parse().ok()).collect();
        let numbers = numbers.filter(|numbers| numbers.iter().all(|number: &f64| number.is_finite()))?;
        return Some((numbers, (*unit).to_owned()));
    }
    let all = |read: &dyn Fn(&str) -> Option<f64>| -> Option<Vec<f64>> {
        texts.iter().map(|text| read(text)).collect()
    };
    // `900us` and `1ms` are on one axis.
    if let Some(times) = all(&|text| Some(text.parse::<TimeSpan>().ok()?.as_nanos() as f64 / 1e6)) {
        return Some((times, "ms".to_owned()));
    }
    if let Some(rates) = all(&|text| Some(text.parse::<BitRate>().ok()?.bits_per_second() as f64 / 1e6)) {
        return Some((rates, "Mbit/s".to_owned()));
    }
    let frequencies = all(&|text| Some(text.parse::<Frequency>().ok()?.hz()))?;
    Some((frequencies, "Hz".to_owned()))
}

fn number_and_unit(text: &str) -> (&str, &str) {
    let is_of_a_number = |letter: char| letter.is_ascii_digit() || matches!(letter, '.' | '-' | '+');
    let end = text.find(|letter| !is_of_a_number(letter)).unwrap_or(text.len());
    let (number, unit) = text.split_at(end);
    (number, unit.trim())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(texts: &[&str]) -> Option<(Vec<f64>, String)> {
        let texts: Vec<String> = texts.iter().map(|text| (*text).to_owned()).collect();
        in_one_unit(&texts)
    }

    #[test]
    fn values_are_put_on_an_axis_with_one_unit() {
        assert_eq!(
            read(&["10ms", "12.5 ms"]),
            Some((vec![10.0, 12.5], "ms".to_owned()))
        );
        assert_eq!(read(&["900us", "1ms"]), Some((vec![0.9, 1.0], "ms".to_owned())));
        assert_eq!(read(&["0%", "1%"]), Some((vec![0.0, 1.0], "%".to_owned())));
        assert_eq!(
            read(&["500kbit", "1Mbit"]),
            Some((vec![0.5, 1.0], "Mbit/s".to_owned()))
        );
        assert_eq!(read(&["3", "-4"]), Some((vec![3.0, -4.0], String::new())));
        assert_eq!(read(&["10ms", "1%"]), None);
        assert_eq!(read(&["native", "docker"]), None);
        assert_eq!(read(&["x86-64"]), None);
        assert_eq!(read(&[]), None);
    }
}
