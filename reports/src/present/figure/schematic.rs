//! Boxes, arrows and words of a schematic drawing, all in points. The main type is [`Schematic`].

use plotters::{
    element::Circle,
    element::{PathElement, Polygon, Rectangle, Text},
    style::{
        BLACK, Color, RGBColor, WHITE,
        text_anchor::{HPos, VPos},
    },
};

use super::canvas::{Area, DASH_PT, DrawingError, LETTERS_PT, SMALL_PT, anchored, line, pt};
use crate::{
    input::run::{Run, ScenarioRun},
    present::listing::listed,
};

/// A place on the drawing, from the upper left corner.
pub(super) type At = (f64, f64);

const LINE_PT: f64 = 0.75;
/// Of a line of words.
const LEADING_PT: f64 = 9.5;
const ARROW_PT: f64 = 5.0;
const SHADE: RGBColor = RGBColor(238, 243, 248);

/// A drawing of boxes and arrows.
pub(super) struct Schematic<'a, 'b>(pub(super) &'b Area<'a>);

impl Schematic<'_, '_> {
    /// A box about its middle with lines of words in it.
    pub(super) fn labelled(
        &self,
        middle: At,
        (width, height): (f64, f64),
        words: &[&str],
    ) -> Result<(), DrawingError> {
        let (x, y) = middle;
        let corners = [
            (pt(x - width / 2.0), pt(y - height / 2.0)),
            (pt(x + width / 2.0), pt(y + height / 2.0)),
        ];
        self.0.draw(&Rectangle::new(corners, SHADE.filled()))?;
        self.0.draw(&Rectangle::new(corners, line(BLACK, LINE_PT)))?;
        let top = y - LEADING_PT * (words.len() as f64 - 1.0) / 2.0;
        for (index, words) in words.iter().enumerate() {
            self.words((x, top + LEADING_PT * index as f64), HPos::Center, words)?;
        }
        Ok(())
    }

    /// One line of words, which stands in the middle of its height.
    pub(super) fn words(&self, (x, y): At, side: HPos, words: &str) -> Result<(), DrawingError> {
        let style = anchored(LETTERS_PT, side, VPos::Center);
        self.0.draw(&Text::new(words.to_owned(), (pt(x), pt(y)), style))
    }

    /// A sign with a raised one behind it, about a place.
    pub(super) fn raised(&self, (x, y): At, sign: &str, raised: &str) -> Result<(), DrawingError> {
        let base = anchored(LETTERS_PT + 1.0, HPos::Right, VPos::Center);
        self.0
            .draw(&Text::new(sign.to_owned(), (pt(x - 2.0), pt(y)), base))?;
        let small = anchored(SMALL_PT, HPos::Left, VPos::Center);
        self.0
            .draw(&Text::new(raised.to_owned(), (pt(x - 1.5), pt(y - 3.5)), small))
    }

    /// A line along these places.
    pub(super) fn path(&self, places: &[At]) -> Result<(), DrawingError> {
        let places: Vec<(i32, i32)> = places.iter().map(|(x, y)| (pt(*x), pt(*y))).collect();
        self.0.draw(&PathElement::new(places, line(BLACK, LINE_PT)))
    }

    /// A dashed line from one place down or up to another.
    pub(super) fn dashed(&self, x: f64, from: f64, to: f64) -> Result<(), DrawingError> {
        let (dash, gap) = DASH_PT;
        let mut y = from;
        while y < to {
            self.path(&[(x, y), (x, (y + dash).min(to))])?;
            y += dash + gap;
        }
        Ok(())
    }

    /// A line along these places with a head at the last.
    pub(super) fn arrow(&self, places: &[At]) -> Result<(), DrawingError> {
        self.path(places)?;
        let &[.., (x0, y0), (x, y)] = places else {
            return Ok(());
        };
        let length = (x - x0).hypot(y - y0).max(f64::MIN_POSITIVE);
        let (along_x, along_y) = ((x - x0) / length * ARROW_PT, (y - y0) / length * ARROW_PT);
        let foot = (x - along_x, y - along_y);
        let side = (-along_y * 0.4, along_x * 0.4);
        let corners = [
            (pt(x), pt(y)),
            (pt(foot.0 + side.0), pt(foot.1 + side.1)),
            (pt(foot.0 - side.0), pt(foot.1 - side.1)),
        ];
        self.0.draw(&Polygon::new(corners, BLACK.filled()))
    }

    /// A circle in which signals are added up.
    pub(super) fn sum(&self, (x, y): At, radius: f64) -> Result<(), DrawingError> {
        self.0
            .draw(&Circle::new((pt(x), pt(y)), pt(radius), WHITE.filled()))?;
        self.0
            .draw(&Circle::new((pt(x), pt(y)), pt(radius), line(BLACK, LINE_PT)))
    }
}

/// The scenarios that have data, those that are alike in what is drawn together, each group by its first.
pub(super) fn alike<'a, K: PartialEq>(
    scenarios: impl Iterator<Item = &'a ScenarioRun>,
    key: impl Fn(&'a ScenarioRun) -> K,
) -> Vec<(K, Vec<&'a ScenarioRun>)> {
    let mut groups: Vec<(K, Vec<&ScenarioRun>)> = Vec::new();
    for scenario in scenarios.filter(|it| it.counted().next().is_some()) {
        let key = key(scenario);
        match groups.iter_mut().find(|(known, _)| *known == key) {
            Some((_, group)) => group.push(scenario),
            None => groups.push((key, vec![scenario])),
        }
    }
    groups
}

/// Drawings of one kind that differ in a value. A sweep of hundreds has no use for one of each.
pub(super) const MOST_DRAWN: usize = 24;

/// What the caption of the drawing of this number, from 0, says of those that are not drawn.
pub(super) fn not_drawn(number: usize, of: usize) -> String {
    match of.checked_sub(MOST_DRAWN) {
        Some(more @ 1..) if number + 1 == MOST_DRAWN => {
            format!(" The run has {more} more like it with other values, which are not drawn.")
        }
        _ => String::new(),
    }
}

/// The scenarios that measure the ball on the plate, whose parts are known.
pub(super) fn of_the_ball(run: &Run) -> impl Iterator<Item = &ScenarioRun> {
    let scenarios = run.scenarios.iter();
    scenarios.filter(|scenario| scenario.planned.settings.experiment.is_none())
}

/// The letters of scenarios, in a sentence.
pub(super) fn letters_of(group: &[&ScenarioRun]) -> String {
    let letters: Vec<&str> = group
        .iter()
        .map(|scenario| scenario.planned.id.as_str())
        .collect();
    let noun = if group.len() == 1 { "Scenario" } else { "Scenarios" };
    format!("{noun} {}", listed(&letters))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_of_too_many_drawings_says_how_many_are_left_out() {
        assert_eq!(not_drawn(MOST_DRAWN - 1, MOST_DRAWN), "");
        assert_eq!(not_drawn(0, MOST_DRAWN + 6), "");
        assert!(not_drawn(MOST_DRAWN - 1, MOST_DRAWN + 6).contains("6 more"));
    }
}
