//! The packets between controller and plant: what became of them, the counts that the tracking error has, and which of
//! their quantities go with a difference in error.

use std::collections::BTreeSet;

use captures::{
    packets::Topic,
    traffic::{DirectionTraffic, PeriodTraffic, Quantity, ScenarioTraffic, Spread, together},
};

use super::{MOST_ROWS, NO_DATA, Table, first_of, no_data_note, texts};
use crate::{
    analysis::{
        packet_counts::TrafficTally,
        packet_explanations::{Explanation, Factor},
        pairs::OfPair as _,
        report::Report,
    },
    present::listing::listed,
};

/// How many factors are named for each pair.
const NAMED: usize = 3;

/// The tables; none if no scenario has captures.
pub(super) fn of(report: &Report) -> Vec<Table> {
    if report.traffic.scenarios.is_empty() {
        return Vec::new();
    }
    vec![summary(report), counts(report), explained(report)]
}

fn summary(report: &Report) -> Table {
    let mut rows = Vec::new();
    for scenario in &report.scenarios {
        let found = report.traffic.scenarios.get(&scenario.id);
        for topic in Topic::ALL {
            let mut row = vec![scenario.id.clone(), topic.name().to_owned()];
            row.extend(found.and_then(|found| cells(found, topic)).unwrap_or_else(|| {
                let mut none = vec!["–".to_owned(); 7];
                none.push(NO_DATA.to_owned());
                none
            }));
            rows.push(row);
        }
    }
    let mut notes = vec![
        "Times in ms. State: from plant to controller; command: back. A packet is a TCP segment with data. Delay: from the \
         sender's capture to the receiver's, mean, and what 99 % do not exceed. RTT: until it was acknowledged, mean. \
         Jitter: mean |D| of RFC 3550. Gap: the longest time without an arrival. Lost: of the packets sent; retr.: \
         retransmitted. Over the windows that count; `packets.csv` has every period."
            .to_owned(),
    ];
    notes.extend(behind_the_delay(report));
    notes.extend(no_data_note(report.scenarios.iter()));
    Table {
        id: "packets-between-controller-and-plant".to_owned(),
        title: "Packets between controller and plant".to_owned(),
        columns: texts(&[
            ("", false),
            ("topic", false),
            ("sent", true),
            ("delay", true),
            ("99 %", true),
            ("RTT", true),
            ("jitter", true),
            ("gap", true),
            ("lost", true),
            ("retr.", true),
        ]),
        rows,
        notes,
    }
}

/// A note on the scenarios whose captures do not see the whole way.
fn behind_the_delay(report: &Report) -> Option<String> {
    let partial: Vec<&str> = report
        .scenarios
        .iter()
        .filter(|scenario| {
            let network = scenario.experiment.network();
            network.is_some_and(|network| !network.facts().captures_see_the_whole_way)
        })
        .map(|scenario| scenario.id.as_str())
        .collect();
    (!partial.is_empty()).then(|| {
        format!(
            "The kernel delays packets before they are captured where they are sent: of {} the delays and losses are those \
             of the second half of the way, and are not to be held against those of other scenarios.",
            listed(&partial)
        )
    })
}

/// What one direction of a scenario comes to, over its windows; none without a packet.
fn cells(found: &ScenarioTraffic, topic: Topic) -> Option<Vec<String>> {
    let total = |count: fn(&PeriodTraffic) -> u32| -> u64 {
        found
            .directions(topic)
            .map(|direction| direction.total(count))
            .sum()
    };
    let sent = total(|period| period.sent);
    if sent == 0 {
        return None;
    }
    let mean = |of: fn(&DirectionTraffic) -> Option<&Spread>| {
        let spreads = found.spreads(topic, of);
        let count: u64 = spreads.iter().map(|spread| spread.count).sum();
        let sum: f64 = spreads
            .iter()
            .map(|spread| spread.mean_s * spread.count as f64)
            .sum();
        (count > 0).then(|| sum / count as f64)
    };
    let curve = together(&found.spreads(topic, |direction| direction.one_way.as_ref()));
    let p99_s = curve
        .iter()
        .find(|(_, share)| *share >= 0.99)
        .map(|(time_s, _)| *time_s);
    let gaps = found.spreads(topic, |direction| direction.gap.as_ref());
    let longest_gap_s = gaps.iter().map(|gap| gap.max_s).reduce(f64::max);
    Some(vec![
        sent.to_string(),
        milliseconds(mean(|direction| direction.one_way.as_ref())),
        milliseconds(p99_s),
        milliseconds(mean(|direction| direction.rtt.as_ref())),
        milliseconds(mean(|direction| direction.jitter.as_ref())),
        milliseconds(longest_gap_s),
        format!(
            "{:.2} %",
            total(|period| period.lost) as f64 / sent as f64 * 100.0
        ),
        total(|period| period.retransmitted).to_string(),
    ])
}

fn milliseconds(seconds: Option<f64>) -> String {
    match seconds.map(|seconds| seconds * 1e3) {
        None => "–".to_owned(),
        Some(ms) if ms.abs() >= 99.95 => format!("{ms:.0}"),
        Some(ms) if ms.abs() >= 9.995 => format!("{ms:.1}"),
        Some(ms) => format!("{ms:.2}"),
    }
}

