//! Where the level or the distribution of a series changes. The main function is [`change_points`].
//!
//! Hierarchical divisive estimation: of all splits of all segments the one with the largest statistic is tried; its p is
//! the share of dealings of the values anew, each within its segment, whose largest statistic over all splits reaches it.
//! Below the level the segment is split and the search goes on, else it ends. Two statistics:
//!
//! - [`Statistic::Energy`], the E-divisive of Matteson and James (*A nonparametric approach for multiple change point
//!   analysis of multivariate data*, JASA 109, 2014): nm/(n + m) · (2·mean|x − y| − mean|x − x′| − mean|y − y′|). It sees
//!   any change of the distribution, its level above all.
//! - [`Statistic::Ranks`], of Pettitt (*A non-parametric approach to the change-point problem*, Applied Statistics 28,
//!   1979), in the units of its standard deviation: |2·ΣR − τ(n + 1)| / √(τ(n − τ)(n + 1)/3). It sees levels alone, and a
//!   night that is far off counts no more than one that is the largest.

use oorandom::Rand64;

use crate::statistics::relabelling::shuffle;

/// What two segments are held against each other by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Statistic {
    /// Distances of values.
    Energy,
    /// Their ranks.
    Ranks,
}

/// How change points are looked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Search {
    /// By which statistic.
    pub statistic: Statistic,
    /// The p below which a split is one.
    pub level: f64,
    /// The fewest values a segment has; at least 2.
    pub shortest: usize,
    /// Seed of the dealings.
    pub seed: u64,
}

/// A change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChangePoint {
    /// How many values come before it.
    pub at: usize,
    /// Its p, adjusted for all places it could have had.
    pub p: f64,
}

/// Dealings for each p, in units of what the level takes: with 5 the smallest p is a fifth of the level.
const FINENESS: f64 = 5.0;
/// The fewest and the most dealings for a p.
const DEALINGS: (f64, f64) = (199.0, 100_000.0);

/// The changes, in the order of their places.
#[must_use]
pub fn change_points(series: &[f64], search: &Search) -> Vec<ChangePoint> {
    let shortest = search.shortest.max(2);
    let dealings = (FINENESS / search.level).clamp(DEALINGS.0, DEALINGS.1) as u32;
    let mut random = Rand64::new(u128::from(search.seed));
    let mut found: Vec<ChangePoint> = Vec::new();
    loop {
        let segments = segments(series, &found);
        let splits = segments
            .iter()
            .map(|(_, values)| best_split(values, shortest, search.statistic));
        let candidate = splits
            .zip(&segments)
            .filter_map(|(split, (begins, _))| split.map(|(at, value)| (begins + at, value)))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let Some((at, observed)) = candidate.filter(|(_, value)| *value > 0.0) else {
            return found;
        };
        let reaches = |random: &mut Rand64| {
            segments.iter().any(|(_, values)| {
                let mut dealt = values.to_vec();
                shuffle(&mut dealt, random);
                best_split(&dealt, shortest, search.statistic).is_some_and(|(_, value)| value >= observed)
            })
        };
        // More than these, and it is none, whatever the rest would be.
        let most = (search.level * f64::from(dealings + 1)).floor() as u32;
        let mut reached = 1;
        for _ in 0..dealings {
            reached += u32::from(reaches(&mut random));
            if reached > most {
                return found;
            }
        }
        found.push(ChangePoint {
            at,
            p: f64::from(reached) / f64::from(dealings + 1),
        });
        found.sort_by_key(|change| change.at);
    }
}

/// The values between changes, with the place of the first of each.
fn segments<'a>(series: &'a [f64], changes: &[ChangePoint]) -> Vec<(usize, &'a [f64])> {
    let ends = changes.iter().map(|change| change.at).chain([series.len()]);
    let mut begins = 0;
    ends.map(|end| {
        let segment = (begins, series.get(begins..end).unwrap_or_default());
        begins = end;
        segment
    })
    .collect()
}

/// The split with the largest statistic; none of fewer values than two segments have.
fn best_split(values: &[f64], shortest: usize, statistic: Statistic) -> Option<(usize, f64)> {
    let splits = match statistic {
        Statistic::Energy => energies(values),
        Statistic::Ranks => ranks(values),
    };
    let possible = shortest..=values.len().checked_sub(shortest)?;
    splits
        .into_iter()
        .enumerate()
        .filter(|(at, _)| possible.contains(at))
        .max_by(|a, b| a.1.total_cmp(&b.1))
}

