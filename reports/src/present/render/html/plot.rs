//! Axes of a drawing, and where a value lies on them. The main type is [`Plot`].

use std::ops::Range;

use maud::{Markup, html};

/// Of the drawing, in its own units.
pub(super) const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 300.0;
const LEFT: f64 = 80.0;
const RIGHT: f64 = 12.0;
const TOP: f64 = 10.0;
const BOTTOM: f64 = 44.0;
/// About so many numbers on an axis.
const TICKS: f64 = 5.0;

/// A drawing with two axes.
pub(super) struct Plot {
    /// From the left to the right.
    pub(super) x: Axis,
    /// From the bottom to the top.
    pub(super) y: Axis,
}

/// One axis.
#[derive(Clone)]
pub(super) struct Axis {
    name: String,
    range: Range<f64>,
}

impl Axis {
    /// From the least to the largest of the values, somewhat widened; none without a value.
    pub(super) fn around(name: &str, values: impl Iterator<Item = f64>) -> Option<Self> {
        let (low, high) =
            values
                .filter(|value| value.is_finite())
                .fold(None, |range, value| match range {
                    None => Some((value, value)),
                    Some((low, high)) => Some((value.min(low), value.max(high))),
                })?;
        let spare = match high > low {
            true => (high - low) * 0.04,
            false => high.abs().max(1.0) * 0.04,
        };
        Some(Self::from(name, low - spare..high + spare))
    }

    /// Of that range.
    pub(super) fn from(name: &str, range: Range<f64>) -> Self {
        Self {
            name: name.to_owned(),
            range,
        }
    }

    fn share(&self, value: f64) -> f64 {
        (value - self.range.start) / (self.range.end - self.range.start)
    }

    /// Round numbers within the range, with as many places as they need.
    fn ticks(&self) -> Vec<(f64, String)> {
        let raw = (self.range.end - self.range.start) / TICKS;
        if !(raw.is_finite() && raw > 0.0) {
            return Vec::new();
        }
        let decade = 10_f64.powf(raw.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0]
            .into_iter()
            .find(|times| times * decade >= raw);
        let step = step.unwrap_or(10.0) * decade;
        let places = (-step.log10().floor()).max(0.0) as usize;
        let first = (self.range.start / step).ceil();
        (0..)
            .map(|index| (first + f64::from(index)) * step)
            .take_while(|tick| *tick <= self.range.end)
            .map(|tick| {
                (
                    tick,
                    format!("{tick:.places$}").replace("-0", "−0").replace('-', "−"),
                )
            })
            .collect()
    }
}

impl Plot {
    /// Where a value of the first axis lies.
    pub(super) fn left(&self, x: f64) -> f64 {
        LEFT + self.x.share(x) * (WIDTH - LEFT - RIGHT)
    }

    /// Where a value of the second axis lies.
    pub(super) fn top(&self, y: f64) -> f64 {
        HEIGHT - BOTTOM - self.y.share(y) * (HEIGHT - TOP - BOTTOM)
    }

    /// The points of a line, as SVG has them.
    pub(super) fn line(&self, points: impl Iterator<Item = (f64, f64)>) -> String {
        let points: Vec<_> = points
            .map(|(x, y)| format!("{:.1},{:.1}", self.left(x), self.top(y)))
            .collect();
        points.join(" ")
    }

    /// The drawing with its axes. `label` says what is to be seen.
    pub(super) fn draw(&self, label: &str, content: &Markup) -> Markup {
        let (bottom, right) = (HEIGHT - BOTTOM, WIDTH - RIGHT);
        html! {
            svg .plot viewBox=(format!("0 0 {WIDTH} {HEIGHT}")) role="img" aria-label=(label) xmlns="http://www.w3.org/2000/svg" {
                @for (tick, text) in self.x.ticks() {
                    @let at = format!("{:.1}", self.left(tick));
                    line .grid x1=(at) x2=(at) y1=(TOP) y2=(bottom) {}
                    text x=(at) y=(bottom + 16.0) text-anchor="middle" { (text) }
                }
                @for (tick, text) in self.y.ticks() {
                    @let at = format!("{:.1}", self.top(tick));
                    line .grid x1=(LEFT) x2=(right) y1=(at) y2=(at) {}
                    text x=(LEFT - 6.0) y=(format!("{:.1}", self.top(tick) + 4.0)) text-anchor="end" { (text) }
                }
                text x=((LEFT + right) / 2.0) y=(HEIGHT - 6.0) text-anchor="middle" { (self.x.name) }
                text x="14" y=((TOP + bottom) / 2.0) text-anchor="middle"
                    transform=(format!("rotate(-90 14 {})", (TOP + bottom) / 2.0)) { (self.y.name) }
                (content)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ticks(range: Range<f64>) -> Vec<String> {
        Axis::from("x", range)
            .ticks()
            .into_iter()
            .map(|(_, text)| text)
            .collect()
    }

    #[test]
    fn the_numbers_on_an_axis_are_round_and_within() {
        assert_eq!(ticks(0.0..1.0), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert_eq!(ticks(0.1171..0.1243), ["0.118", "0.120", "0.122", "0.124"]);
        assert_eq!(ticks(-3.0..40.0), ["0", "10", "20", "30", "40"]);
        assert_eq!(ticks(1.0..1.0), Vec::<String>::new());
    }

    #[test]
    fn a_sample_of_one_value_has_a_range_around_it() {
        let axis = Axis::around("x", [0.12].into_iter()).unwrap();
        assert!(axis.range.start < 0.12 && 0.12 < axis.range.end);
        assert!(Axis::around("x", [f64::NAN].into_iter()).is_none());
    }

    #[test]
    fn the_corners_of_the_ranges_are_those_of_the_drawing() {
        let plot = Plot {
            x: Axis::from("x", 0.0..2.0),
            y: Axis::from("y", 0.0..1.0),
        };
        assert_eq!((plot.left(0.0), plot.top(0.0)), (LEFT, HEIGHT - BOTTOM));
        assert_eq!((plot.left(2.0), plot.top(1.0)), (WIDTH - RIGHT, TOP));
    }
}
