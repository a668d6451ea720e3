//! How much of a difference of two scenarios goes with a difference in another quantity (Kitagawa, *Components of a Difference
//! Between Two Rates*, 1955), by the slope that the one has on the other within windows. The main type is [`ExplainedPart`]. It is what
//! goes with it, and not what is caused by it.
//!
//! With b the slope over all windows, each around its own means, and d the difference of the means of window means, the explained part is
//! b · d, and its variance d² V(b) + b² V(d) to the first order (Goodman, *On the Exact Variance of Products*, 1960). V(b) is that of
//! Arellano, *Computing Robust Standard Errors for Within-Groups Estimators*, 1987, with a window as a group: values of one window
//! may depend on each other in any way. V(d) = s²_a/n + s²_b/m. Student's quantile has Satterthwaite's degrees of freedom, of one less than
//! there are windows for b and one less than the smaller side has for d.

use rayon::prelude::*;

use crate::{
    effect::{CONFIDENCE, Estimate, Interval, student_quantile},
    noise_model::Noise,
};

/// What a window says of a quantity x and of what goes with it, y: sums of squares and products around its means.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WindowSums {
    /// The mean of x.
    pub mean: f64,
    /// Of x.
    pub x_squares: f64,
    /// Of y.
    pub y_squares: f64,
    /// Of both.
    pub products: f64,
}

impl WindowSums {
    /// Those of the values x and y of a window; none of none.
    #[must_use]
    pub fn of(values: &[(f64, f64)]) -> Option<Self> {
        let mean_x = mean(values.iter().map(|(x, _)| *x))?;
        let mean_y = mean(values.iter().map(|(_, y)| *y))?;
        let mut sums = Self {
            mean: mean_x,
            x_squares: 0.0,
            y_squares: 0.0,
            products: 0.0,
        };
        for (x, y) in values {
            let (x, y) = (x - mean_x, y - mean_y);
            sums.x_squares += x * x;
            sums.y_squares += y * y;
            sums.products += x * y;
        }
        Some(sums)
    }
}

/// What goes with the difference in x.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExplainedPart {
    /// Mean of the second scenario's window means of x less that of the first's.
    pub difference: f64,
    /// Correlation of x and y within windows.
    pub correlation: f64,
    /// y for one unit of x, within windows.
    pub slope: f64,
    /// Slope times difference, in the unit of y.
    pub part: Estimate,
}

impl ExplainedPart {
    /// That of two scenarios; none if one has no window, or x or y is the same throughout each window. It has an interval from two
    /// windows a side on.
    #[must_use]
    pub fn of(a: &[WindowSums], b: &[WindowSums]) -> Option<Self> {
        let all = || a.iter().chain(b);
        let sum = |of: fn(&WindowSums) -> f64| all().map(of).sum::<f64>();
        let (xx, yy, xy) = (
            sum(|it| it.x_squares),
            sum(|it| it.y_squares),
            sum(|it| it.products),
        );
        let [first, second] = [a, b].map(|side| mean(side.iter().map(|it| it.mean)));
        let difference = second? - first?;
        if xx <= 0.0 || yy <= 0.0 {
            return None;
        }
        let slope = xy / xx;
        let scores: f64 = all().map(|it| (it.products - slope * it.x_squares).powi(2)).sum();
        let windows = (a.len() + b.len()) as f64;
        let of_slope = windows / (windows - 1.0) * scores / (xx * xx);
        Some(Self {
            difference,
            correlation: xy / (xx * yy).sqrt(),
            slope,
            part: Estimate {
                value: slope * difference,
                interval: variance_of_mean(a)
                    .zip(variance_of_mean(b))
                    .and_then(|(of_a, of_b)| {
                        // Each with its degrees of freedom.
                        let terms = [
                            (difference * difference * of_slope, windows - 1.0),
                            (slope * slope * (of_a + of_b), a.len().min(b.len()) as f64 - 1.0),
                        ];
                        interval(slope * difference, terms)
                    }),
            },
        })
    }
}

/// Around a value whose variance is the sum of these, which have so many degrees of freedom.
fn interval(value: f64, terms: [(f64, f64); 2]) -> Option<Interval> {
    let variance: f64 = terms.iter().map(|(variance, _)| variance).sum();
    let reach = match variance > 0.0 {
        true => {
            let shares = terms.map(|(variance, freedom)| variance * variance / freedom);
            let freedom = variance * variance / shares.iter().sum::<f64>();
            student_quantile(freedom, CONFIDENCE)? * variance.sqrt()
        }
        false => 0.0,
    };
    Some(Interval {
        low: value - reach,
        high: value + reach,
        confidence: CONFIDENCE,
    })
}

/// None of fewer than two windows, which say nothing of their spread.
fn variance_of_mean(windows: &[WindowSums]) -> Option<f64> {
    let count = windows.len() as f64;
    let centre = mean(windows.iter().map(|it| it.mean))?;
    let squares: f64 = windows.iter().map(|it| (it.mean - centre).powi(2)).sum();
    (windows.len() > 1).then(|| squares / (count - 1.0) / count)
}

/// None of none.
fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_u32), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

/// Two made-up scenarios whose explained part is known. x has standard deviation 1 within a window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Design {
    /// Windows of each.
    pub windows: [usize; 2],
    /// Standard deviation of the windows' means of x, for each.
    pub spread: [f64; 2],
    /// By how much the mean of x is larger in the second.
    pub difference: f64,
    /// The mean slope.
    pub slope: f64,
    /// Standard deviation of the windows' slopes.
    pub slope_spread: f64,
    /// Correlation of successive values, of x and of what y has beside it.
    pub phi: f64,
}

