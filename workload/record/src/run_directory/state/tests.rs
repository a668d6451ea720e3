use crate::{run_directory::PlannedScenario, settings::Settings};

use super::*;

fn journal(events: Vec<Event>) -> Vec<JournalEntry> {
    events
        .into_iter()
        .map(|event| JournalEntry::new(String::new(), event))
        .collect()
}

fn creating(environment: &str, windows: Vec<u32>) -> Event {
    Event::EnvironmentCreating {
        scenario: "s".into(),
        environment: environment.into(),
        provider: "fake".into(),
        windows,
        resources: Vec::new(),
        round: None,
    }
}

#[test]
fn an_environment_that_was_only_intended_is_still_open() {
    let state = RunState::replay(&journal(vec![creating("e-1", vec![1, 2])]));
    let open = state.scenario("s").round(1).open.unwrap();
    assert_eq!((open.environment.as_str(), open.windows), ("e-1", vec![1, 2]));
}

#[test]
fn an_environment_whose_removal_began_has_nothing_more_to_go_on_with() {
    let discarding = Event::EnvironmentDiscarding {
        scenario: "s".into(),
        environment: "e-1".into(),
    };
    let state = RunState::replay(&journal(vec![creating("e-1", vec![1]), discarding]));
    assert!(state.scenario("s").round(1).open.unwrap().discarding);
}

#[test]
fn collected_windows_are_not_wanted_again_and_a_discarded_environment_is_closed() {
    let state = RunState::replay(&journal(vec![
        creating("e-1", vec![1, 2, 3]),
        Event::WindowCollected {
            scenario: "s".into(),
            environment: "e-1".into(),
            window: 1,
            verdict: Verdict::Valid,
            sha256: None,
        },
        Event::EnvironmentDiscarded {
            scenario: "s".into(),
            environment: "e-1".into(),
        },
    ]));
    let scenario = state.scenario("s");
    assert_eq!(scenario.wanted(1..=3), vec![2, 3]);
    assert_eq!(scenario.open().next(), None);
    assert_eq!(scenario.attempts, 1);
}

#[test]
fn an_environment_was_made_from_its_announcement_to_its_creation() {
    let created = |environment: &str| Event::EnvironmentCreated {
        scenario: "s".into(),
        environment: environment.into(),
        facts: serde_json::Map::new(),
    };
    let events = [
        creating("e-1", vec![1]),
        created("e-1"),
        // A journal of which the announcement is not known.
        created("e-7"),
    ];
    let entries = events
        .into_iter()
        .zip(["t0", "t1", "t2"])
        .map(|(event, at)| JournalEntry::new(at.to_owned(), event));
    let made = RunState::replay(&entries.collect::<Vec<_>>()).scenario("s").made;
    let times: Vec<_> = made
        .iter()
        .map(|made| (made.begun.as_deref(), made.done.as_str()))
        .collect();
    assert_eq!(times, [(Some("t0"), "t1"), (None, "t2")]);
}

#[test]
fn of_very_many_windows_that_broke_the_first_are_kept_and_no_long_words() {
    let broken = |scenario: &str| Event::WindowBroken {
        scenario: scenario.into(),
        environment: "e-1".into(),
        window: 1,
        reason: "r".repeat(2000),
    };
    let mut state = RunState::default();
    for entry in journal(vec![broken("a"), broken("b")])
        .iter()
        .cycle()
        .take(30_000)
    {
        state.apply(entry);
    }
    let words = |state: &ScenarioState| state.broken.iter().map(|it| it.reason.len()).sum::<usize>();
    let (a, b) = (state.scenario("a"), state.scenario("b"));
    assert_eq!((a.broken.len(), a.broken_beside), (5_000, 10_000));
    assert_eq!((b.broken.len(), b.broken_beside), (5_000, 10_000));
    assert!(words(&a) + words(&b) < 11 << 20);
}

