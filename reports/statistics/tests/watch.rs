//! The watch over nights, on public series with known changes and on histories that are made up.

use rstest::rstest;
use statistics::{
    nights::{Change, Nights, changed, delay, false_changes, observed},
    public_series::{coal_mines, nile},
    watch::{Kind, Night, watch},
};

/// Of one of nine series that have 0.01 together.
const LEVEL: f64 = 0.01 / 9.0;

fn series(values: &[f64], level: f64) -> Vec<Night> {
    let night = |value: &f64| Night {
        value: *value,
        level,
        weekday: None,
        is_known_change: false,
    };
    values.iter().map(night).collect()
}

fn places(values: &[f64], level: f64) -> Vec<usize> {
    watch(&series(values, level))
        .changes
        .iter()
        .map(|change| change.at)
        .collect()
}

#[test]
fn the_nile_fell_after_1898() {
    assert_eq!(places(&nile().values, 0.01), [28]);
}

#[test]
fn disasters_in_coal_mines_became_fewer_around_1890() {
    let years: Vec<usize> = places(&coal_mines().values, 0.01)
        .iter()
        .map(|at| 1851 + at)
        .collect();
    assert!(matches!(years[..], [1886..=1896]), "{years:?}");
}

/// Of 143 series and more the permutations of the former change points could not reach the level, and nothing was found.
#[rstest]
#[case::nine_series(9.0)]
#[case::one_hundred_and_forty_three(143.0)]
#[case::ten_thousand(10_000.0)]
fn a_change_is_found_among_however_many_series(#[case] count: f64) {
    let found = changed(Nights::Normal, Change::Jump(2.0), 60, 60, 0.01 / count, 4);
    let [change] = &found.changes[..] else {
        panic!("{found:?}")
    };
    assert_eq!(change.kind, Kind::Jump);
    assert!(change.at.abs_diff(60) <= 2, "{change:?}");
}

#[rstest]
#[case(Nights::Normal)]
#[case(Nights::HeavyTails)]
#[case(Nights::Autoregression(0.3))]
#[case(Nights::Autoregression(0.5))]
#[case(Nights::Autoregression(0.7))]
#[case(Nights::Weekends(1.0))]
#[case(Nights::Weekends(2.0))]
fn nights_without_a_change_are_told_of_as_seldom_as_promised(#[case] nights: Nights) {
    // 3.65 a year of nine series are 73 of 180 series-years. Of a Poisson of 73, 99.9 % lies below 101; the former rules told of
    // 800 and 2000 with φ of 0.5 and 0.7.
    let told: usize = (0..180)
        .map(|seed| false_changes(nights, LEVEL, 77_000 + seed).len())
        .sum();
    assert!(told < 101, "{told}");
}

#[rstest]
#[case(Nights::Normal)]
#[case(Nights::HeavyTails)]
#[case(Nights::Autoregression(0.7))]
fn a_young_history_has_no_more_false_alarms_than_an_old_one(#[case] nights: Nights) {
    // Nights 6 to 15 of 1800 series have 18 000 chances of 0.01 / 9: 20 are expected at most, and 99.9 % of a Poisson of that lies
    // below 36.
    let told: usize = (0..1800)
        .map(|seed| {
            let watched = watch(&observed(&nights.values(15, 5000 + seed), LEVEL, seed));
            watched.changes.len()
        })
        .sum();
    assert!(told < 36, "{told}");
}

/// A CUSUM with k = 0.5 and h = 8.5, its mean and scale from the first 60 nights, has medians of 15, 8, 5, 3, 1 and 25, 16 nights
/// (`reports/examples/referee/drift.rs`); the former rules had 25, 10, 6, 2, 1 and 31, 19.
#[rstest]
#[case(Change::Jump(1.0), 16)]
#[case(Change::Jump(1.5), 8)]
#[case(Change::Jump(2.0), 5)]
#[case(Change::Jump(3.0), 2)]
#[case(Change::Jump(5.0), 1)]
#[case(Change::Slope(0.05), 26)]
#[case(Change::Slope(0.1), 16)]
fn a_change_is_told_as_soon_as_by_a_cusum(#[case] change: Change, #[case] median: usize) {
    let soon = (0..400)
        .filter(|seed| {
            let delay = delay(Nights::Normal, change, 60, 100, LEVEL, 31_000 + seed);
            delay.is_some_and(|delay| delay <= median)
        })
        .count();
    // Of a binomial of 400 at a half, 97.5 % lies above 180.
    assert!(soon >= 180, "{soon}");
}

