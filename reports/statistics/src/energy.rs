//! The energy distance of Székely and Rizzo (*Energy statistics: a class of statistics based on distances*, 2013): zero
//! only where two distributions are the same, so that it sees shift, spread and shape alike. The main type is
//! [`WindowDistances`].
//!
//! ```text
//! 2 E|X − Y| − E|X − X'| − E|Y − Y'|
//! ```
//!
//! with all pairs of values counted, a value with itself too, as in `scipy.stats.energy_distance`, which is the root of
//! it. The sums of distances between the windows are taken once; a permutation of the windows then costs a sum over windows.

/// Σ |x − y| over the values of each two windows.
#[derive(Debug, Clone, PartialEq)]
pub struct WindowDistances {
    sums: Vec<Vec<f64>>,
    sizes: Vec<f64>,
}

impl WindowDistances {
    /// That of some windows.
    #[must_use]
    pub fn of(windows: &[&[f64]]) -> Self {
        let sorted: Vec<Vec<f64>> = windows
            .iter()
            .map(|window| {
                let mut values = window.to_vec();
                values.sort_by(f64::total_cmp);
                values
            })
            .collect();
        let sums = sorted
            .iter()
            .map(|a| sorted.iter().map(|b| sum_of_distances(a, b)).collect())
            .collect();
        Self {
            sums,
            sizes: windows.iter().map(|window| window.len() as f64).collect(),
        }
    }

    /// The energy distance, not its root, of the windows labelled 0 and those labelled 1; 0 where a side is empty.
    #[must_use]
    pub fn energy(&self, labels: &[usize]) -> f64 {
        let mut between = [[0.0; 2]; 2];
        let mut sizes = [0.0; 2];
        for ((label, size), row) in labels.iter().zip(&self.sizes).zip(&self.sums) {
            let one = usize::from(*label == 1);
            sizes[one] += size;
            for (other, sum) in labels.iter().zip(row) {
                between[one][usize::from(*other == 1)] += sum;
            }
        }
        let [n, m] = sizes;
        if n == 0.0 || m == 0.0 {
            return 0.0;
        }
        // Never negative but for rounding.
        (2.0 * between[0][1] / (n * m) - between[0][0] / (n * n) - between[1][1] / (m * m)).max(0.0)
    }
}

/// Σ |x − y| over two sorted samples, in one pass: each y stands above some x and below the others.
fn sum_of_distances(xs: &[f64], ys: &[f64]) -> f64 {
    let all: f64 = xs.iter().sum();
    let mut below = 0.0;
    let mut count = 0_usize;
    let mut rest = xs.iter().peekable();
    let mut sum = 0.0;
    for y in ys {
        while let Some(x) = rest.next_if(|x| *x <= y) {
            below += x;
            count += 1;
        }
        sum += count as f64 * y - below + (all - below) - (xs.len() - count) as f64 * y;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    // Expected: scipy.stats.energy_distance([0, 8], [0, 8], [3, 1], [2, 2]) = 1.0000000000000002 and of the samples below,
    // squared; reports/statistics/tests/data/window_tests.py.
    #[test]
    fn it_is_scipys_squared() {
        let of = |x: &[f64], y: &[f64]| WindowDistances::of(&[x, y]).energy(&[0, 1]);
        let (x, y) = ([0.0, 0.0, 0.0, 8.0], [0.0, 0.0, 8.0, 8.0]);
        assert!((of(&x, &y) - 1.0).abs() < 1e-12, "{}", of(&x, &y));
        assert!((of(&[1.0, 2.0], &[4.0]) - 4.5).abs() < 1e-12);
    }

    #[test]
    fn identical_samples_have_none() {
        let x = [0.1, 0.5, 0.7];
        assert_eq!(WindowDistances::of(&[&x, &x]).energy(&[0, 1]), 0.0);
        assert_eq!(WindowDistances::of(&[&x]).energy(&[0]), 0.0);
    }

    #[test]
    fn windows_count_by_their_values_wherever_they_are_dealt() {
        let windows: [&[f64]; 4] = [&[1.0, 2.0], &[3.0], &[4.0, 9.0, 5.0], &[0.5]];
        let permuted = WindowDistances::of(&windows).energy(&[1, 0, 1, 0]);
        let pooled = WindowDistances::of(&[&[3.0, 0.5], &[1.0, 2.0, 4.0, 9.0, 5.0]]).energy(&[0, 1]);
        assert!((permuted - pooled).abs() < 1e-12);
    }
}
