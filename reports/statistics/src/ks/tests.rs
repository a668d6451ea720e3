mod limits;
mod pools;
mod published;

use std::collections::BTreeMap;

use proptest::prelude::*;
use rstest::rstest;

use super::{distance::Steps, limit::kolmogorov_tail, paths::Band, tails::Tail, *};

/// P(D ≥ h / lcm) without ties.
fn share_without_ties(n: usize, m: usize, h: u64) -> (f64, f64) {
    let tail = Tail::without_ties(Procedure::default(), n, m, h);
    (tail.p, tail.log10_p)
}

fn assert_close(found: f64, exact: f64, what: &str) {
    let relative = ((found - exact) / exact).abs();
    assert!(
        relative <= 1e-12,
        "{what}: {found:e} is {relative:e} off {exact:e}"
    );
}

#[test]
fn exact_values_without_ties_are_met() {
    let table = include_str!("../../tests/data/ks_exact.csv");
    let mut rows = 0;
    for row in table.lines().skip(1) {
        let fields: Vec<&str> = row.split(',').collect();
        let whole = |at: usize| fields[at].parse::<u64>().unwrap();
        let (n, m) = (whole(0) as usize, whole(1) as usize);
        assert_eq!(Steps::of(whole(0), whole(1)).of_x * whole(0), whole(3));
        let exact: f64 = fields[4].parse().unwrap();
        let (p, log10_p) = share_without_ties(n, m, whole(2));
        assert_close(p, exact, row);
        assert!((log10_p - exact.log10()).abs() < 1e-11, "{row}");
        rows += 1;
    }
    assert_eq!(rows, 24);
}

#[test]
fn exact_values_given_ties_are_met() {
    #[derive(serde::Deserialize)]
    struct Case {
        x: Vec<f64>,
        y: Vec<f64>,
        h: u64,
        lcm: u64,
        p_exact_given_ties: String,
    }
    let cases: Vec<Case> = serde_json::from_str(include_str!("../../tests/data/ks_ties.json")).unwrap();
    assert_eq!(cases.len(), 4);
    for case in cases {
        let result = test(&case.x, &case.y).unwrap();
        assert_eq!((result.h, result.lcm), (case.h, case.lcm));
        assert_close(result.p, case.p_exact_given_ties.parse().unwrap(), "ties");
    }
}

#[test]
fn the_logarithm_is_finite_where_the_p_value_underflows() {
    let low: Vec<f64> = (0..10_000).map(f64::from).collect();
    let high: Vec<f64> = low.iter().map(|value| value + 1e6).collect();
    let result = test(&low, &high).unwrap();
    assert_eq!((result.h, result.lcm, result.d), (10_000, 10_000, 1.0));
    assert_eq!((result.p, result.method), (0.0, Method::Exact));
    // 2 / C(20000, 10000), from the sum of the logarithms.
    let exact = 2_f64.log10()
        + (1..=10_000)
            .map(|i| (f64::from(i) / f64::from(10_000 + i)).log10())
            .sum::<f64>();
    assert!((exact - 8.906_f64.log10() + 6019.0).abs() < 1e-4, "{exact}");
    assert!((result.log10_p - exact).abs() < 1e-8, "{}", result.log10_p);
}

#[rstest]
#[case(21, false)]
#[case(22, true)]
fn at_sixty_values_a_side_the_limit_at_one_in_a_thousand_is_22_of_60(#[case] h: u64, #[case] rejected: bool) {
    assert_eq!(share_without_ties(60, 60, h).0 < 0.001, rejected);
}

#[test]
fn plain_and_scaled_numbers_agree_where_both_hold() {
    let ends: Vec<usize> = (1..=580).collect();
    let band = |h| Band::of(280, 300, h, Alternative::TwoSided);
    for h in [60, 600, 2100, 4100] {
        let (p, log10_p) = band(h).share_leaving(&ends);
        assert!((p.log10() - log10_p).abs() < 1e-12);
    }
}

#[rstest]
#[case(&[], &[1.0], "the first sample is empty")]
#[case(&[1.0], &[], "the second sample is empty")]
#[case(&[1.0], &[1.0, f64::NAN], "value 2 of the second sample is NaN, which has no place in an order")]
#[case(&[f64::INFINITY], &[1.0], "value 1 of the first sample is inf, which has no place in an order")]
fn samples_without_an_order_are_refused(#[case] x: &[f64], #[case] y: &[f64], #[case] message: &str) {
    assert_eq!(test(x, y).unwrap_err().to_string(), message);
}

#[rstest]
#[case(4, 4, 2.0 / 70.0)]
#[case(60, 60, 2.070_073_888_186_964e-35)]
#[case(1, 1, 1.0)]
#[case(3, 2, 0.2)]
#[case(0, 5, 1.0)]
fn the_smallest_attainable_p_is_that_of_disjoint_samples(#[case] n: usize, #[case] m: usize, #[case] p: f64) {
    assert_close(smallest_attainable_p(n, m), p, "smallest");
}

