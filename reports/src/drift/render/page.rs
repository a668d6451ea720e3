//! The history as one page for a browser, without a network and without JavaScript: what is to be told of first, then each scenario
//! and metric along the nights, with changes, acknowledgements and other platforms marked on the line. The function is
//! [`Drift::page`].

use std::fmt::Write as _;

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::{capitalised, parts_of};
use crate::{
    drift::{
        Cause, Drift, Finding, Judgement, Metric, Night, Series, Verdict,
        series::{Point, every_series},
    },
    present::render::head,
};

/// Of a drawing, in its own units.
const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 120.0;
/// For the numbers on the left, and a little on the right.
const SIDES: [f64; 2] = [124.0, 8.0];
/// Above the line, and below it for the names of the nights.
const ENDS: [f64; 2] = [10.0, 24.0];

impl Drift {
    /// The page of these nights, which were judged.
    #[must_use]
    pub fn page(&self, nights: &[Night]) -> String {
        let mut judged: Vec<&Judgement> = self.judgements.iter().collect();
        // What is to be looked at stands before what is as it was; within that the order stays.
        judged.sort_by_key(|judgement| std::cmp::Reverse(judgement.verdict.rank()));
        let mut scenarios: Vec<&str> = Vec::new();
        for judgement in &judged {
            if !scenarios.contains(&judgement.scenario.as_str()) {
                scenarios.push(&judgement.scenario);
            }
        }
        let series = every_series(nights);
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                (head(&format!("{}: history of {} nights", capitalised(self.verdict().name()), nights.len())))
                body {
                    header {
                        h1 { "History of " (nights.len()) " nights" }
                        div #verdict { p { strong { (self.headline()) } } }
                        (self.changed())
                        @if !self.remarks.is_empty() {
                            details { summary { "Remarks (" (self.remarks.len()) ")" } ul { @for remark in &self.remarks { li { (remark) } } } }
                        }
                        p .note {
                            "A dot is the level of a night, the median of its windows; the bar through it goes from its lowest to its highest \
                             window. Lines down the drawing: "
                            span .troubled { "a change that is to be told of" } ", "
                            span .completed { "one that somebody acknowledged" } ", "
                            span .left-out { "one that was withdrawn or does not matter" }
                            ". Ticks at the bottom: the platform is another than the night before."
                        }
                    }
                    main { @for scenario in &scenarios { (of_scenario(scenario, &judged, &series, nights)) } }
                }
            }
        };
        page.into_string()
    }

    /// What is to be told of, each with how to acknowledge it; and what was told and is not so any more.
    fn changed(&self) -> Markup {
        let withdrawn: Vec<(&Judgement, &Finding)> = self
            .judgements
            .iter()
            .flat_map(|judgement| judgement.findings.iter().map(move |finding| (judgement, finding)))
            .filter(|(_, finding)| finding.withdrawn.is_some() && finding.acknowledged.is_none())
            .collect();
        html! {
            @for (judgement, finding) in self.news() {
                div .change {
                    p {
                        strong { (judgement.scenario) " " (judgement.metric.name()) } " " (finding.in_words(&judgement.metric)) "."
                    }
                    details {
                        summary { "Acknowledge it in drift.yaml" }
                        pre { (self.acknowledgement(judgement, finding)) }
                    }
                }
            }
            @if !withdrawn.is_empty() {
                h2 { "Told and withdrawn" }
                ul { @for (judgement, finding) in withdrawn {
                    li {
                        strong { (judgement.scenario) " " (judgement.metric.name()) } " " (finding.in_words(&judgement.metric)) "; "
                        (finding.silence().unwrap_or_default())
                    }
                } }
            }
        }
    }
}