#[test]
fn the_place_of_a_change_is_found_as_well_as_it_can_be() {
    // With both levels known, 84.6 % of steps of 1.5 standard deviations and 93.8 % of 2 are placed within two nights by the most
    // likely place, so that no method has more.
    for (jump, at_least) in [(1.5, 145), (2.0, 170)] {
        let near = (0..200)
            .filter(|seed| {
                let found = changed(Nights::Normal, Change::Jump(jump), 60, 41, LEVEL, 600 + seed);
                found.changes.iter().any(|change| change.at.abs_diff(60) <= 2)
            })
            .count();
        assert!(near >= at_least, "{jump}: {near}");
    }
}

#[test]
fn what_was_told_stays_told() {
    for seed in 0..40 {
        let values = {
            let mut values = Nights::Normal.values(120, 900 + seed);
            values.iter_mut().skip(60).for_each(|value| *value += 2.0);
            values
        };
        let nights = series(&values, LEVEL);
        let mut told = 0;
        for newest in 60..=120 {
            let now = watch(&nights[..newest]).changes.len();
            assert!(now >= told, "seed {seed}, night {newest}: {told} and then {now}");
            told = now;
        }
        assert!(told > 0, "seed {seed}");
    }
}

/// Of 20 histories each: those in which a slope is told again that was acknowledged in the night in which it was first named so.
#[rstest]
#[case::from_the_first_night(0)]
#[case::after_thirty_nights(30)]
#[case::after_sixty_nights(60)]
fn a_slope_that_is_known_is_not_told_again(#[case] begins: usize) {
    let again = |seed: &u64| {
        let mut values = Nights::Normal.values(150, 7000 + seed);
        for (night, value) in values.iter_mut().enumerate() {
            *value += 0.1 * night.saturating_sub(begins) as f64;
        }
        let mut nights = series(&values, LEVEL);
        let named = (1..=150).find(|newest| {
            let changes = watch(&nights[..*newest]).changes;
            changes.iter().any(|change| change.kind == Kind::Slope)
        });
        let Some(named) = named else {
            return false;
        };
        for change in watch(&nights[..named]).changes {
            nights[change.at].is_known_change = true;
        }
        let is_news = |newest: &usize| {
            let changes = watch(&nights[..*newest]).changes;
            changes
                .iter()
                .any(|it| it.known.is_empty() && it.withdrawn.is_none())
        };
        (named..=150).any(|newest| is_news(&newest))
    };
    let told: Vec<u64> = (0..20).filter(again).collect();
    assert!(told.len() <= 2, "{told:?}");
}

/// A slope that is known ends after 30 nights; a jump comes 40 nights later.
#[rstest]
#[case::up(3.0)]
#[case::down(-3.0)]
fn a_jump_after_a_slope_that_is_known_is_told(#[case] jump: f64) {
    let is_told = |seed: &u64| {
        let mut values = Nights::Normal.values(115, 8000 + seed);
        for (night, value) in values.iter_mut().enumerate() {
            *value += 0.1 * night.saturating_sub(30).min(30) as f64;
            *value += if night >= 100 { jump } else { 0.0 };
        }
        let mut nights = series(&values, LEVEL);
        for change in watch(&nights[..75]).changes {
            nights[change.at].is_known_change = true;
        }
        let changes = watch(&nights).changes;
        changes
            .iter()
            .any(|it| it.known.is_empty() && it.withdrawn.is_none() && it.at.abs_diff(100) <= 5)
    };
    let told = (0..20).filter(is_told).count();
    assert!(told >= 16, "{told}");
}

