//! p-values adjusted for how many there are. The main functions are [`holm`] and [`benjamini_yekutieli`]; both hold
//! whatever the tests have to do with each other, and pairs of scenarios do share scenarios.

/// Holm's step-down adjustment (1979): the probability of one false rejection or more in the family is at most the level.
#[must_use]
pub fn holm(p: &[f64]) -> Vec<f64> {
    let count = p.len();
    let mut adjusted = vec![1.0; count];
    let mut largest = 0.0_f64;
    for (rank, at) in ascending(p).into_iter().enumerate() {
        largest = largest.max((count - rank) as f64 * p[at]);
        adjusted[at] = largest.min(1.0);
    }
    adjusted
}

/// Benjamini and Yekutieli's step-up adjustment (2001): of the rejections, the expected share of false ones is at most
/// the level, under any dependence.
#[must_use]
pub fn benjamini_yekutieli(p: &[f64]) -> Vec<f64> {
    let count = p.len();
    let harmonic: f64 = (1..=count).map(|k| 1.0 / k as f64).sum();
    let mut adjusted = vec![1.0; count];
    let mut smallest = 1.0_f64;
    for (rank, at) in ascending(p).into_iter().enumerate().rev() {
        smallest = smallest.min(harmonic * count as f64 / (rank + 1) as f64 * p[at]);
        adjusted[at] = smallest;
    }
    adjusted
}

fn ascending(p: &[f64]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|a, b| p[*a].total_cmp(&p[*b]));
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    // Expected: statsmodels.stats.multitest.multipletests, methods "holm" and "fdr_by"; reports/statistics/tests/data/window_tests.py.
    const RAW: [f64; 7] = [0.01, 0.04, 0.03, 0.005, 0.5, 0.04, 1.0];

    fn close(left: &[f64], right: &[f64]) {
        assert_eq!(left.len(), right.len());
        for (left, right) in left.iter().zip(right) {
            assert!((left - right).abs() < 1e-12, "{left} {right}");
        }
    }

    #[test]
    fn holm_is_that_of_statsmodels() {
        close(&holm(&RAW), &[0.06, 0.16, 0.15, 0.035, 1.0, 0.16, 1.0]);
    }

    #[test]
    fn benjamini_yekutieli_is_that_of_statsmodels() {
        close(
            &benjamini_yekutieli(&RAW),
            &[0.09075, 0.1452, 0.1452, 0.09075, 1.0, 0.1452, 1.0],
        );
    }

    #[test]
    fn one_test_is_not_adjusted_and_none_gives_none() {
        close(&holm(&[0.02]), &[0.02]);
        close(&benjamini_yekutieli(&[0.02]), &[0.02]);
        assert!(holm(&[]).is_empty() && benjamini_yekutieli(&[]).is_empty());
    }

    #[test]
    fn equal_p_values_stay_equal() {
        close(&holm(&[0.01; 3]), &[0.03; 3]);
    }
}
