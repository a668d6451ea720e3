//! How far the limits are from the exact p-value, where both can be computed. docs/statistics.md has this table.

use record::report_settings::Method;
use rstest::rstest;

use crate::ks::{Procedure, distance::Steps, tails::Tail};

/// The largest relative error of a method's p-value among 20 distances from p = 0.5 to p = 1e-6, with its sign.
fn largest_error(n: usize, m: usize, method: Method) -> f64 {
    let steps = Steps::of(n as u64, m as u64);
    let lcm = steps.of_x * n as u64;
    // h = i · of_x − j · of_y for some i and j.
    let is_a_distance = |h: &u64| {
        let over = |i: u64| (i * steps.of_x).checked_sub(*h);
        (0..=n as u64)
            .filter_map(over)
            .any(|rest| rest.is_multiple_of(steps.of_y))
    };
    let root = ((n + m) as f64 / (n as f64 * m as f64)).sqrt();
    let errors = (0..20).map(|step| {
        let p = 0.5 * 2e-6_f64.powf(f64::from(step) / 19.0);
        let h = ((-(p / 2.0).ln() / 2.0).sqrt() * root * lcm as f64).round() as u64;
        let h = (h..=lcm).find(is_a_distance).unwrap();
        let tail = |method| {
            let procedure = Procedure {
                method,
                ..Procedure::default()
            };
            Tail::without_ties(procedure, n, m, h).p
        };
        tail(method) / tail(Method::Exact) - 1.0
    });
    errors
        .max_by(|a, b| a.abs().total_cmp(&b.abs()))
        .unwrap_or_default()
}

#[rstest]
#[case(60, 60, 0.7411, -0.2666)]
#[case(59, 60, 2.6907, 0.7977)]
#[case(200, 200, 0.1557, -0.2132)]
#[case(199, 200, 0.7009, 0.1595)]
#[case(1000, 1000, 0.0279, -0.1253)]
#[case(600, 1000, 0.1305, -0.0639)]
#[case(999, 1000, 0.1775, -0.0705)]
#[case(5000, 5000, 0.0056, -0.0632)]
#[case(4999, 5000, 0.0777, -0.0434)]
fn the_errors_of_the_limits_are_as_tabled(
    #[case] n: usize,
    #[case] m: usize,
    #[case] asymptotic: f64,
    #[case] paper: f64,
) {
    let found = [Method::Asymptotic, Method::Paper].map(|method| largest_error(n, m, method));
    for (found, tabled) in found.into_iter().zip([asymptotic, paper]) {
        assert!(
            (found - tabled).abs() < 1e-4,
            "{n} {m}: {found:.4}, tabled {tabled}"
        );
    }
    // What docs/statistics.md states of larger samples than are compared exactly.
    let few = n.min(m) as f64;
    let bound = if n == m { 45.0 / few } else { 6.0 / few.sqrt() };
    assert!(few < 500.0 || asymptotic.abs() <= bound);
}

/// At the paper's sizes the method decides: exactly and in the plain limit the critical distance is 22/60, with
/// Stephens's correction 21/60.
#[rstest]
#[case(Method::Exact, 22)]
#[case(Method::Asymptotic, 22)]
#[case(Method::Paper, 21)]
fn the_critical_distance_of_sixty_and_sixty_depends_on_the_method(
    #[case] method: Method,
    #[case] critical: u64,
) {
    let procedure = Procedure {
        method,
        ..Procedure::default()
    };
    let rejected = |h: &u64| Tail::without_ties(procedure, 60, 60, *h).p < 0.001;
    assert_eq!((0..=60).find(rejected), Some(critical));
}