/// The designs whose coverage is told.
pub static DESIGNS: &[Design] = &[
    design([2, 2], [1.0, 1.0], 3.0, 1.0, 0.0, 0.0),
    design([3, 3], [1.0, 1.0], 3.0, 1.0, 0.0, 0.0),
    design([4, 4], [1.0, 1.0], 0.0, 1.0, 0.0, 0.0),
    design([4, 4], [1.0, 1.0], 3.0, 0.0, 0.0, 0.0),
    design([4, 4], [1.0, 1.0], 3.0, 1.0, 0.0, 0.0),
    design([4, 4], [0.0, 0.0], 3.0, 1.0, 0.0, 0.0),
    design([4, 4], [0.3, 0.3], 3.0, 1.0, 0.0, 0.7),
    design([4, 4], [0.3, 0.3], 3.0, 1.0, 0.5, 0.0),
    design([4, 4], [0.3, 3.0], 3.0, 1.0, 0.0, 0.0),
    design([4, 12], [3.0, 0.5], 3.0, 1.0, 0.0, 0.0),
    design([3, 10], [0.3, 0.3], 3.0, 1.0, 0.0, 0.7),
    design([8, 8], [1.0, 1.0], 3.0, 1.0, 0.0, 0.5),
];

const fn design(
    windows: [usize; 2],
    spread: [f64; 2],
    difference: f64,
    slope: f64,
    slope_spread: f64,
    phi: f64,
) -> Design {
    Design {
        windows,
        spread,
        difference,
        slope,
        slope_spread,
        phi,
    }
}

/// Values in a made-up window.
const VALUES: usize = 60;

impl Design {
    /// The share of made-up pairs whose interval has the explained part in it.
    #[must_use]
    pub fn coverage(&self, repetitions: usize, seed: u64) -> f64 {
        let covers = |repetition: usize| {
            let mut noise = Noise::new(seed.wrapping_add((repetition as u64) << 20));
            let sides = [0, 1].map(|side| self.side(side, &mut noise));
            let [a, b] = &sides;
            let truth = self.slope * self.difference;
            let interval = ExplainedPart::of(a, b).and_then(|it| it.part.interval);
            interval.is_some_and(|it| it.low <= truth && truth <= it.high)
        };
        let covered = (0..repetitions).into_par_iter().filter(|it| covers(*it));
        covered.count() as f64 / repetitions as f64
    }

    fn side(&self, side: usize, noise: &mut Noise) -> Vec<WindowSums> {
        let (windows, spread) = match side {
            0 => (self.windows[0], self.spread[0]),
            _ => (self.windows[1], self.spread[1]),
        };
        let centre = self.difference * side as f64;
        let mut window = |_| {
            let mean = centre + spread * noise.normal();
            let slope = self.slope + self.slope_spread * noise.normal();
            let (x, beside) = (noise.ar1(VALUES, self.phi), noise.ar1(VALUES, self.phi));
            let values = x.iter().zip(beside).map(|(x, beside)| {
                let x = mean + x;
                (x, slope * x + beside)
            });
            WindowSums::of(&values.collect::<Vec<_>>())
        };
        (0..windows).filter_map(&mut window).collect()
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    fn sums(values: &[(f64, f64)]) -> WindowSums {
        WindowSums::of(values).unwrap()
    }

    #[test]
    fn the_example_of_the_docs() {
        let a = [[(20.0, 10.0), (22.0, 11.0)], [(21.0, 10.0), (23.0, 12.0)]].map(|it| sums(&it));
        let b = [[(30.0, 16.0), (32.0, 17.0)], [(33.0, 16.0), (35.0, 18.0)]].map(|it| sums(&it));
        let found = ExplainedPart::of(&a, &b).unwrap();
        assert!((found.slope - 0.75).abs() < 1e-12, "{found:?}");
        assert!((found.difference - 11.0).abs() < 1e-12, "{found:?}");
        assert!((found.part.value - 8.25).abs() < 1e-12, "{found:?}");
        // V(b) = 4/3 · (4 · 0.5²) / 8² and V(d) = (0.5 + 4.5) / 2.
        let [of_slope, of_difference] = [121.0_f64 * (4.0 / 3.0) / 64.0, 0.5625 * 2.5];
        let freedom = (of_slope + of_difference).powi(2) / (of_slope.powi(2) / 3.0 + of_difference.powi(2));
        let reach = student_quantile(freedom, 0.95).unwrap() * (of_slope + of_difference).sqrt();
        let interval = found.part.interval.unwrap();
        assert!((interval.low - (8.25 - reach)).abs() < 1e-9, "{found:?}");
        assert!((interval.high - (8.25 + reach)).abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn a_side_of_one_window_has_no_interval_and_what_never_varies_no_part() {
        let one = sums(&[(1.0, 2.0), (2.0, 3.0)]);
        let found = ExplainedPart::of(&[one], &[one, one]).unwrap();
        assert_eq!(found.part.interval, None);
        assert_eq!(found.part.value, 0.0);
        let constant = sums(&[(1.0, 2.0), (1.0, 3.0)]);
        assert_eq!(ExplainedPart::of(&[constant], &[constant]), None);
        assert_eq!(ExplainedPart::of(&[one], &[]), None);
        assert_eq!(WindowSums::of(&[]), None);
    }

    #[rstest]
    #[case::two_windows(0)]
    #[case::no_slope(3)]
    #[case::the_slope_alone_is_uncertain(5)]
    #[case::values_that_depend_on_each_other(6)]
    #[case::slopes_that_differ(7)]
    #[case::unequal_numbers_and_spreads(9)]
    fn intervals_cover_what_they_say(#[case] nth: usize) {
        // 2.6 standard errors of a share of 0.95, of 1000.
        let covered = DESIGNS[nth].coverage(1_000, 5);
        assert!(covered >= 0.95 - 0.018, "{covered}");
    }
}