/// The energy statistic of every split, by how many values come before it.
fn energies(values: &[f64]) -> Vec<f64> {
    let distances = |from: &[f64], value: f64| from.iter().map(|other| (other - value).abs()).sum::<f64>();
    let mut after: f64 = (0..values.len())
        .map(|at| distances(&values[at + 1..], values[at]))
        .sum();
    let (mut before, mut between) = (0.0, 0.0);
    let pairs = |n: f64| n * (n - 1.0) / 2.0;
    let mut statistics = vec![0.0];
    for (at, value) in values.iter().enumerate() {
        // One value goes from the second segment to the first.
        let to_first = distances(&values[..at], *value);
        let to_second = distances(&values[at + 1..], *value);
        before += to_first;
        after -= to_second;
        between += to_second - to_first;
        let (n, m) = ((at + 1) as f64, (values.len() - at - 1) as f64);
        let mean = |sum: f64, count: f64| if count > 0.0 { sum / count } else { 0.0 };
        let energy = 2.0 * mean(between, n * m) - mean(before, pairs(n)) - mean(after, pairs(m));
        statistics.push(energy * n * m / (n + m));
    }
    statistics
}

/// The rank statistic of every split, by how many values come before it.
fn ranks(values: &[f64]) -> Vec<f64> {
    let count = values.len() as f64;
    let mut sum = 0.0;
    let mut statistics = vec![0.0];
    for (at, rank) in mid_ranks(values).into_iter().enumerate() {
        sum += rank;
        let before = (at + 1) as f64;
        let spread = (before * (count - before) * (count + 1.0) / 3.0).sqrt();
        let excess = (2.0 * sum - before * (count + 1.0)).abs();
        statistics.push(if spread > 0.0 { excess / spread } else { 0.0 });
    }
    statistics
}

