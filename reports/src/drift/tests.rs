//! Nights that are made up, with changes that are known.

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use record::run_directory::{EnvironmentRecord, RecordedPlatform};
use rstest::rstest;
use serde_json::json;
use statistics::noise_model::Noise;

use super::{night::Measured, *};

const SCENARIO: &str = "x86_64-debian-12-docker";

/// The level of a night that is like all others, in metres.
const USUAL_M: f64 = 0.2;
/// By how much nights differ anyway.
const SPREAD_M: f64 = 0.001;

/// A platform of which only the kernel is known.
fn kernel(release: &str) -> Option<RecordedPlatform> {
    serde_json::from_value(json!({"kernel": release})).unwrap()
}

/// Another platform for what was measured.
fn runs_on(measured: &mut Measured, platform: Option<RecordedPlatform>) {
    let mut environment = measured.environment.as_ref().unwrap().read().unwrap();
    environment.platform = platform;
    measured.environment = Some(Compact::of(&environment));
}

/// A night with four windows around that level.
fn night(number: usize, level_m: f64) -> Night {
    let windows = [-0.000_2, -0.000_1, 0.000_1, 0.000_2].map(|off| level_m + off);
    let environment = EnvironmentRecord {
        environment: format!("e-{number}"),
        provider: "docker".to_owned(),
        host: "lab".to_owned(),
        facts: serde_json::Map::new(),
        platform: kernel("6.1"),
    };
    let measured = Measured {
        configuration: Compact::of(&json!({"settings": {"rate": "50Hz"}, "workload_sha256": "aa"})),
        environment: Some(Compact::of(&environment)),
        values: BTreeMap::from([(Metric::TrackingError, windows.to_vec())]),
        lack: None,
        contents: BTreeMap::new(),
    };
    Night {
        run: format!("night-{number:03}"),
        created: format!("2026-{:02}-{:02}T02:00:00.000Z", 1 + number / 28, 1 + number % 28),
        is_simulated: false,
        metric: Metric::TrackingError,
        equivalence_margin_m: None,
        equivalence_margins: BTreeMap::new(),
        scenarios: BTreeMap::from([(SCENARIO.to_owned(), measured)]),
    }
}

/// So many nights around a level for each.
fn nights(count: usize, seed: u64, level_m: impl Fn(usize) -> f64) -> Vec<Night> {
    let mut noise = Noise::new(seed);
    (0..count)
        .map(|number| night(number, level_m(number) + SPREAD_M * noise.normal()))
        .collect()
}

#[test]
fn a_metric_that_was_renamed_is_followed_no_longer_and_that_is_told() {
    let of = |name: &str| Metric::OfCommand {
        name: name.to_owned(),
        unit: "mm".to_owned(),
    };
    let mut all = nights(6, 1, |_| USUAL_M);
    for (number, night) in all.iter_mut().enumerate() {
        let metric = of(if number < 5 { "eror" } else { "error" });
        let measured = night.scenarios.get_mut(SCENARIO).unwrap();
        let levels = std::mem::take(&mut measured.values).into_values().next().unwrap();
        measured.values.insert(metric.clone(), levels);
        night.metric = metric;
    }
    let metrics: Vec<Metric> = series_of(&all)
        .iter()
        .map(|series| series.metric.clone())
        .collect();
    assert_eq!(metrics, [of("error")]);
    assert_eq!(
        series::remarks(&all),
        [
            "earlier runs measured `eror` in mm, which the newest run's experiment does not have: that is followed no longer"
        ]
    );
    // Until then it is.
    assert_eq!(series_of(&all[..5]).len(), 1);
    assert!(series::remarks(&all[..5]).is_empty());
}

#[test]
fn provisioning_that_is_the_same_to_the_millisecond_is_no_series_of_its_own() {
    let with = |took_ms: [u32; 6]| {
        let mut all = nights(took_ms.len(), 1, |_| USUAL_M);
        for (night, ms) in all.iter_mut().zip(took_ms) {
            let measured = night.scenarios.get_mut(SCENARIO).unwrap();
            measured
                .values
                .insert(Metric::Provisioning, vec![f64::from(ms) / 1e3]);
        }
        let metrics: Vec<Metric> = series_of(&all)
            .iter()
            .map(|series| series.metric.clone())
            .collect();
        metrics
    };
    assert_eq!(with([1, 1, 1, 1, 1, 2]), [Metric::TrackingError]);
    assert_eq!(
        with([1, 1, 1, 1, 1, 90]),
        [Metric::TrackingError, Metric::Provisioning]
    );
}