fn letters(one: &TrafficTally) -> impl Iterator<Item = (&str, &str)> {
    one.tallies.iter().map(|tally| tally.letters())
}

/// Every pair that any quantity has been compared of.
fn compared_pairs(tallies: &[TrafficTally]) -> Vec<(&str, &str)> {
    let Some((first, others)) = tallies.split_first() else {
        return Vec::new();
    };
    let mut pairs: Vec<(&str, &str)> = letters(first).collect();
    // Nearly always these are the same, of which a sweep has a million.
    let others = others.iter().filter(|one| !letters(one).eq(letters(first)));
    let missing: BTreeSet<(&str, &str)> = others
        .flat_map(letters)
        .filter(|(a, b)| first.tallies.find(a, b).is_none())
        .collect();
    pairs.extend(missing);
    pairs
}

fn counts(report: &Report) -> Table {
    let mut pairs = compared_pairs(&report.traffic_tallies);
    // Within the scenarios first.
    pairs.sort_by_key(|(a, b)| (a != b, *a, *b));
    let mut notes = vec![
        "As Tables III to V, with one value a period: the mean of the delays, RTTs and jitters of the packets sent in it, its longest \
         gap, and how many were lost, retransmitted (retr.) and reordered (reord.). Rejected, of N window pairs, by the same test at \
         the same level; what holds of those counts holds of these."
            .to_owned(),
    ];
    let all = pairs.len() * Topic::ALL.len();
    if all > MOST_ROWS {
        notes.insert(0, first_of(all));
        pairs.truncate(MOST_ROWS / Topic::ALL.len());
    }
    let mut rows = Vec::new();
    for (a, b) in pairs {
        for topic in Topic::ALL {
            let tally = |quantity: Quantity| {
                let of = report.traffic_tallies.iter();
                let mut of = of.filter(|one| one.topic == topic && one.quantity == quantity);
                of.next()?.tallies.find(a, b)
            };
            let of = Quantity::ALL.map(tally);
            let most = of.iter().flatten().map(|tally| tally.pairs).max().unwrap_or(0);
            let mut row = vec![
                a.to_owned(),
                b.to_owned(),
                topic.name().to_owned(),
                most.to_string(),
            ];
            row.extend(of.map(|tally| match tally {
                None => NO_DATA.to_owned(),
                Some(tally) if tally.pairs < most => format!("{}/{}", tally.rejected, tally.pairs),
                Some(tally) => tally.rejected.to_string(),
            }));
            rows.push(row);
        }
    }
    Table {
        id: "packet-counts".to_owned(),
        title: "Rejections on the packets, within and between scenarios".to_owned(),
        columns: texts(&[
            ("", false),
            ("", false),
            ("topic", false),
            ("N", true),
            ("delay", true),
            ("RTT", true),
            ("jitter", true),
            ("gap", true),
            ("lost", true),
            ("retr.", true),
            ("reord.", true),
        ]),
        rows,
        notes,
    }
}

fn explained(report: &Report) -> Table {
    let mut rows = Vec::new();
    for one in &report.explanations {
        let told: Vec<&Factor> = one
            .factors
            .iter()
            .filter(|factor| factor.is_told())
            .take(NAMED)
            .collect();
        if told.is_empty() {
            let mut row = vec![
                one.a.clone(),
                one.b.clone(),
                shift(report, one),
                "none is told".to_owned(),
            ];
            row.extend(["–", "–", "–"].map(str::to_owned));
            rows.push(row);
        }
        rows.extend(told.into_iter().map(|factor| explained_row(report, one, factor)));
    }
    Table {
        id: "packet-explanations".to_owned(),
        title: "What of the packets goes with the difference in error".to_owned(),
        columns: texts(&[
            ("", false),
            ("", false),
            (&report.quantity.heading(&report.quantity.name), true),
            ("quantity", false),
            ("differs by", true),
            ("r", true),
            (&report.quantity.heading("part"), true),
        ]),
        rows,
        notes: vec![format!(
            "Of the second scenario against the first, means of window means. Part: of the difference in error, what goes with \
             the difference in the quantity, by the slope of error on it from period to period within windows; r is their \
             correlation there. Intervals of 95 % are over windows; the {NAMED} largest parts whose interval is \
             without 0 are named. It goes with it, which is not to say that it causes it; quantities go with each other \
             too, so parts do not add up."
        )],
    }
}

fn shift(report: &Report, one: &Explanation) -> String {
    report.quantity.signed(one.shift)
}

fn explained_row(report: &Report, one: &Explanation, factor: &Factor) -> Vec<String> {
    let signed = |value: f64| report.quantity.signed(value);
    let interval = factor.explained.part.interval;
    vec![
        one.a.clone(),
        one.b.clone(),
        shift(report, one),
        format!("{} {}", factor.topic.name(), factor.quantity.name()),
        match factor.quantity.is_time() {
            true => format!("{:+.2} ms", factor.explained.difference * 1e3),
            false => format!("{:+.2}", factor.explained.difference),
        },
        format!("{:+.2}", factor.explained.correlation),
        format!(
            "{}{}",
            signed(factor.explained.part.value),
            interval.map_or_else(String::new, |interval| format!(
                " [{}, {}]",
                signed(interval.low),
                signed(interval.high)
            ))
        ),
    ]
}
