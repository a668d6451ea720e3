//! The k-sample Anderson-Darling statistic of Scholz and Stephens (*K-Sample Anderson-Darling Tests*, JASA 82, 1987), for
//! distributions with ties (their A²_akN, equation 7). It weighs the tails, where the Kolmogorov-Smirnov distance hardly
//! moves, and so finds differences of spread. The main function is [`standardised`].
//!
//! ```text
//! A² = (N − 1)/N Σᵢ 1/nᵢ Σⱼ lⱼ/N · (N Mᵢⱼ − nᵢ Bⱼ)² / (Bⱼ (N − Bⱼ) − N lⱼ/4)
//! ```
//!
//! over the distinct values j, of which there are lⱼ; Bⱼ counts the values below and half of those at j, Mᵢⱼ those of
//! sample i. Standardised, (A² − (k − 1)) / σ_N, it is comparable where sizes differ.

use crate::pooled_ranks::PooledRanks;

/// The standardised statistic of `k` samples, given the sample of each window; none where a sample is empty, where there
/// are fewer than four values, or where all values are equal, so that there is nothing to weigh.
#[must_use]
pub fn standardised(merged: &PooledRanks, labels: &[usize], k: usize) -> Option<f64> {
    let mut sizes = vec![0.0; k];
    for (label, size) in labels.iter().zip(merged.sizes()) {
        *sizes.get_mut(*label)? += *size as f64;
    }
    let total = merged.len() as f64;
    if total < 4.0 || k < 2 || sizes.contains(&0.0) {
        return None;
    }
    let mut below = vec![0.0; k];
    let mut here = vec![0.0; k];
    let mut below_all = 0.0;
    let mut sum = 0.0;
    let mut distinct = 0;
    for (_, windows) in merged.distinct() {
        here.fill(0.0);
        for window in windows {
            *here.get_mut(*labels.get(*window)?)? += 1.0;
        }
        let l = windows.len() as f64;
        let b = below_all + l / 2.0;
        let spread = b * (total - b) - total * l / 4.0;
        if spread > 0.0 {
            let of_samples: f64 = sizes
                .iter()
                .zip(below.iter().zip(&here))
                .map(|(n, (below, here))| (total * (below + here / 2.0) - n * b).powi(2) / n)
                .sum();
            sum += l / total * of_samples / spread;
        }
        for (below, here) in below.iter_mut().zip(&here) {
            *below += here;
        }
        below_all += l;
        distinct += 1;
    }
    if distinct < 2 {
        return None;
    }
    let a2 = (total - 1.0) / total * sum;
    Some((a2 - (k as f64 - 1.0)) / variance(&sizes).sqrt())
}

/// σ²_N of A² (equation 4).
fn variance(sizes: &[f64]) -> f64 {
    let k = sizes.len() as f64;
    let total: f64 = sizes.iter().sum();
    let count = total as usize;
    let of_sizes: f64 = sizes.iter().map(|n| 1.0 / n).sum();
    // h is the sum of 1/i for i below N, g that of 1/((N − i) j) for i < j below N.
    let mut h = 0.0;
    let mut g = 0.0;
    for i in (1..count).rev() {
        g += h / (total - i as f64);
        h += 1.0 / i as f64;
    }
    let a = (4.0 * g - 6.0) * (k - 1.0) + (10.0 - 6.0 * g) * of_sizes;
    let b = (2.0 * g - 4.0) * k * k + 8.0 * h * k + (2.0 * g - 14.0 * h - 4.0) * of_sizes - 8.0 * h + 4.0 * g
        - 6.0;
    let c = (6.0 * h + 2.0 * g - 2.0) * k * k
        + (4.0 * h - 4.0 * g + 6.0) * k
        + (2.0 * h - 6.0) * of_sizes
        + 4.0 * h;
    let d = (2.0 * h + 6.0) * k * k - 4.0 * h * k;
    (((a * total + b) * total + c) * total + d) / ((total - 1.0) * (total - 2.0) * (total - 3.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    // Expected: Scholz and Stephens 1987, table 4: smoothness of paper from four laboratories, which has ties. They give
    // a standardised 4.480 (A²_akN = 8.3926, σ_N = 1.2038).
    #[test]
    fn the_papers_example_has_the_papers_value() {
        let laboratories: [&[f64]; 4] = [
            &[38.7, 41.5, 43.8, 44.5, 45.5, 46.0, 47.7, 58.0],
            &[39.2, 39.3, 39.7, 41.4, 41.8, 42.9, 43.3, 45.8],
            &[34.0, 35.0, 39.0, 40.0, 43.0, 43.0, 44.0, 45.0],
            &[34.0, 34.8, 34.8, 35.4, 37.2, 37.8, 41.2, 42.8],
        ];
        let merged = PooledRanks::of(&laboratories);
        let statistic = standardised(&merged, &[0, 1, 2, 3], 4).unwrap();
        assert!((statistic - 4.480).abs() < 5e-4, "{statistic}");
    }

    #[test]
    fn where_there_is_nothing_to_weigh_there_is_no_statistic() {
        let of = |windows: &[&[f64]], k| {
            let labels: Vec<usize> = (0..windows.len()).collect();
            standardised(&PooledRanks::of(windows), &labels, k)
        };
        assert_eq!(of(&[&[1.0, 1.0], &[1.0, 1.0]], 2), None);
        assert_eq!(of(&[&[1.0, 2.0, 3.0, 4.0], &[]], 2), None);
        assert_eq!(of(&[&[1.0], &[2.0]], 2), None);
        assert_eq!(of(&[&[1.0, 2.0, 3.0, 4.0]], 1), None);
    }

    #[test]
    fn it_sees_a_spread_that_leaves_the_medians_alike() {
        let narrow: Vec<f64> = (-10..=10).map(|i| f64::from(i) / 100.0).collect();
        let wide: Vec<f64> = (-10..=10).map(|i| f64::from(i) / 10.0 + 0.001).collect();
        let merged = PooledRanks::of(&[&narrow, &wide]);
        assert!(standardised(&merged, &[0, 1], 2).unwrap() > 3.0);
    }
}