fn without_windows(night: &mut Night, lack: MissingData) {
    let measured = night.scenarios.get_mut(SCENARIO).unwrap();
    measured.values.clear();
    measured.lack = Some(lack);
}

fn judged(nights: &[Night]) -> Judgement {
    judged_with(nights, &Settings::default())
}

fn judged_with(nights: &[Night], settings: &Settings) -> Judgement {
    let drift = history::judge(nights, settings);
    assert_eq!(drift.judgements.len(), 1);
    drift.judgements[0].clone()
}

fn level(finding: &Finding) -> LevelChange {
    match finding.change {
        Change::Level(level) => level,
        Change::Content(_) => panic!("{finding:?}"),
    }
}

fn detectable(verdict: &Verdict) -> f64 {
    match verdict {
        Verdict::NoDrift { detectable } => detectable.unwrap(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn nights_alike_have_no_drift_and_it_is_said_what_would_have_been_found() {
    let judgement = judged(&nights(30, 1, |_| USUAL_M));
    let detectable = detectable(&judgement.verdict);
    assert!((3.0..8.0).contains(&(detectable / SPREAD_M)), "{detectable}");
    assert!(judgement.findings.is_empty());
    assert!(detectable < self::detectable(&judged(&nights(8, 1, |_| USUAL_M)).verdict));
}

#[test]
fn what_would_have_been_found_is_known_from_the_nights_before() {
    let with_newest = |off_m: f64| {
        let level_m = |number: usize| USUAL_M + if number == 7 { off_m } else { 0.0 };
        detectable(&judged(&nights(8, 1, level_m)).verdict)
    };
    assert_eq!(with_newest(0.0), with_newest(2.0 * SPREAD_M));
}

#[rstest]
#[case::in_the_night_itself(20)]
#[case::a_night_later(21)]
#[case::two(22)]
#[case::three(23)]
#[case::four(24)]
#[case::when_it_is_a_change_point(25)]
#[case::long_after(60)]
fn a_jump_is_told_in_its_night_and_ever_since(#[case] newest: usize) {
    let all = nights(60, 5, |number| USUAL_M + if number >= 20 { 0.012 } else { 0.0 });
    let judgement = judged(&all[..newest + usize::from(newest < 60)]);
    assert_eq!(judgement.verdict, Verdict::Drift, "{judgement:?}");
    let [finding] = &judgement.findings[..] else {
        panic!("{judgement:?}")
    };
    assert_eq!(
        (finding.kind, finding.before.as_str(), finding.since.as_str()),
        (Kind::Jump, "night-019", "night-020")
    );
    assert!((level(finding).since - level(finding).before - 0.012).abs() < 0.003);
    assert!(level(finding).p < 0.01);
}

// Of nights that do not differ nobody can say how rare another is: with so few, it may be one in twelve.
#[test]
fn a_night_that_differs_from_nights_that_are_all_the_same_is_no_pass_and_told_with_both_numbers() {
    let all: Vec<Night> = (0..12)
        .map(|number| night(number, if number < 11 { USUAL_M } else { USUAL_M * 100.0 }))
        .collect();
    let reason = |nights: &[Night]| match judged(nights).verdict {
        Verdict::TooLittle { reason } => reason,
        other => panic!("{other:?}"),
    };
    assert_eq!(reason(&all[..11]), "all nights have the very same number");
    let told = reason(&all);
    assert!(
        told.starts_with("the first 11 nights have the very same number, 200")
            && told.contains("and the newest has 20000"),
        "{told}"
    );
}

#[test]
fn the_page_of_a_history_has_the_change_first_how_to_acknowledge_it_and_each_night_as_a_dot() {
    let mut all = nights(30, 5, |number| USUAL_M + if number >= 20 { 0.012 } else { 0.0 });
    for night in all.iter_mut().skip(20) {
        let measured = night.scenarios.get_mut(SCENARIO).unwrap();
        runs_on(measured, kernel("6.12 <b>"));
    }
    let page = history::judge(&all, &Settings::default()).page(&all);
    let place = |words: &str| page.find(words).unwrap_or_else(|| panic!("{words}: {page}"));
    assert!(place("Drift in night-029") < place("jumped from 200"));
    assert!(place("jumped from 200") < place("since: &quot;night-020&quot;"));
    // Ninety days after the newest night.
    assert!(
        page.contains("expires: 2026-05-03") && page.contains("baseline: keep"),
        "{page}"
    );
    assert!(place("class=\"news\"") > place("<section"), "{page}");
    let dots = page.split("class=\"dots\" d=\"").nth(1).unwrap();
    assert_eq!(dots.split('"').next().unwrap().matches("h0").count(), 30);
    assert!(page.contains("kernel 6.1 → 6.12 &lt;b&gt;"), "{page}");
    // The name of SVG's language is no address that is fetched.
    for word in ["http:", "https:", "src=", "<script", "url("] {
        assert!(!page.contains(word), "{word}");
    }
}

#[test]
fn a_year_of_a_large_laboratory_is_drawn_in_five_seconds_on_a_page_of_less_than_five_megabytes() {
    let mut all = nights(365, 1, |_| USUAL_M);
    for night in &mut all {
        let measured = night.scenarios.remove(SCENARIO).unwrap();
        let levels = measured.values[&Metric::TrackingError].clone();
        for scenario in 0..50 {
            let mut one = measured.clone();
            one.values = Metric::OURS
                .into_iter()
                .map(|metric| (metric, levels.clone()))
                .collect();
            night.scenarios.insert(format!("scenario-{scenario}"), one);
        }
    }
    // What is judged is drawn: the judging itself takes longer, and is not what this is about.
    let judgement = judged(&nights(30, 1, |_| USUAL_M));
    let drift = Drift {
        nights: all.iter().map(|night| night.run.clone()).collect(),
        newest: String::new(),
        judgements: (0..50)
            .flat_map(|scenario| Metric::OURS.into_iter().map(move |metric| (scenario, metric)))
            .map(|(scenario, metric)| Judgement {
                scenario: format!("scenario-{scenario}"),
                metric,
                ..judgement.clone()
            })
            .collect(),
        remarks: Vec::new(),
    };
    let begun = Instant::now();
    let page = drift.page(&all);
    let took = begun.elapsed();
    assert_eq!(page.matches("<svg").count(), 250);
    assert!(page.len() < 5_000_000, "{} bytes", page.len());
    // Without optimisation, and some ten times as fast on a machine with nothing else to do.
    assert!(took < Duration::from_secs(5), "{took:?}");
}

#[test]
fn one_night_far_off_is_told_once() {
    let all = nights(40, 2, |number| USUAL_M + if number == 30 { 0.02 } else { 0.0 });
    assert_eq!(judged(&all[..31]).verdict, Verdict::Drift);
    for newest in 32..=40 {
        let judgement = judged(&all[..newest]);
        assert!(
            matches!(judgement.verdict, Verdict::NoDrift { .. }),
            "{newest}: {judgement:?}"
        );
        let [finding] = &judgement.findings[..] else {
            panic!("it stays said that it was told: {judgement:?}")
        };
        assert_eq!(finding.withdrawn.as_deref(), Some("night-031"));
    }
    let text = history::judge(&all, &Settings::default()).text();
    assert!(text.contains("withdrawn with night-031"), "{text}");
}

#[test]
fn what_goes_up_by_little_each_night_is_found_as_a_slope() {
    let judgement = judged(&nights(60, 3, |number| USUAL_M + 0.000_1 * number as f64));
    assert_eq!(judgement.verdict, Verdict::Drift, "{judgement:?}");
    let kinds: Vec<Kind> = judgement.findings.iter().map(|finding| finding.kind).collect();
    assert_eq!(kinds, [Kind::Slope]);
    let finding = &judgement.findings[0];
    assert!(
        level(finding).since - level(finding).before > 0.004,
        "{finding:?}"
    );
}

#[test]
fn a_small_jump_is_found_after_some_nights() {
    let judgement = judged(&nights(60, 6, |number| {
        USUAL_M + if number >= 30 { 0.003 } else { 0.0 }
    }));
    let [finding] = &judgement.findings[..] else {
        panic!("{judgement:?}")
    };
    assert!(
        ("night-028".."night-033").contains(&finding.since.as_str()),
        "{finding:?}"
    );
}

#[rstest]
#[case::invalid(MissingData::Invalid("window 1: late".to_owned()), Verdict::Invalid { reason: "window 1: late".to_owned() })]
#[case::errored(MissingData::Absent("errored: no engine".to_owned()), Verdict::TooLittle { reason: "errored: no engine".to_owned() })]
#[case::infeasible(MissingData::NotAsked("infeasible: no engine".to_owned()), Verdict::TooLittle { reason: "infeasible: no engine".to_owned() })]
fn a_newest_night_without_a_number_is_never_a_pass(#[case] lack: MissingData, #[case] verdict: Verdict) {
    let mut all = nights(30, 1, |_| USUAL_M);
    without_windows(all.last_mut().unwrap(), lack);
    assert_eq!(judged(&all).verdict, verdict);
}

#[test]
fn an_earlier_night_without_a_number_is_left_out() {
    let mut all = nights(30, 1, |_| USUAL_M);
    without_windows(&mut all[10], MissingData::Invalid("window 1: late".to_owned()));
    let judgement = judged(&all);
    assert!(matches!(judgement.verdict, Verdict::NoDrift { .. }));
    assert_eq!(judgement.nights, 29);
}

#[rstest]
#[case(1)]
#[case(4)]
fn a_few_nights_are_too_little(#[case] count: usize) {
    let judgement = judged(&nights(count, 1, |_| USUAL_M));
    let Verdict::TooLittle { reason } = judgement.verdict else {
        panic!("{judgement:?}")
    };
    assert!(reason.contains("takes 4"), "{reason}");
}

#[test]
fn nothing_to_judge_is_too_little() {
    let drift = history::judge(&[], &Settings::default());
    assert!(matches!(drift.verdict(), Verdict::TooLittle { .. }));
    assert!(drift.junit().contains("nothing was judged"));
}

#[test]
fn what_was_never_to_be_measured_is_not_judged() {
    let mut all = nights(10, 1, |_| USUAL_M);
    for night in &mut all {
        let mut other = night.scenarios[SCENARIO].clone();
        other.values.clear();
        other.lack = Some(MissingData::NotAsked("infeasible: no VirtualBox".to_owned()));
        night
            .scenarios
            .insert("x86_64-debian-12-virtualbox".to_owned(), other);
    }
    assert_eq!(judged(&all).scenario, SCENARIO);
}

fn jump_with(change: impl Fn(&mut Measured)) -> Cause {
    let mut all = nights(40, 5, |number| USUAL_M + if number >= 20 { 0.012 } else { 0.0 });
    for night in &mut all[20..] {
        change(night.scenarios.get_mut(SCENARIO).unwrap());
    }
    judged(&all).findings[0].cause.clone()
}

#[test]
fn a_change_of_what_was_asked_for_is_told_from_one_of_what_it_runs_on() {
    assert_eq!(
        jump_with(|measured| {
            let mut configuration = measured.configuration.read();
            configuration["workload_sha256"] = json!("bb");
            measured.configuration = Compact::of(&configuration);
            runs_on(measured, kernel("6.12"));
        }),
        Cause::Configuration(vec!["workload_sha256".to_owned()])
    );
    let Cause::Infrastructure(differences) = jump_with(|measured| {
        runs_on(measured, kernel("6.12"));
    }) else {
        panic!("it is the infrastructure")
    };
    assert_eq!(differences[0].field, "platform.kernel");
    assert_eq!(jump_with(|_| ()), Cause::Unexplained);
}

fn known(baseline: Baseline, expires: &str) -> Settings {
    Settings {
        acknowledgements: Acknowledgements {
            acknowledged: vec![Acknowledgement {
                scenario: SCENARIO.to_owned(),
                metric: "*".to_owned(),
                since: "night-020".to_owned(),
                reason: "the kernel is 6.12 now".to_owned(),
                person: "Ada".to_owned(),
                expires: expires.to_owned(),
                baseline,
            }],
        },
        ..Settings::default()
    }
}

#[test]
fn what_is_acknowledged_is_not_told_again_until_it_expires() {
    let all = nights(40, 5, |number| USUAL_M + if number >= 20 { 0.012 } else { 0.0 });
    let judgement = judged_with(&all, &known(Baseline::Keep, "2027-01-01"));
    assert!(
        matches!(judgement.verdict, Verdict::NoDrift { .. }),
        "{judgement:?}"
    );
    assert_eq!(judgement.findings.len(), 1, "it is still there to be seen");
    let expired = judged_with(&all, &known(Baseline::Keep, "2026-01-01"));
    assert_eq!(expired.verdict, Verdict::Drift);
}

#[rstest]
fn a_single_night_that_is_known_leaves_the_way_back_from_it_untold(
    #[values(Baseline::Keep, Baseline::Reset)] baseline: Baseline,
    // In standard deviations of nights.
    #[values(5.0, 6.0, 8.0, 10.0, 20.0)] size: f64,
    // Versions before told of the way back, and of nothing else once that was acknowledged.
    #[values(None, Some("night-021"), Some("night-022"))] way_back: Option<&str>,
) {
    let off_m = size * SPREAD_M;
    let all = nights(40, 5, |number| USUAL_M + if number == 20 { off_m } else { 0.0 });
    let mut known = known(baseline, "2027-01-01");
    let acknowledged = &mut known.acknowledgements.acknowledged;
    if let Some(since) = way_back {
        let entry = Acknowledgement {
            since: since.to_owned(),
            baseline: Baseline::Keep,
            ..acknowledged[0].clone()
        };
        acknowledged.push(entry);
    }
    for newest in 20..40 {
        let judgement = judged_with(&all[..=newest], &known);
        assert_ne!(judgement.verdict, Verdict::Drift, "{newest}: {judgement:?}");
        // One that is told in its night stays shown.
        if baseline == Baseline::Keep && size >= 8.0 {
            let mut findings = judgement.findings.iter();
            let finding = findings.find(|finding| finding.since == "night-020");
            let finding = finding.expect("it stays shown");
            assert!(finding.acknowledged.is_some());
            if way_back.is_none() {
                let withdrawn = (newest > 20).then_some("night-021");
                assert_eq!(finding.withdrawn.as_deref(), withdrawn, "{newest}");
                assert_eq!(judgement.findings.len(), 1, "{judgement:?}");
            }
        }
    }
}

#[rstest]
#[case::in_its_night(20)]
#[case::a_night_later(21)]
#[case::two(22)]
#[case::three(23)]
#[case::four(24)]
#[case::five(25)]
#[case::nine(29)]
#[case::nineteen(39)]
fn a_change_that_is_known_is_quiet_and_still_shown_in_every_night_since(#[case] newest: usize) {
    let all = nights(40, 5, |number| USUAL_M + if number >= 20 { 0.012 } else { 0.0 });
    let judgement = judged_with(&all[..=newest], &known(Baseline::Keep, "2027-01-01"));
    assert!(
        matches!(judgement.verdict, Verdict::NoDrift { .. }),
        "{judgement:?}"
    );
    let [finding] = &judgement.findings[..] else {
        panic!("{judgement:?}")
    };
    assert_eq!(finding.since, "night-020");
    assert!((level(finding).since - level(finding).before - 0.012).abs() < 0.003);
}

// A change that is known at night 20, by 0.012, and what comes after it.
#[rstest]
#[case::much_larger_a_night_later(21, 0.5)]
#[case::back_and_further_a_night_later(21, -0.03)]
#[case::two_nights_later(22, 0.05)]
#[case::three_nights_later(23, 0.05)]
#[case::ten_nights_later(30, 0.05)]
#[case::down_ten_nights_later(30, -0.03)]
fn a_change_after_one_that_is_known_is_told_in_its_night_and_ever_since(
    #[case] next: usize,
    #[case] level_m: f64,
) {
    let level = |number| match number {
        0..20 => USUAL_M,
        _ if number < next => USUAL_M + 0.012,
        _ => USUAL_M + level_m,
    };
    let all = nights(60, 5, level);
    let known = known(Baseline::Keep, "2027-01-01");
    for newest in next..60 {
        let judgement = judged_with(&all[..=newest], &known);
        assert_eq!(judgement.verdict, Verdict::Drift, "night {newest}: {judgement:?}");
    }
    let before = judged_with(&all[..next], &known);
    assert!(matches!(before.verdict, Verdict::NoDrift { .. }), "{before:?}");
}

#[test]
fn nights_after_a_change_that_is_known_are_seldom_called_another() {
    let known = known(Baseline::Keep, "2027-01-01");
    let mut told = 0;
    for seed in 100..150 {
        let all = nights(40, seed, |number| {
            USUAL_M + if number >= 20 { 0.012 } else { 0.0 }
        });
        let findings = judged_with(&all, &known).findings;
        told += findings
            .iter()
            .filter(|finding| finding.since.as_str() > "night-020")
            .count();
    }
    // 950 nights, in each of which one in a hundred may be told of: 99.9 % of a Poisson of 9.5 lies below 20.
    assert!(told < 20, "{told}");
}

#[test]
fn what_would_have_been_found_is_of_the_nights_since_a_change_that_is_known() {
    let all = nights(40, 5, |number| USUAL_M + if number >= 20 { 0.5 } else { 0.0 });
    let known = known(Baseline::Keep, "2027-01-01");
    for newest in [21, 23, 25, 39] {
        let detectable = detectable(&judged_with(&all[..=newest], &known).verdict);
        assert!(
            (3.0..20.0).contains(&(detectable / SPREAD_M)),
            "{newest}: {detectable}"
        );
    }
}

#[test]
fn a_drift_that_nobody_knows_of_is_still_one_in_a_night_without_a_number() {
    let mut all = nights(30, 5, |number| USUAL_M + if number >= 20 { 0.012 } else { 0.0 });
    without_windows(
        all.last_mut().unwrap(),
        MissingData::Invalid("window 1: late".to_owned()),
    );
    let drift = history::judge(&all, &Settings::default());
    assert_eq!(drift.verdict(), Verdict::Drift);
    assert!(
        drift.remarks[0].contains("no number (invalid measurement: window 1: late)"),
        "{drift:?}"
    );
    let known = history::judge(&all, &known(Baseline::Keep, "2027-01-01"));
    assert!(matches!(known.verdict(), Verdict::Invalid { .. }), "{known:?}");
}

#[test]
fn a_scenario_that_is_not_measured_any_more_is_no_pass_until_somebody_says_that_it_is_meant() {
    let mut all = nights(30, 1, |_| USUAL_M);
    for night in &mut all[..20] {
        let measured = night.scenarios[SCENARIO].clone();
        night.scenarios.insert("gone".to_owned(), measured);
    }
    let drift = history::judge(&all, &Settings::default());
    let [_, gone] = &drift.judgements[..] else {
        panic!("{drift:?}")
    };
    assert_eq!((gone.scenario.as_str(), gone.nights), ("gone", 20));
    assert!(matches!(drift.verdict(), Verdict::TooLittle { .. }), "{drift:?}");

    let mut meant = known(Baseline::Keep, "2027-01-01");
    meant.acknowledgements.acknowledged[0].scenario = "gone".to_owned();
    let drift = history::judge(&all, &meant);
    assert_eq!(drift.judgements.len(), 1);
    assert!(matches!(drift.verdict(), Verdict::NoDrift { .. }), "{drift:?}");
    meant.acknowledgements.acknowledged[0].since = "night-019".to_owned();
    let had_it = history::judge(&all, &meant);
    assert_eq!(had_it.judgements.len(), 2, "that run had it: {had_it:?}");
}

#[test]
fn a_baseline_that_was_reset_begins_with_the_change() {
    let level = |number| match number {
        0..20 => USUAL_M,
        20..35 => USUAL_M + 0.012,
        _ => USUAL_M,
    };
    let all = nights(45, 5, level);
    let reset = known(Baseline::Reset, "2027-01-01");
    let before = judged_with(&all[..35], &reset);
    assert!(matches!(before.verdict, Verdict::NoDrift { .. }), "{before:?}");
    assert_eq!((before.nights, before.findings.len()), (15, 0));
    // Back where it was is a change from what is usual now.
    assert_eq!(judged_with(&all, &reset).verdict, Verdict::Drift);
}

#[test]
fn a_change_that_does_not_matter_is_no_drift() {
    let all = nights(40, 5, |number| USUAL_M + if number >= 20 { 0.012 } else { 0.0 });
    let judgement = judged_with(
        &all,
        &Settings {
            equivalence_margins: BTreeMap::from([(Metric::TrackingError, 0.05)]),
            ..Settings::default()
        },
    );
    assert!(matches!(judgement.verdict, Verdict::NoDrift { .. }));
    assert!(judgement.findings[0].immaterial);
}

fn against_baseline(baseline: usize, candidate_m: f64) -> Judgement {
    let mut all = nights(baseline, 6, |_| USUAL_M);
    all.push(night(99, candidate_m));
    baseline::judge(&all, &Settings::default()).judgements[0].clone()
}

#[test]
fn a_night_is_judged_against_what_the_baselines_nights_differ_by_anyway() {
    assert!(matches!(
        against_baseline(8, USUAL_M + 0.001).verdict,
        Verdict::NoDrift { .. }
    ));
    let judgement = against_baseline(8, USUAL_M + 0.02);
    assert_eq!(judgement.verdict, Verdict::Drift, "{judgement:?}");
    assert_eq!(judgement.findings[0].kind, Kind::FromBaseline);
}

#[rstest]
#[case::a_little_longer(8, false)]
#[case::much_longer(90, true)]
fn against_a_baseline_that_is_the_same_to_the_millisecond_only_what_it_cannot_hide_is_drift(
    #[case] took_ms: u32,
    #[case] is_drift: bool,
) {
    let mut all = nights(5, 1, |_| USUAL_M);
    for (night, ms) in all.iter_mut().zip([5, 5, 5, 5, took_ms]) {
        let measured = night.scenarios.get_mut(SCENARIO).unwrap();
        let values = &mut measured.values;
        values.insert(Metric::Provisioning, vec![f64::from(ms) / 1e3]);
    }
    let judged = baseline::judge(&all, &Settings::default());
    let provisioning = judged
        .judgements
        .iter()
        .find(|judgement| judgement.metric == Metric::Provisioning);
    let verdict = &provisioning.unwrap().verdict;
    match is_drift {
        true => assert_eq!(*verdict, Verdict::Drift),
        false => assert!(matches!(verdict, Verdict::NoDrift { .. }), "{verdict:?}"),
    }
}

#[test]
fn of_a_candidate_only_what_was_said_of_itself_is_known() {
    let mut all = nights(24, 6, |_| USUAL_M);
    all.push(night(99, USUAL_M + 0.5));
    let mut settings = known(Baseline::Keep, "2027-01-01");
    for (since, verdict) in [
        ("night-023", Verdict::Drift),
        ("night-022", Verdict::Drift),
        (
            "night-099",
            Verdict::NoDrift {
                detectable: Some(0.0),
            },
        ),
    ] {
        since.clone_into(&mut settings.acknowledgements.acknowledged[0].since);
        let found = baseline::judge(&all, &settings).verdict();
        assert_eq!(found.name(), verdict.name(), "{since}");
    }
}

#[test]
fn four_windows_against_four_cannot_reach_a_hundredth_and_it_is_said() {
    let judgement = against_baseline(1, USUAL_M + 0.5);
    let Verdict::TooLittle { reason } = judgement.verdict else {
        panic!("{judgement:?}")
    };
    assert!(reason.contains("give 4 runs as the baseline"), "{reason}");
}

#[test]
fn with_three_nights_windows_are_the_units_and_that_is_remarked() {
    let mut all = nights(3, 6, |_| USUAL_M);
    all.push(night(99, USUAL_M + 0.02));
    let drift = baseline::judge(&all, &Settings::default());
    assert_eq!(drift.verdict(), Verdict::Drift, "{drift:?}");
    assert!(drift.remarks[0].contains("windows are the units"));
}

#[test]
fn drift_anywhere_is_the_verdict_and_no_drift_only_if_nothing_else_is() {
    let judgement = |verdict| Judgement {
        scenario: SCENARIO.to_owned(),
        metric: Metric::TrackingError,
        verdict,
        nights: 9,
        findings: Vec::new(),
    };
    let reason = || "r".to_owned();
    let none = Verdict::NoDrift {
        detectable: Some(0.001),
    };
    let all = [
        none.clone(),
        Verdict::TooLittle { reason: reason() },
        Verdict::Invalid { reason: reason() },
        Verdict::Drift,
    ];
    for worst in 0..all.len() {
        let drift = Drift {
            newest: String::new(),
            nights: vec![],
            judgements: all[..=worst].iter().cloned().map(judgement).collect(),
            remarks: vec![],
        };
        assert_eq!(drift.verdict(), all[worst]);
    }
}

/// The shares of histories in which something is told on their last night that was not before.
fn told(histories: u64, count: usize, settings: &Settings, level_m: impl Fn(usize) -> f64) -> f64 {
    let told = (0..histories)
        .filter(|seed| {
            let all = nights(count, 1000 + seed, &level_m);
            let findings = |nights: &[Night]| judged_with(nights, settings).findings.len();
            findings(&all) > findings(&all[..count - 1])
        })
        .count();
    told as f64 / histories as f64
}

#[test]
fn false_findings_are_as_seldom_as_asked_for_and_what_was_said_to_be_found_is() {
    let settings = Settings {
        alpha: 0.05,
        ..Settings::default()
    };
    // Of a binomial of 200 at 0.05, 99.9 % lies below 23.
    let false_alarms = told(200, 30, &settings, |_| USUAL_M);
    assert!(false_alarms <= 22.0 / 200.0, "{false_alarms}");
    let detectable = detectable(&judged_with(&nights(30, 1, |_| USUAL_M), &settings).verdict);
    let found = told(200, 31, &settings, |number| {
        USUAL_M + if number == 30 { detectable } else { 0.0 }
    });
    // Of one at 0.8, above 0.7; what one history says of its own spread is not that of all.
    assert!(found > 0.65, "{found}");
}

#[test]
fn a_slope_that_was_acknowledged_is_not_told_again() {
    let all = nights(90, 3, |number| USUAL_M + 0.000_1 * number as f64);
    let told = judged(&all[..60]);
    let [slope] = &told.findings[..] else {
        panic!("{told:?}")
    };
    let mut settings = known(Baseline::Keep, "2027-01-01");
    slope
        .since
        .clone_into(&mut settings.acknowledgements.acknowledged[0].since);
    for newest in 60..=90 {
        let judgement = judged_with(&all[..newest], &settings);
        assert_ne!(judgement.verdict, Verdict::Drift, "{newest}: {judgement:?}");
    }
}

#[rstest]
#[case(0.001)]
#[case(0.001_5)]
#[case(0.002)]
#[case(0.003)]
fn a_jump_that_was_told_is_told_each_night_until_it_is_acknowledged(#[case] jump_m: f64) {
    for seed in 0..5 {
        let all = nights(100, 70 + seed, |number| {
            USUAL_M + if number >= 60 { jump_m } else { 0.0 }
        });
        let findings = |newest: usize| {
            let mut findings = judged(&all[..newest]).findings;
            findings.retain(|finding| finding.since.as_str() > "night-050");
            findings
        };
        let is_told = |newest: &usize| findings(*newest).iter().any(Finding::is_news);
        let Some(first) = (61..=100).find(is_told) else {
            continue;
        };
        for newest in first..=100 {
            let is_withdrawn = findings(newest).iter().any(|finding| finding.withdrawn.is_some());
            assert!(is_told(&newest) || is_withdrawn, "seed {seed}, night {newest}");
        }

        // As it is named in the night in which it is told, whatever its place is called later.
        let mut settings = known(Baseline::Keep, "2027-01-01");
        let named = findings(first).last().unwrap().since.clone();
        settings.acknowledgements.acknowledged[0].since = named;
        let again = (first..=100).find(|newest| {
            let judgement = judged_with(&all[..*newest], &settings);
            let is_of_it = |finding: &&Finding| finding.is_news() && finding.since.as_str() > "night-050";
            judgement.findings.iter().any(|finding| is_of_it(&finding))
        });
        assert_eq!(again, None, "seed {seed}");
    }
}

#[test]
fn nights_that_resemble_each_other_are_remarked_on() {
    let alike = history::judge(&nights(120, 1, |_| USUAL_M), &Settings::default());
    assert!(alike.remarks.is_empty(), "{alike:?}");
    let levels = Noise::new(5).ar1(120, 0.7);
    let all: Vec<Night> = levels
        .iter()
        .enumerate()
        .map(|(number, level)| night(number, USUAL_M + SPREAD_M * level))
        .collect();
    let drift = history::judge(&all, &Settings::default());
    assert!(
        drift
            .remarks
            .iter()
            .any(|remark| remark.contains("resembles the one before")),
        "{drift:?}"
    );
}

#[test]
fn what_a_host_says_of_itself_mentions_nobody_in_a_chat() {
    let mut all = nights(40, 5, |number| USUAL_M + if number >= 20 { 0.012 } else { 0.0 });
    for night in &mut all[20..] {
        let measured = night.scenarios.get_mut(SCENARIO).unwrap();
        runs_on(measured, kernel("<!channel> & <https://evil|here>"));
    }
    let body = history::judge(&all, &Settings::default()).webhook();
    let text = body["text"].as_str().unwrap();
    assert!(
        text.contains("&lt;!channel&gt; &amp; &lt;https://evil|here&gt;"),
        "{text}"
    );
    assert!(!text.contains(['<', '>']), "{text}");
}

#[test]
fn what_is_printed_says_what_changed_and_with_what() {
    let mut all = nights(40, 5, |number| USUAL_M + if number >= 20 { 0.012 } else { 0.0 });
    for night in &mut all {
        let mut other = night.scenarios[SCENARIO].clone();
        other.values.clear();
        other.lack = Some(MissingData::Absent(
            "errored: the engine | does not <answer>".to_owned(),
        ));
        night
            .scenarios
            .insert("x86_64-debian-12-native".to_owned(), other);
    }
    for night in &mut all[20..] {
        let measured = night.scenarios.get_mut(SCENARIO).unwrap();
        runs_on(measured, kernel("6.12"));
    }
    let drift = history::judge(&all, &Settings::default());
    insta::assert_snapshot!("text", drift.text());
    insta::assert_snapshot!("junit", drift.junit());
    insta::assert_snapshot!("github_annotations", drift.github_annotations());
    insta::assert_snapshot!("github_summary", drift.github_summary());
    insta::assert_snapshot!("webhook", format!("{:#}", drift.webhook()));
    assert!(drift.text().lines().all(|line| line.chars().count() <= 80));
}