/// The rank of each value, from 1; equal ones share the mean of theirs.
fn mid_ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    let mut ranks = vec![0.0; values.len()];
    let mut first = 0;
    for equal in order.chunk_by(|a, b| values[*a] == values[*b]) {
        let shared = first as f64 + (equal.len() + 1) as f64 / 2.0;
        for at in equal {
            ranks[*at] = shared;
        }
        first += equal.len();
    }
    ranks
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;
    use crate::statistics::noise_model::Noise;

    const SEARCH: Search = Search {
        statistic: Statistic::Energy,
        level: 0.01,
        shortest: 5,
        seed: 1,
    };

    /// Annual flow of the Nile at Aswan, 1871 to 1970, in 10⁸ m³: `Nile` of R's datasets, from Durbin and Koopman, *Time
    /// Series Analysis by State Space Methods* (2001), table 2.1. It fell after 1898, with the first dam (Cobb, *The problem
    /// of the Nile*, Biometrika 65, 1978).
    const NILE: [f64; 100] = [
        1120.0, 1160.0, 963.0, 1210.0, 1160.0, 1160.0, 813.0, 1230.0, 1370.0, 1140.0, 995.0, 935.0, 1110.0,
        994.0, 1020.0, 960.0, 1180.0, 799.0, 958.0, 1140.0, 1100.0, 1210.0, 1150.0, 1250.0, 1260.0, 1220.0,
        1030.0, 1100.0, 774.0, 840.0, 874.0, 694.0, 940.0, 833.0, 701.0, 916.0, 692.0, 1020.0, 1050.0, 969.0,
        831.0, 726.0, 456.0, 824.0, 702.0, 1120.0, 1100.0, 832.0, 764.0, 821.0, 768.0, 845.0, 864.0, 862.0,
        698.0, 845.0, 744.0, 796.0, 1040.0, 759.0, 781.0, 865.0, 845.0, 944.0, 984.0, 897.0, 822.0, 1010.0,
        771.0, 676.0, 649.0, 846.0, 812.0, 742.0, 801.0, 1040.0, 860.0, 874.0, 848.0, 890.0, 744.0, 749.0,
        838.0, 1050.0, 918.0, 986.0, 797.0, 923.0, 975.0, 815.0, 1020.0, 906.0, 901.0, 1170.0, 912.0, 746.0,
        919.0, 718.0, 714.0, 740.0,
    ];

    /// British coal-mining disasters with 10 deaths or more, a year, 1851 to 1962: Jarrett, *A note on the intervals between
    /// coal-mining disasters*, Biometrika 66, 1979. They became fewer around 1890 (Carlin, Gelfand and Smith, *Hierarchical
    /// Bayesian analysis of changepoint problems*, Applied Statistics 41, 1992: posterior mode 1891).
    const COAL: [u8; 112] = [
        4, 5, 4, 1, 0, 4, 3, 4, 0, 6, 3, 3, 4, 0, 2, 6, 3, 3, 5, 4, 5, 3, 1, 4, 4, 1, 5, 5, 3, 4, 2, 5, 2, 2,
        3, 4, 2, 1, 3, 2, 2, 1, 1, 1, 1, 3, 0, 0, 1, 0, 1, 1, 0, 0, 3, 1, 0, 3, 2, 2, 0, 1, 1, 1, 0, 1, 0, 1,
        0, 0, 0, 2, 1, 0, 0, 0, 1, 1, 0, 2, 3, 3, 1, 1, 2, 1, 1, 1, 1, 2, 3, 3, 0, 0, 0, 1, 4, 0, 0, 0, 1, 0,
        0, 0, 0, 0, 1, 0, 0, 1, 0, 1,
    ];

    fn places(series: &[f64], statistic: Statistic) -> Vec<usize> {
        let found = change_points(series, &Search { statistic, ..SEARCH });
        found.iter().map(|change| change.at).collect()
    }

    #[rstest]
    fn the_nile_fell_after_1898(#[values(Statistic::Energy, Statistic::Ranks)] statistic: Statistic) {
        assert_eq!(places(&NILE, statistic), [28]);
    }

    #[rstest]
    fn disasters_in_coal_mines_became_fewer_around_1890(
        #[values(Statistic::Energy, Statistic::Ranks)] statistic: Statistic,
    ) {
        let series: Vec<f64> = COAL.iter().map(|count| f64::from(*count)).collect();
        let found = places(&series, statistic);
        let years: Vec<usize> = found.iter().map(|at| 1850 + at).collect();
        assert!((1886..=1896).contains(&years[0]), "{years:?}");
    }

    #[test]
    fn the_energy_of_a_split_is_that_of_its_definition() {
        // {0, 1} and {4}: 2·(4 + 3)/2 − 1 − 0 = 6, times 2·1/3.
        let energies = energies(&[0.0, 1.0, 4.0]);
        assert!((energies[2] - 4.0).abs() < 1e-12, "{energies:?}");
        // {0} and {1, 4}: 2·(1 + 4)/2 − 0 − 3 = 2, times 2/3.
        assert!((energies[1] - 4.0 / 3.0).abs() < 1e-12, "{energies:?}");
    }

    #[test]
    fn the_rank_statistic_is_pettitts_in_standard_deviations() {
        // Ranks 1, 2.5, 2.5, 4: U at 2 is 2·3.5 − 2·5 = −3; its variance 2·2·5/3.
        let ranks = ranks(&[1.0, 2.0, 2.0, 9.0]);
        assert!(
            (ranks[2] - 3.0 / (20.0_f64 / 3.0).sqrt()).abs() < 1e-12,
            "{ranks:?}"
        );
    }

    #[rstest]
    fn two_changes_are_both_found_where_they_are(
        #[values(Statistic::Energy, Statistic::Ranks)] statistic: Statistic,
    ) {
        let mut noise = Noise::new(4);
        let level = |night: usize| match night {
            0..20 => 0.0,
            20..40 => 10.0,
            _ => 2.0,
        };
        let series: Vec<f64> = (0..60).map(|night| level(night) + noise.normal()).collect();
        assert_eq!(places(&series, statistic), [20, 40]);
    }

    #[test]
    fn one_night_far_off_is_no_change_by_ranks() {
        let mut noise = Noise::new(9);
        let mut series: Vec<f64> = (0..40).map(|_| noise.normal()).collect();
        series[33] = 500.0;
        assert!(places(&series, Statistic::Ranks).is_empty());
    }

    #[rstest]
    #[case::none(&[])]
    #[case::one(&[1.0])]
    #[case::too_few(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0])]
    #[case::all_alike(&[3.0; 30])]
    fn where_nothing_can_be_told_nothing_is(
        #[case] series: &[f64],
        #[values(Statistic::Energy, Statistic::Ranks)] statistic: Statistic,
    ) {
        assert!(places(series, statistic).is_empty());
    }

    #[rstest]
    fn noise_alone_has_a_change_as_seldom_as_the_level_says(
        #[values(Statistic::Energy, Statistic::Ranks)] statistic: Statistic,
    ) {
        let search = Search {
            statistic,
            level: 0.05,
            ..SEARCH
        };
        let mut noise = Noise::new(17);
        let changed = (0..300)
            .filter(|_| {
                let series: Vec<f64> = (0..30).map(|_| noise.normal()).collect();
                !change_points(&series, &search).is_empty()
            })
            .count();
        // Of a binomial of 300 at 0.05, 99.9 % lies within 3 and 29.
        assert!((3..=29).contains(&changed), "{changed}");
    }
}
