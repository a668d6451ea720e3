//! What the test suites of SciPy and R assert of their own two-sample tests, and R's examples, met by ours. The cases
//! are data, each with its source; reports/statistics/tests/data/README.md says how they are read.

use record::report_settings::Method;
use serde::Deserialize;

use crate::ks::{Alternative, KsTest, Pool, Procedure, distance::Steps, tails::Tail};

/// One case.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Case {
    source: String,
    /// The samples, or their sizes where the p-value of a distance is asserted.
    x: Option<Values>,
    y: Option<Values>,
    n: Option<u64>,
    m: Option<u64>,
    /// How many values are equal, for each distinct one of the pooled.
    runs: Option<Vec<usize>>,
    alternative: Alternative,
    d: f64,
    p: Option<f64>,
    kind: Kind,
    location: Option<f64>,
    sign: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Values {
    Listed(Vec<f64>),
    Spaced {
        from: f64,
        to: f64,
        count: u32,
        plus: f64,
    },
}

/// What the p-value is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Kind {
    Exact,
    /// SciPy's exact p-value takes no notice of ties, where ours and R's do.
    ExactIgnoringTies,
    /// An approximation of SciPy's own, to hold against the exact value.
    Asymptotic,
}

impl Values {
    fn list(&self) -> Vec<f64> {
        match self {
            Self::Listed(values) => values.clone(),
            Self::Spaced {
                from,
                to,
                count,
                plus,
            } => (0..*count)
                .map(|i| from + f64::from(i) * ((to - from) / f64::from(count - 1)) + plus)
                .collect(),
        }
    }
}

impl Case {
    fn procedure(&self) -> Procedure {
        Procedure {
            alternative: self.alternative,
            ..Procedure::default()
        }
    }

    fn test(&self) -> Option<KsTest> {
        let (x, y) = self.x.as_ref().zip(self.y.as_ref())?;
        Some(self.procedure().test(&x.list(), &y.list()).unwrap())
    }

    /// The p-value of the case by our computation.
    fn found(&self) -> Tail {
        if let Some(test) = self.test() {
            return match self.kind {
                Kind::ExactIgnoringTies => Tail::without_ties(self.procedure(), test.n, test.m, test.h),
                _ => Tail {
                    p: test.p,
                    log10_p: test.log10_p,
                    method: test.method,
                },
            };
        }
        let (n, m) = self.n.zip(self.m).unwrap();
        let h = (self.d * (Steps::of(n, m).of_x * n) as f64).round() as u64;
        let (n, m) = (n as usize, m as usize);
        let ends = self.runs.iter().flatten().scan(0, |end, run| {
            *end += run;
            Some(*end)
        });
        match &self.runs {
            None => Tail::without_ties(self.procedure(), n, m, h),
            Some(_) => Tail::given_ties(self.procedure(), n, m, h, &ends.collect::<Vec<_>>()),
        }
    }
}

fn cases() -> Vec<Case> {
    let lines = include_str!("../../../tests/data/ks_published.jsonl").lines();
    lines.map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn what_scipy_and_r_assert_holds() {
    let cases = cases();
    assert_eq!(cases.len(), 104);
    for case in &cases {
        if let Some(test) = case.test() {
            assert!((test.d - case.d).abs() < 1e-12, "{case:?}: {test:?}");
        }
        let Some(p) = case.p else { continue };
        let found = case.found();
        assert_eq!(found.method, Method::Exact, "{case:?}");
        // SciPy asserts six decimals; R's exact values and theirs have eleven: testLarge's 0.99115454582047591 is 8e-12
        // off the quotient of whole numbers, 0.99115454582805720. SciPy's approximations are 0.003 off at most.
        let bound = match case.kind {
            Kind::Exact | Kind::ExactIgnoringTies => 1e-11,
            Kind::Asymptotic => 3e-3,
        };
        assert!(
            (found.p - p).abs() < bound,
            "{}: {} is not {p}",
            case.source,
            found.p
        );
    }
}

#[test]
fn the_distance_lies_where_scipy_says() {
    let with_place: Vec<Case> = cases()
        .into_iter()
        .filter(|case| case.location.is_some())
        .collect();
    assert_eq!(with_place.len(), 4);
    for case in with_place {
        let (signed_d, at) = case.test().unwrap().signed_d();
        assert_eq!(
            (at, Some(signed_d.signum())),
            (case.location, case.sign),
            "{case:?}"
        );
    }
}

/// Kim and Jennrich, in *Selected Tables in Mathematical Statistics* I (1973), 129, as R's psmirnov.R quotes them.
#[test]
fn the_critical_values_of_kim_and_jennrich_are_met() {
    let table = [(8, 6, [34, 40, 48]), (14, 10, [74, 90, 106])];
    for (n, m, critical) in table {
        for (nm_d, alpha) in critical.into_iter().zip([0.05, 0.01, 0.001]) {
            // In their units of 1 / nm, of which the distances are multiples of 2; not every multiple is a distance.
            let p = |nm_d: u64| Tail::without_ties(Procedure::default(), n, m, nm_d / 2).p;
            let next = (0..nm_d).rev().map(p).find(|other| *other > p(nm_d));
            assert!(
                p(nm_d) <= alpha && next > Some(alpha),
                "{n}, {m}: {nm_d} at {alpha}"
            );
        }
    }
}

/// SciPy's gh-12218: the product of the sizes overflowed.
#[test]
fn two_million_values_a_side_can_be_compared() {
    let x: Vec<f64> = (0..1 << 21).map(|i| f64::from(i) * 1e-7).collect();
    let y: Vec<f64> = x.iter().map(|value| value + 1.0).collect();
    let pool = Pool::of(&[x, y]).unwrap();
    for (alternative, h) in [
        (Alternative::TwoSided, 1 << 21),
        (Alternative::Greater, 1 << 21),
        (Alternative::Less, 0),
    ] {
        let procedure = Procedure {
            method: Method::Asymptotic,
            alternative,
        };
        assert_eq!(pool.pair(0, 1, procedure).h, h);
    }
}
