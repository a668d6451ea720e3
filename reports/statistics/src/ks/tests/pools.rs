//! All pairs of many samples.

use proptest::prelude::*;
use record::report_settings::Method;

use crate::ks::{Alternative, Pool, Procedure};

fn procedures() -> impl Iterator<Item = Procedure> {
    Method::ALL.into_iter().flat_map(|method| {
        Alternative::ALL
            .into_iter()
            .map(move |alternative| Procedure { method, alternative })
    })
}

/// Every pair of the pool is to the bit the test of those two alone.
fn assert_pairs_are_single_tests(samples: &[Vec<f64>]) {
    let pool = Pool::of(samples).unwrap();
    for procedure in procedures() {
        let rows = pool.pairs(procedure, |_, partners| partners.collect::<Vec<_>>());
        assert_eq!(rows.len(), samples.len());
        for (a, row) in rows.into_iter().enumerate() {
            assert_eq!(row.len(), samples.len() - 1 - a);
            for ((b, test), expected_b) in row.into_iter().zip(a + 1..) {
                assert_eq!(b, expected_b);
                let alone = procedure.test(&samples[a], &samples[b]).unwrap();
                assert_eq!(test, alone);
                assert_eq!(
                    (test.p.to_bits(), test.log10_p.to_bits()),
                    (alone.p.to_bits(), alone.log10_p.to_bits())
                );
            }
        }
    }
}

#[test]
fn nothing_and_one_sample_have_no_pairs() {
    let none: [&[f64]; 0] = [];
    assert!(Pool::of(&none).unwrap().is_empty());
    let one = Pool::of(&[[1.0, 2.0]]).unwrap();
    assert_eq!(
        one.pairs(Procedure::default(), |_, partners| partners.count()),
        [0]
    );
}

#[test]
fn a_sample_that_cannot_be_ordered_is_named() {
    let samples: [&[f64]; 3] = [&[1.0], &[2.0], &[]];
    assert_eq!(
        Pool::of(&samples).unwrap_err().to_string(),
        "the 3. sample is empty"
    );
}

#[test]
fn zero_has_no_sign() {
    let test = Procedure::default().test(&[-0.0, 1.0], &[0.0, 1.0]).unwrap();
    assert_eq!((test.h, test.p, test.signed_d()), (0, 1.0, (0.0, None)));
}

/// Sizes whose distances do not go into 64 bits together with their places.
#[test]
fn very_large_samples_of_unlike_sizes_have_exact_distances() {
    let (n, m) = (2_200_000_u32, 2_199_999_u32);
    let x: Vec<f64> = (0..n).map(f64::from).collect();
    let y: Vec<f64> = (0..m).map(|i| f64::from(i) + 1_000_000.5).collect();
    let procedure = Procedure {
        method: Method::Asymptotic,
        ..Procedure::default()
    };
    let test = procedure.test(&x, &y).unwrap();
    // 1 000 001 of the first's values lie below the second's smallest.
    assert_eq!(
        (test.h, test.lcm),
        (1_000_001 * u64::from(m), u64::from(n) * u64::from(m))
    );
    assert_eq!((test.above.at, test.below.h), (Some(1_000_000.0), 0));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn pairs_are_single_tests_without_ties(
        samples in prop::collection::vec(prop::collection::vec(-1.0..1.0_f64, 1..30), 0..8)
    ) {
        assert_pairs_are_single_tests(&samples);
    }

    #[test]
    fn pairs_are_single_tests_with_ties(
        samples in prop::collection::vec(prop::collection::vec((-9..9_i32).prop_map(f64::from), 1..30), 0..8)
    ) {
        assert_pairs_are_single_tests(&samples);
    }

    #[test]
    fn a_place_is_where_the_distribution_functions_are_that_far_apart(
        x in prop::collection::vec((-9..9_i32).prop_map(f64::from), 1..30),
        y in prop::collection::vec((-9..9_i32).prop_map(f64::from), 1..30),
    ) {
        let test = Procedure::default().test(&x, &y).unwrap();
        let share = |of: &[f64], at: f64| of.iter().filter(|value| **value <= at).count() as u64 * (test.lcm / of.len() as u64);
        let above = |at: f64| share(&x, at) as i64 - share(&y, at) as i64;
        let pooled = || x.iter().chain(&y).copied();
        for (gap, sign) in [(test.above, 1), (test.below, -1)] {
            let largest = pooled().map(|at| sign * above(at)).max().unwrap().max(0);
            prop_assert_eq!(gap.h as i64, largest);
            let first = pooled().filter(|at| sign * above(*at) == largest).min_by(f64::total_cmp);
            prop_assert_eq!(gap.at, first.filter(|_| largest > 0));
        }
    }
}
