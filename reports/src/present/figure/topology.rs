//! The network: three virtual hosts, the switch between them, and the links with their settings.

use plotters::style::text_anchor::HPos;
use record::settings::{NetworkBackend, NetworkSettings, RosMaster};

use super::{
    Figure, FigureError, Kind, Layout,
    canvas::{About, Area, COLUMN_PT, DrawingError, column_of, drawn},
    schematic::{MOST_DRAWN, Schematic, alike, letters_of, not_drawn, of_the_ball},
};
use crate::input::run::Run;

/// Draws each network of the run once.
pub(super) fn draw(run: &Run, layout: Layout) -> Result<Vec<Figure>, FigureError> {
    // Of other networks a drawing with one description of all links would be wrong.
    let drawable = of_the_ball(run).filter(|scenario| has_equal_links(&scenario.planned.settings.network));
    let groups = alike(drawable, |scenario| {
        let settings = &scenario.planned.settings;
        // What is drawn one way whatever it is, such as a seed, makes no other drawing.
        (
            links(&settings.network),
            settings.network.backend,
            settings.ros.master,
        )
    });
    let shown = groups.iter().take(MOST_DRAWN).enumerate();
    let figures = shown.filter_map(|(at, ((links, backend, master), group))| {
        let first = group.first()?;
        let about = About {
            kind: Kind::Topology,
            of: first.planned.id.clone(),
            caption: format!(
                "The network of the experiment. {}: backend {}; each end of each link has a delay of {}, {} and {}.{}",
                letters_of(group),
                backend.name(),
                links[0],
                links[1],
                links[2],
                not_drawn(at, groups.len())
            ),
            is_simulated: group.iter().any(|scenario| scenario.is_simulated()),
            height_pt: match backend.facts().has_controller {
                true => 155.0,
                false => 115.0,
            },
        };
        Some(drawn(about, layout, |area| draw_network(&column_of(area), links, *backend, *master)))
    });
    figures.collect()
}

/// Whether all hosts are at one switch, by links that do the same.
fn has_equal_links(network: &NetworkSettings) -> bool {
    let topology = network.topology();
    topology.switches.len() == 1 && topology.links().all(|(_, link)| link == network.link())
}

/// Of one end of a link.
pub(super) fn delay(network: &NetworkSettings) -> String {
    match network.jitter.as_nanos() {
        0 => network.delay.to_string(),
        _ => format!("{} ± {}", network.delay, network.jitter),
    }
}

/// What is said of both ends of each link: delay, loss and rate, and queue.
fn links(network: &NetworkSettings) -> [String; 3] {
    [
        delay(network),
        format!("{} loss, {}/s", network.loss, network.bandwidth),
        format!("a queue of {} packets", network.limit_packets),
    ]
}

fn draw_network(
    area: &Area<'_>,
    links: &[String; 3],
    backend: NetworkBackend,
    master: RosMaster,
) -> Result<(), DrawingError> {
    const HOST: (f64, f64) = (62.0, 30.0);
    let drawing = Schematic(area);
    let middle = COLUMN_PT / 2.0;
    let facts = backend.facts();
    let top = if facts.has_controller { 55.0 } else { 15.0 };
    if facts.has_controller {
        drawing.labelled((middle, 13.0), (96.0, 20.0), &["OpenFlow controller"])?;
        drawing.dashed(middle, 23.0, top - 12.0)?;
    }
    let switch = format!("({})", facts.switch);
    let master = match master {
        RosMaster::Embedded => "ROS master",
        RosMaster::Rosmaster => "rosmaster",
    };
    let hosts = [
        (45.0, "h1", master),
        (middle, "sta1", "controller"),
        (COLUMN_PT - 45.0, "sta2", "plant"),
    ];
    let below = top + 56.0;
    // The links first, so that boxes lie on their ends.
    for (x, ..) in hosts {
        drawing.path(&[
            (middle + (x - middle) * 0.35, top + 12.0),
            (x, below - HOST.1 / 2.0),
        ])?;
    }
    drawing.labelled((middle, top), (84.0, 24.0), &["switch", &switch])?;
    for (x, host, node) in hosts {
        drawing.labelled((x, below), HOST, &[host, node])?;
    }
    let [delay, loss, queue] = links;
    let words = [format!("each end of each link: {delay}, {loss},"), queue.clone()];
    for (line, words) in words.iter().enumerate() {
        drawing.words((middle, below + 24.0 + 9.5 * line as f64), HPos::Center, words)?;
    }
    Ok(())
}
