//! Of runs with several environments a scenario: the test with the environment as the unit, and what adds to the variance.

use statistics::{
    effect::CONFIDENCE,
    variance_components::{Component, Components, Unknown},
};

use super::{Table, contrasts::p, texts};
use crate::{
    analysis::{
        quantity::Quantity,
        replicates::{Advice, EnvironmentContrast, Replicates, ScenarioVariance},
        report::Report,
    },
    present::listing::listed,
};

/// The tables; none where each scenario has one environment.
pub(super) fn of(report: &Report) -> Vec<Table> {
    let tables = report.replicates.as_ref().map(|replicates| {
        let mut tables = Vec::from_iter(environments(report, replicates));
        tables.push(variance(&report.quantity, replicates));
        tables
    });
    tables.unwrap_or_default()
}

fn environments(report: &Report, replicates: &Replicates) -> Option<Table> {
    let row = |pair: &EnvironmentContrast| {
        let signed = |value: f64| report.quantity.signed(value);
        let shift = signed(pair.shift);
        vec![
            pair.a.clone(),
            pair.b.clone(),
            match pair.is_interleaved {
                true => pair.rounds.to_string(),
                false => format!("{} †", pair.rounds),
            },
            match pair.interval {
                Some(it) => format!(
                    "{shift} [{}, {}]{}",
                    signed(it.low),
                    signed(it.high),
                    if pair.is_simultaneous { "" } else { " ‡" }
                ),
                None => shift,
            },
            p(pair.test.p),
            p(pair.p_holm),
            pair.verdict.name().to_owned(),
        ]
    };
    let rows: Vec<Vec<String>> = replicates.pairs.iter().map(row).collect();
    let all = |is: fn(&EnvironmentContrast) -> bool| replicates.pairs.iter().all(is);
    let fewest = replicates
        .pairs
        .iter()
        .map(|pair| pair.smallest_p)
        .fold(0.0, f64::max);
    let alpha = report.settings.alpha;
    let mut notes = vec![format!(
        "p: in each round the two environments exchange their labels, and p is the share of all exchanges whose mean difference of \
         environment means is at least the measured one. It is exact whatever environments do to their windows and whatever drifts \
         over the run, since the order within a round was drawn. Windows are not the units here. Smallest p of these pairs: {}. The \
         verdict is by Holm's p at {alpha}. Shift: of the second against the first, its interval for all pairs together at {}.",
        p(fewest),
        percent(1.0 - alpha)
    )];
    if !all(|pair| pair.is_simultaneous || pair.interval.is_none()) {
        let low = replicates
            .pairs
            .iter()
            .filter_map(|pair| Some(pair.interval?.confidence));
        notes.push(format!(
            "‡ The widest interval that so few rounds have, of {} for its pair alone or more. It decides nothing.",
            percent(low.fold(1.0, f64::min))
        ));
    }
    if !all(|pair| pair.is_interleaved) {
        notes.push(
            "† Measured in different runs, so not interleaved: environments are exchanged between the two scenarios, and what differs \
             between the runs is taken for a difference of the scenarios."
                .to_owned(),
        );
    }
    if !replicates.without.is_empty() {
        let named: Vec<String> = replicates
            .without
            .iter()
            .map(|(a, b)| format!("{a}–{b}"))
            .collect();
        notes.push(format!(
            "No round in common with windows that count: {}.",
            listed(&named)
        ));
    }
    (!rows.is_empty()).then(|| Table {
        id: "the-environment-as-the-unit".to_owned(),
        title: "The environment as the unit".to_owned(),
        columns: texts(&[
            ("", false),
            ("", false),
            ("rounds", true),
            (&report.quantity.heading("shift"), true),
            ("p", true),
            ("Holm", true),
            ("verdict", false),
        ]),
        rows,
        notes,
    })
}

fn variance(quantity: &Quantity, replicates: &Replicates) -> Table {
    let row = |name: &str, number: String, components: &Components| {
        let mut cells = vec![name.to_owned(), number];
        cells.extend(components.0.iter().map(|it| cell(quantity, it)));
        cells
    };
    let of_scenario = |it: &ScenarioVariance| {
        row(
            &it.id,
            format!("{} : {}", it.environments, it.windows),
            &it.components,
        )
    };
    let mut rows: Vec<Vec<String>> = replicates.scenarios.iter().map(of_scenario).collect();
    if let (Some(together), 2..) = (&replicates.together, rows.len()) {
        rows.push(row("all", String::new(), together));
    }
    let mut notes = vec![format!(
        "{} that values add within a window, windows within an environment, and environments within a \
         scenario (Kalibera and Jones 2013), with intervals at {}. A level whose estimated variance is not above 0 adds 0. All: the \
         scenarios together, each around its own mean. What a night adds, `matrix drift` follows.",
        quantity.heading("Standard deviations"),
        percent(CONFIDENCE)
    )];
    notes.extend(replicates.next_hour.as_ref().map(next_hour));
    Table {
        id: "variance-components".to_owned(),
        title: "What adds to the variance".to_owned(),
        columns: texts(&[
            ("", false),
            ("env. : windows", true),
            ("values", true),
            ("windows", true),
            ("environments", true),
        ]),
        rows,
        notes,
    }
}

fn cell(quantity: &Quantity, component: &Result<Component, Unknown>) -> String {
    let magnitude = |deviation: f64| quantity.magnitude(deviation);
    match component {
        Err(unknown) => unknown.name().to_owned(),
        Ok(component) => {
            let spread = magnitude(component.spread());
            match component.interval {
                Some(it) => format!(
                    "{spread} [{}, {}]",
                    magnitude(it.low.sqrt()),
                    magnitude(it.high.sqrt())
                ),
                None => spread,
            }
        }
    }
}

/// Where the next hour goes furthest, in a sentence or two.
fn next_hour(advice: &Advice) -> String {
    let share = |share: f64| format!("{:.0} %", share * 100.0);
    let (next, costs) = (&advice.next, &advice.costs);
    let (what, by, other) = match next.prefers_environments() {
        true => ("another environment", next.by_environments, next.by_windows),
        false => (
            "another window in each environment",
            next.by_windows,
            next.by_environments,
        ),
    };
    let best = match next.best_windows {
        Some(best) => format!(
            "At these costs {best} {} an environment cost least for the same certainty; this run has {}.",
            if best == 1 { "window" } else { "windows" },
            advice.windows
        ),
        None => "Environments add no variance that shows.".to_owned(),
    };
    format!(
        "The next hour of measuring goes furthest in {what}: it takes {} off the variance of a scenario's mean, the other choice {}. A \
         window takes {:.0} s, an environment {:.0} s beside its windows. {best}",
        share(by),
        share(other),
        costs.window_s,
        costs.environment_s
    )
}

fn percent(share: f64) -> String {
    let text = format!("{:.2}", share * 100.0);
    format!("{} %", text.trim_end_matches('0').trim_end_matches('.'))
}
