//! Drawings as a printer sees them: how large their letters are, and whether any are cut or lie on others.

use std::path::Path;

use captures::traffic::Traffic;
use record::{
    family::Family,
    report_settings::{DrawnPair, ReportSettings},
};
use svg2pdf::usvg::{Group, Node, Rect};

use super::*;
use crate::{
    analyse,
    explain::{ExplainedPair, Explanation, Part, Unit},
    load,
};

/// Smallest letters that papers take.
const SMALLEST_PT: f64 = 7.0;

/// The figures of the recorded run, with scenarios called by names as long as any.
fn figures() -> Vec<Figure> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/recorded");
    let mut run = load(path).unwrap();
    for (delay, scenario) in ["10ms", "12.5ms", "15ms"].iter().zip(&mut run.scenarios) {
        let axes = &mut scenario.planned.axes;
        axes.insert("network.delay".to_owned(), (*delay).into());
        axes.insert("virtualization".to_owned(), "native".into());
        scenario.planned.slug = "w".repeat(60);
        scenario.planned.settings.period = "100s".parse().unwrap();
    }
    if let Some(scenario) = run.scenarios.first_mut() {
        scenario.planned.settings.network.backend = record::settings::NetworkBackend::Mininet;
        scenario.providers.insert("fake".to_owned());
    }
    // Named, since they no longer run the same experiment.
    let settings = ReportSettings {
        figures: vec![DrawnPair("a/1".parse().unwrap(), "b".parse().unwrap())],
        family: Family::Pairs(vec![("a".to_owned(), "b".to_owned())]),
        ..run.manifest.report.clone()
    };
    let mut report = analyse(&run, Traffic::default(), &settings);
    report.causes = vec![explained()];
    draw(&run, &report, Layout::default()).unwrap()
}

fn explained() -> ExplainedPair {
    let part = |words: &str, part_m: f64| Part {
        factor: words.to_owned(),
        words: words.to_owned(),
        part_m,
        interval_m: [part_m - 1e-3, part_m + 1e-3],
        part_d: 0.1,
    };
    ExplainedPair::from(Explanation {
        runs: ["run", "run"].map(str::to_owned),
        scenarios: ["a", "b"].map(str::to_owned),
        computed: Vec::new(),
        difference_m: 0.004,
        difference_interval_m: None,
        difference_d: 0.2,
        simulated_m: 0.003,
        simulated_interval_m: [0.002, 0.004],
        simulated_d: 0.2,
        parts: vec![part("late ticks", -0.012), part("delays of messages", 0.015)],
        unexplained_m: 0.001,
        unexplained_interval_m: None,
        unit: Unit::Simulations,
        units: 1,
        simulations: [8, 20],
        remarks: Vec::new(),
    })
}

fn texts(group: &Group, found: &mut Vec<(String, Rect)>) {
    for node in group.children() {
        match node {
            Node::Text(text) => {
                let words = text.chunks().iter().map(|chunk| chunk.text()).collect();
                found.push((words, text.abs_bounding_box()));
            }
            Node::Group(group) => texts(group, found),
            _ => {}
        }
    }
}

/// The value of an attribute, every time it stands there.
fn attributes<'a>(svg: &'a str, name: &str) -> Vec<&'a str> {
    let start = format!(" {name}=\"");
    svg.split(&start)
        .skip(1)
        .map(|rest| rest.split('"').next().unwrap())
        .collect()
}

#[test]
fn letters_are_7_points_or_more_at_the_width_of_a_column() {
    let figures = figures();
    for kind in Kind::ALL {
        assert!(figures.iter().any(|figure| figure.kind == kind), "{kind:?}");
    }
    for Figure { name, svg, .. } in &figures {
        let width_units: f64 = attributes(svg, "viewBox")[0]
            .split(' ')
            .nth(2)
            .unwrap()
            .parse()
            .unwrap();
        let sizes: Vec<f64> = attributes(svg, "font-size")
            .iter()
            .map(|size| size.parse().unwrap())
            .collect();
        assert!(!sizes.is_empty(), "{name}");
        for size in sizes {
            let size_pt = size / width_units * 3.5 * 72.0;
            assert!(size_pt > SMALLEST_PT - 1e-6, "{name}: {size_pt} pt");
        }
        assert_eq!(attributes(svg, "width")[0], "252pt", "{name}");
    }
}

#[test]
fn no_letters_are_cut_or_lie_on_others_however_long_the_names_are() {
    for figure in figures() {
        let tree = pdf::tree(&figure).unwrap();
        let mut found = Vec::new();
        texts(tree.root(), &mut found);
        assert!(found.len() > 3, "{}", figure.name);
        for (at, (words, ink)) in found.iter().enumerate() {
            let page = Rect::from_xywh(0.0, 0.0, tree.size().width(), tree.size().height()).unwrap();
            assert!(
                ink.left() >= page.left()
                    && ink.right() <= page.right()
                    && ink.top() >= page.top()
                    && ink.bottom() <= page.bottom(),
                "{}: {words} is cut: {ink:?}",
                figure.name
            );
            for (others, other) in &found[at + 1..] {
                let apart = ink.right() <= other.left()
                    || other.right() <= ink.left()
                    || ink.bottom() <= other.top()
                    || other.bottom() <= ink.top();
                assert!(apart, "{}: {words} lies on {others}", figure.name);
            }
        }
    }
}