#[test]
fn days_of_the_week_are_taken_out_and_changes_found_sooner() {
    let nights = Nights::Weekends(3.0);
    let watched = watch(&observed(&nights.values(120, 3), LEVEL, 3));
    assert!((2.0..4.0).contains(&watched.weekly), "{watched:?}");
    let independent = watch(&observed(&Nights::Normal.values(120, 3), LEVEL, 3));
    assert_eq!(independent.weekly, 0.0);
    let found = |knows_days: bool| {
        (0..60)
            .filter(|seed| {
                let mut values = nights.values(75, 400 + seed);
                values.iter_mut().skip(60).for_each(|value| *value += 2.0);
                let mut observed = observed(&values, LEVEL, 400 + seed);
                if !knows_days {
                    observed.iter_mut().for_each(|night| night.weekday = None);
                }
                !watch(&observed).changes.is_empty()
            })
            .count()
    };
    assert!(found(true) > found(false) + 5, "{} {}", found(true), found(false));
}

#[test]
fn after_a_known_change_what_would_be_found_is_within_half_as_much_again() {
    let mut ratios: Vec<f64> = (0..100)
        .map(|seed| {
            let mut values = Nights::Normal.values(64, 200 + seed);
            values.iter_mut().skip(60).for_each(|value| *value += 10.0);
            let mut nights = series(&values, LEVEL);
            nights[60].is_known_change = true;
            let detectable = |nights: &[Night]| watch(nights).detectable.unwrap();
            detectable(&nights) / detectable(&nights[..60])
        })
        .collect();
    ratios.sort_by(f64::total_cmp);
    assert!(ratios[95] < 1.5, "{} {}", ratios[50], ratios[95]);
}

#[rstest]
#[case::none(&[])]
#[case::one(&[1.0])]
#[case::all_alike(&[3.0; 300])]
#[case::two_values(&[1.0, 2.0])]
fn where_nothing_can_be_told_nothing_is(#[case] values: &[f64]) {
    assert!(places(values, LEVEL).is_empty());
}

/// No spread says how clear the change is; the order of the nights does. Three nights of nineteen come last in one of 969 orders.
#[rstest]
#[case::sixteen_before(16, 3, &[16])]
#[case::one_too_few_since(16, 2, &[])]
#[case::eight_before(8, 5, &[8])]
#[case::one_too_few_since_eight(8, 4, &[])]
fn nights_that_were_all_equal_and_are_now_equal_to_another_number_have_changed(
    #[case] before: usize,
    #[case] since: usize,
    #[case] found: &[usize],
) {
    let values = [vec![53.204; before], vec![61.84; since]].concat();
    assert_eq!(places(&values, LEVEL), found);
}

#[test]
fn one_night_far_off_is_withdrawn_in_the_next() {
    let mut values = Nights::Normal.values(60, 8);
    values[50] += 30.0;
    let told = watch(&series(&values[..51], LEVEL)).changes;
    assert!(
        matches!(&told[..], [change] if change.at == 50 && change.withdrawn.is_none()),
        "{told:?}"
    );
    let withdrawn = watch(&series(&values, LEVEL)).changes;
    assert!(
        matches!(&withdrawn[..], [change] if change.withdrawn == Some(51)),
        "{withdrawn:?}"
    );
}

#[test]
fn a_night_that_shows_another_to_have_been_alone_is_judged_by_itself_too() {
    let mut nights = observed(&Nights::Normal.values(40, 3), LEVEL, 3);
    nights[35].value += 12.0;
    nights[36].value -= 60.0;
    let told = watch(&nights[..=36]).changes;
    let [up, down] = &told[..] else { panic!("{told:?}") };
    assert_eq!((up.at, up.withdrawn), (35, Some(36)));
    assert_eq!((down.at, down.told, down.withdrawn), (36, 36, None));
    // It was alone as well.
    let later = watch(&nights).changes;
    assert!(later.iter().all(|change| change.withdrawn.is_some()), "{later:?}");
}