fn of_scenario(scenario: &str, judged: &[&Judgement], series: &[Series<'_>], nights: &[Night]) -> Markup {
    let judgements = judged.iter().filter(|judgement| judgement.scenario == scenario);
    let line = |judgement: &Judgement| {
        let mut all = series.iter();
        all.find(|line| line.scenario == scenario && line.metric == judgement.metric)
    };
    let platforms = platforms(scenario, nights);
    html! {
        section .history {
            h2 { (scenario) }
            @for judgement in judgements {
                figure {
                    @if let Some(line) = line(judgement).filter(|line| !line.points.is_empty()) {
                        (PreEscaped(drawn(line, judgement, &platforms, nights)))
                    }
                    figcaption {
                        strong .troubled[judgement.verdict == Verdict::Drift] { (judgement.metric.name()) } ": " (judgement.in_words())
                        @for finding in &judgement.findings { br; (finding.in_words(&judgement.metric))
                            @if let Some(silence) = finding.silence() { "; " (silence) }
                        }
                    }
                }
            }
            @if !platforms.is_empty() {
                details {
                    summary { "Other platforms (" (platforms.len()) ")" }
                    ul { @for (night, cause) in &platforms {
                        li { (nights.get(*night).map_or("", |night| night.run.as_str())) ": " (parts_of(cause)) }
                    } }
                }
            }
        }
    }
}

/// The nights whose platform is another than that of the night before which was measured, by their places.
fn platforms(scenario: &str, nights: &[Night]) -> Vec<(usize, Cause)> {
    let measured = nights.iter().enumerate().filter_map(|(place, night)| {
        let measured = night.scenarios.get(scenario)?;
        measured.environment.as_ref()?;
        Some((place, measured))
    });
    let measured: Vec<_> = measured.collect();
    let pairs = measured.windows(2).filter_map(|pair| {
        let [(_, before), (place, since)] = pair else {
            return None;
        };
        let cause = Cause::between_platforms(before, since);
        (cause != Cause::Unexplained).then_some((*place, cause))
    });
    pairs.collect()
}

/// Where a number and a night are in the drawing.
struct Scale {
    low: f64,
    high: f64,
    nights: usize,
}

impl Scale {
    fn of(points: &[Point<'_>], metric: &Metric, nights: usize) -> Self {
        let all = || points.iter().filter_map(|point| point.range(metric));
        let low = all().map(|[low, _]| low).fold(f64::INFINITY, f64::min);
        let high = all().map(|[_, high]| high).fold(f64::NEG_INFINITY, f64::max);
        // Of nights that are all the same the line is in the middle.
        let room = if high > low {
            0.0
        } else {
            low.abs().max(1e-9) * 0.01
        };
        Self {
            low: low - room,
            high: high + room,
            nights,
        }
    }

    fn x(&self, night: usize) -> f64 {
        let [left, right] = SIDES;
        let share = night as f64 / self.nights.saturating_sub(1).max(1) as f64;
        left + 4.0 + share * (WIDTH - left - right - 8.0)
    }

    fn y(&self, value: f64) -> f64 {
        let [above, below] = ENDS;
        let share = (value - self.low) / (self.high - self.low);
        HEIGHT - below - share * (HEIGHT - above - below)
    }
}

/// A path for all bars, one for all dots and one for all ticks, since a year of nights has many.
fn drawn(line: &Series<'_>, judgement: &Judgement, platforms: &[(usize, Cause)], nights: &[Night]) -> String {
    let (points, metric) = (&line.points, &line.metric);
    let scale = Scale::of(points, metric, nights.len());
    let (mut bars, mut dots, mut ticks, mut marks) =
        (String::new(), String::new(), String::new(), String::new());
    for point in points {
        let x = scale.x(point.night);
        if let Some([low, high]) = point.range(metric).filter(|[low, high]| low < high) {
            let _ = write!(bars, "M{x:.1} {:.1}V{:.1}", scale.y(low), scale.y(high));
        }
        let _ = write!(dots, "M{x:.1} {:.1}h0", scale.y(point.level));
    }
    let [above, below] = ENDS;
    let (top, bottom) = (above - 4.0, HEIGHT - below + 2.0);
    for (place, _) in platforms {
        let _ = write!(ticks, "M{:.1} {bottom}v5", scale.x(*place));
    }
    for finding in &judgement.findings {
        let place = nights.iter().position(|night| night.run == finding.since);
        let class = match (finding.is_news(), &finding.acknowledged) {
            (true, _) => "news",
            (false, Some(_)) => "known",
            (false, None) => "silent",
        };
        if let Some(place) = place {
            // Between the last night before and the first with it.
            let x = (scale.x(place.saturating_sub(1)) + scale.x(place)) / 2.0;
            let _ = write!(marks, "<path class=\"{class}\" d=\"M{x:.1} {top}V{bottom}\"/>");
        }
    }
    let number = |value: f64, y: f64| html! { text x=(SIDES[0] - 4.0) y=(format!("{y:.1}")) text-anchor="end" { (metric.text(value)) } };
    let day = |night: Option<&Night>| {
        night
            .map_or("", |night| night.created.get(..10).unwrap_or_default())
            .to_owned()
    };
    let label = format!(
        "{} of {} along {} nights: {}",
        metric.name(),
        line.scenario,
        points.len(),
        judgement.in_words()
    );
    let drawing = html! {
        svg .plot viewBox=(format!("0 0 {WIDTH} {HEIGHT}")) role="img" aria-label=(label) {
            path .grid d=(format!("M{0} {top}V{bottom}H{1}", SIDES[0], WIDTH - SIDES[1])) fill="none" {}
            path .bars d=(bars) {}
            path .dots d=(dots) {}
            path .ticks d=(ticks) {}
            (PreEscaped(marks))
            (number(scale.high, above + 5.0))
            (number(scale.low, HEIGHT - below))
            text x=(SIDES[0]) y=(HEIGHT - 5.0) { (day(nights.first())) }
            text x=(WIDTH - SIDES[1]) y=(HEIGHT - 5.0) text-anchor="end" { (day(nights.last())) }
        }
    };
    drawing.into_string()
}
