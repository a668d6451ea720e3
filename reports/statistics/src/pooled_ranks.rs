//! The values of some windows in one order, each with the window that it is from: what statistics on distributions walk
//! along, again and again with the windows permuted, without sorting again. The main type is [`PooledRanks`].

/// Values in ascending order. Sorting is the only work of more than one pass.
#[derive(Debug, Clone, PartialEq)]
pub struct PooledRanks {
    values: Vec<f64>,
    /// The place of each value's window.
    windows: Vec<usize>,
    /// Values in each window.
    sizes: Vec<usize>,
}

impl PooledRanks {
    /// Merges windows; values that are not numbers have no place in an order and are left out.
    #[must_use]
    pub fn of(windows: &[&[f64]]) -> Self {
        let mut pairs: Vec<(f64, usize)> = windows
            .iter()
            .enumerate()
            .flat_map(|(window, values)| values.iter().map(move |value| (*value, window)))
            .filter(|(value, _)| !value.is_nan())
            .collect();
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut sizes = vec![0; windows.len()];
        for (_, window) in &pairs {
            sizes[*window] += 1;
        }
        let (values, windows) = pairs.into_iter().unzip();
        Self {
            values,
            windows,
            sizes,
        }
    }

    /// How many values there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// How many values each window has.
    #[must_use]
    pub fn sizes(&self) -> &[usize] {
        &self.sizes
    }

    /// Each distinct value in ascending order, with the windows that it occurs in, once for each time.
    pub fn distinct(&self) -> impl Iterator<Item = (f64, &[usize])> {
        let mut start = 0;
        self.values.chunk_by(|a, b| a == b).map(move |equal| {
            let windows = &self.windows[start..start + equal.len()];
            start += equal.len();
            (equal[0], windows)
        })
    }

    /// ∫ |F − G|, the Wasserstein-1 distance, and max |F − G|, the Kolmogorov-Smirnov distance, of two weighted
    /// distributions: `weight` gives each window's value its share, positive in F and negative in G.
    #[must_use]
    pub fn distances(&self, weight: &[f64]) -> Distances {
        let mut distances = Distances::default();
        let mut gap = 0.0_f64;
        let mut before: Option<f64> = None;
        for (value, windows) in self.distinct() {
            if let Some(before) = before {
                distances.wasserstein += gap.abs() * (value - before);
            }
            gap += windows.iter().map(|window| weight[*window]).sum::<f64>();
            distances.kolmogorov = distances.kolmogorov.max(gap.abs());
            before = Some(value);
        }
        distances
    }
}

/// Two distances between two distributions.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Distances {
    /// ∫ |F − G|, in the unit of the values.
    pub wasserstein: f64,
    /// max |F − G|.
    pub kolmogorov: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_values_come_together_with_the_windows_they_are_from() {
        let merged = PooledRanks::of(&[&[2.0, 1.0], &[2.0, f64::NAN], &[]]);
        let distinct: Vec<(f64, Vec<usize>)> = merged.distinct().map(|(v, w)| (v, w.to_vec())).collect();
        assert_eq!(distinct, [(1.0, vec![0]), (2.0, vec![0, 1])]);
        assert_eq!((merged.len(), merged.sizes()), (3, &[2, 1, 0][..]));
    }

    // Expected: scipy.stats.wasserstein_distance([0, 1, 3], [5, 6, 8]) and ks_2samp of the same.
    #[test]
    fn distances_are_those_of_scipy() {
        let merged = PooledRanks::of(&[&[0.0, 1.0, 3.0], &[5.0, 6.0, 8.0]]);
        let distances = merged.distances(&[1.0 / 3.0, -1.0 / 3.0]);
        assert!((distances.wasserstein - 5.0).abs() < 1e-12 && (distances.kolmogorov - 1.0).abs() < 1e-12);
    }
}