#[test]
fn kolmogorovs_limit_has_its_tabled_values() {
    // Smirnov (1948), Table for estimating the goodness of fit: 1 − L(λ).
    for (lambda, p) in [
        (0.5, 0.963_945),
        (0.8276, 0.500_0),
        (0.999_999, 0.270_0),
        (1.0, 0.270_0),
        (1.3581, 0.05),
    ] {
        let (found, log10_p) = kolmogorov_tail(lambda);
        assert!((found - p).abs() < 1e-4, "{lambda}: {found}");
        assert!((found.log10() - log10_p).abs() < 1e-12);
    }
    let (p, log10_p) = kolmogorov_tail(100.0);
    assert_eq!(p, 0.0);
    assert!((log10_p + 8685.588).abs() < 1e-2, "{log10_p}");
}

#[test]
fn samples_too_large_to_enumerate_say_that_they_were_compared_in_the_limit() {
    let low: Vec<f64> = (0..60_000).map(f64::from).collect();
    let high: Vec<f64> = low.iter().map(|value| value + 59_999.5).collect();
    let result = test(&low, &high).unwrap();
    assert_eq!(result.method, Method::Asymptotic);
    assert!((result.log10_p + 26_057.3).abs() < 0.1, "{}", result.log10_p);
}

/// All ways to deal the pooled values, counted one by one.
fn enumerated(x: &[f64], y: &[f64], alternative: Alternative) -> f64 {
    let pooled: Vec<f64> = x.iter().chain(y).copied().collect();
    let distance = |chosen: u32| {
        let (n, m) = (x.len() as i64, y.len() as i64);
        let mut sides: BTreeMap<i64, (i64, i64)> = BTreeMap::new();
        for (at, value) in pooled.iter().enumerate() {
            let side = sides.entry(*value as i64).or_default();
            if chosen >> at & 1 == 1 {
                side.0 += 1
            } else {
                side.1 += 1
            }
        }
        let (mut i, mut j, mut worst) = (0, 0, 0);
        for (more_x, more_y) in sides.values() {
            i += more_x;
            j += more_y;
            worst = worst.max(match alternative {
                Alternative::TwoSided => (i * m - j * n).abs(),
                Alternative::Greater => i * m - j * n,
                Alternative::Less => j * n - i * m,
            });
        }
        worst
    };
    let observed = distance((1 << x.len()) - 1);
    let deals = (0..1_u32 << pooled.len()).filter(|deal| deal.count_ones() as usize == x.len());
    let (mut all, mut far) = (0_u32, 0_u32);
    for deal in deals {
        all += 1;
        far += u32::from(distance(deal) >= observed);
    }
    f64::from(far) / f64::from(all)
}

fn assert_agrees_with_enumeration(x: &[f64], y: &[f64]) {
    for alternative in Alternative::ALL {
        let procedure = Procedure {
            alternative,
            ..Procedure::default()
        };
        let found = procedure.test(x, y).unwrap().p;
        let exact = enumerated(x, y, alternative);
        assert!(
            (found - exact).abs() <= 1e-13 * exact,
            "{alternative:?}: {found} {exact}"
        );
    }
}

fn small_sample(values: std::ops::Range<i32>) -> impl Strategy<Value = Vec<f64>> {
    prop::collection::vec(values.prop_map(f64::from), 1..=6)
}

proptest! {
    #[test]
    fn small_samples_with_ties_agree_with_enumeration(x in small_sample(0..5), y in small_sample(0..5)) {
        assert_agrees_with_enumeration(&x, &y);
    }

    #[test]
    fn small_samples_nearly_without_ties_agree_with_enumeration(x in small_sample(0..99), y in small_sample(0..99)) {
        assert_agrees_with_enumeration(&x, &y);
    }

    #[test]
    fn the_order_of_the_samples_does_not_matter(
        x in prop::collection::vec(-3.0..3.0_f64, 1..80), y in prop::collection::vec(-2.0..4.0_f64, 1..80)
    ) {
        let (one, other) = (test(&x, &y).unwrap(), test(&y, &x).unwrap());
        prop_assert_eq!((one.h, one.lcm), (other.h, other.lcm));
        prop_assert!((one.p - other.p).abs() <= 1e-12 * one.p);
    }

    #[test]
    fn only_the_order_of_the_values_matters(
        x in prop::collection::vec(-40..40_i32, 1..80), y in prop::collection::vec(-30..50_i32, 1..80)
    ) {
        let plain = |value: i32| f64::from(value);
        let mapped = |value: i32| (f64::from(value) / 9.0).exp() - 7.0;
        let test = |map: fn(i32) -> f64| {
            let of = |values: &[i32]| values.iter().map(|value| map(*value)).collect::<Vec<_>>();
            test(&of(&x), &of(&y)).unwrap()
        };
        let moved = |gap: Gap| Gap { at: gap.at.map(|at| mapped(at as i32)), ..gap };
        let result = test(plain);
        let expected = KsTest { above: moved(result.above), below: moved(result.below), ..result };
        prop_assert_eq!(test(mapped), expected);
    }

    #[test]
    fn without_ties_a_p_value_lies_between_the_smallest_attainable_and_one(
        x in prop::collection::vec(0.0..9.0_f64, 1..40), y in prop::collection::vec(3.0..12.0_f64, 1..40)
    ) {
        let result = test(&x, &y).unwrap();
        prop_assert!(result.p <= 1.0);
        prop_assert!(result.p >= smallest_attainable_p(x.len(), y.len()) * (1.0 - 1e-12));
    }
}