#[test]
fn the_checksum_of_a_window_goes_with_the_window() {
    let collected = Event::WindowCollected {
        scenario: "s".into(),
        environment: "e-1".into(),
        window: 1,
        verdict: Verdict::Valid,
        sha256: Some("aa".into()),
    };
    let broken = Event::WindowBroken {
        scenario: "s".into(),
        environment: "e-1".into(),
        window: 1,
        reason: "it is damaged".into(),
    };
    let of = |events| RunState::replay(&journal(events)).scenario("s");
    assert_eq!(of(vec![collected.clone()]).window_sha256(1), Some("aa"));
    let state = of(vec![collected, broken]);
    assert_eq!((state.window_sha256(1), state.broken.len()), (None, 1));
}

#[test]
fn a_run_is_interrupted_while_a_scenario_of_it_has_not_ended() {
    let scenario = |slug: &str| PlannedScenario {
        id: slug.to_owned(),
        slug: slug.to_owned(),
        axes: serde_json::Map::new(),
        pool: Vec::new(),
        host: None,
        feasible: slug != "infeasible",
        reason: None,
        fix: None,
        not_selected: None,
        simulated: false,
        settings: Settings::default(),
    };
    let plan = PlanRecord {
        format: 1,
        scenarios: vec![scenario("s"), scenario("t"), scenario("infeasible")],
        order: Vec::new(),
        later_rounds: Vec::new(),
        measuring_s: 1.0,
    };
    let finished = |slug: &str, outcome| Event::ScenarioFinished {
        scenario: slug.to_owned(),
        outcome,
        reason: None,
        hint: None,
        round: None,
    };
    let is_interrupted = |events| RunState::replay(&journal(events)).is_interrupted(&plan);
    assert!(is_interrupted(vec![finished("s", Outcome::Completed)]));
    for (outcome, interrupted) in [
        (Outcome::Interrupted, true),
        (Outcome::Completed, false),
        (Outcome::Errored, false),
    ] {
        let events = vec![finished("s", Outcome::Completed), finished("t", outcome)];
        assert_eq!(is_interrupted(events), interrupted, "{outcome:?}");
    }
}

#[test]
fn a_scenario_with_an_open_environment_is_not_settled_whatever_its_outcome() {
    let finished = Event::ScenarioFinished {
        scenario: "s".into(),
        outcome: Outcome::Completed,
        reason: None,
        hint: None,
        round: None,
    };
    assert!(
        RunState::replay(&journal(vec![finished.clone()]))
            .scenario("s")
            .is_settled(1..=1)
    );
    let state = RunState::replay(&journal(vec![creating("e-1", vec![1]), finished]));
    assert!(!state.scenario("s").is_settled(1..=1));
}

#[test]
fn a_round_is_settled_and_reopened_without_the_others() {
    let of_round = |round: u32, windows: Vec<u32>| {
        [
            Event::ScenarioStarted {
                scenario: "s".into(),
                windows: windows.clone(),
                round: Some(round),
            },
            Event::ScenarioFinished {
                scenario: "s".into(),
                outcome: Outcome::Completed,
                reason: None,
                hint: None,
                round: Some(round),
            },
        ]
    };
    let mut events = Vec::from(of_round(1, vec![1, 2]));
    events.extend(of_round(2, vec![3, 4]));
    let collected = |window| Event::WindowCollected {
        scenario: "s".into(),
        environment: "e-1".into(),
        window,
        verdict: Verdict::Valid,
        sha256: None,
    };
    events.extend([collected(3), collected(4)]);
    let mut state = RunState::replay(&journal(events));
    assert!(state.scenario("s").is_settled(1..=2));
    assert!(!state.scenario("s").is_settled(1..=3));
    state.apply(
        &journal(vec![Event::WindowBroken {
            scenario: "s".into(),
            environment: "e-1".into(),
            window: 3,
            reason: String::new(),
        }])[0],
    );
    let scenario = state.scenario("s");
    assert!(scenario.round(1).is_settled() && !scenario.round(2).is_settled());
    assert_eq!(scenario.wanted(3..=4), vec![3]);
}
