//! The packets' delays: how they spread, and their means over time, a pair of drawings for each scenario.

use captures::{
    packets::Topic,
    traffic::{ScenarioTraffic, together},
};
use maud::{Markup, html};

use super::{
    MOST_SHOWN, left_out,
    plot::{Axis, Plot},
    swatch,
};
use crate::{
    analysis::{report::Report, scenario::ScenarioReport},
    present::colours,
};

/// Delays beyond this share are not drawn: a single packet that was minutes late would leave the rest no room.
const DRAWN: f64 = 0.995;

pub(super) fn draw(report: &Report) -> Markup {
    let found: Vec<(&ScenarioReport, &ScenarioTraffic)> = report
        .scenarios
        .iter()
        .filter_map(|scenario| Some((scenario, report.traffic.scenarios.get(&scenario.id)?)))
        .collect();
    let of_all = |of: fn(&ScenarioTraffic, Topic) -> Vec<(f64, f64)>, values: fn((f64, f64)) -> f64| {
        let all = found
            .iter()
            .flat_map(|(_, found)| Topic::ALL.map(|topic| of(found, topic)));
        all.flatten().map(values).collect::<Vec<f64>>()
    };
    let delays = Axis::around("delay (ms)", of_all(spread, |(delay, _)| delay).into_iter());
    let means = Axis::around("mean delay (ms)", of_all(course, |(_, delay)| delay).into_iter());
    html! {
        @if let (Some(delays), Some(means)) = (&delays, &means) {
            p {
                "From the sender's capture to the receiver's, states (—) and commands (- -). All drawings have the same scales; the \
                 tables have the numbers."
            }
            (left_out(found.len(), "packets.csv"))
            @for (scenario, found) in found.iter().take(MOST_SHOWN) { (one(report, scenario, found, delays, means)) }
        } @else {
            p { "No scenario has captures of windows that count." }
        }
    }
}

fn one(
    report: &Report,
    scenario: &ScenarioReport,
    found: &ScenarioTraffic,
    delays: &Axis,
    means: &Axis,
) -> Markup {
    let colour = colours::of(report, &scenario.id);
    let name = format!("{} {}", scenario.id, scenario.slug);
    let courses = Topic::ALL.map(|topic| course(found, topic));
    let periods = courses.iter().map(Vec::len).max().unwrap_or(0);
    let spreads = Plot {
        x: delays.clone(),
        y: Axis::from("share at most so large", 0.0..1.0),
    };
    let over_time = Plot {
        x: Axis::from("period", 0.0..periods as f64 + 1.0),
        y: means.clone(),
    };
    html! {
        h3 { (swatch(report, &scenario.id)) (name) }
        div .pairs {
            (spreads.draw(
                &format!("Distribution of the delays of {name}"),
                &lines(&spreads, colour, &Topic::ALL.map(|topic| spread(found, topic)))
            ))
            (over_time.draw(&format!("Mean delay of each period of {name}"), &lines(&over_time, colour, &courses)))
        }
    }
}

fn lines(plot: &Plot, colour: usize, [state, command]: &[Vec<(f64, f64)>; 2]) -> Markup {
    html! {
        polyline class=(format!("curve s{colour}")) points=(plot.line(state.iter().copied())) {}
        polyline class=(format!("curve s{colour} even")) points=(plot.line(command.iter().copied())) {}
    }
}

/// Delays in milliseconds, ascending, each with the share that is no longer.
fn spread(found: &ScenarioTraffic, topic: Topic) -> Vec<(f64, f64)> {
    let curve = together(&found.spreads(topic, |direction| direction.one_way.as_ref()));
    let drawn = curve.into_iter().take_while(|(_, share)| *share <= DRAWN);
    drawn.map(|(delay_s, share)| (delay_s * 1e3, share)).collect()
}

/// The mean delay of each period in milliseconds, by the periods' numbers through all windows.
fn course(found: &ScenarioTraffic, topic: Topic) -> Vec<(f64, f64)> {
    let periods = found.directions(topic).flat_map(|direction| &direction.periods);
    (1_u32..)
        .zip(periods)
        .filter_map(|(number, period)| Some((f64::from(number), period.one_way_s? * 1e3)))
        .collect()
}
