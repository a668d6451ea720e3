//! The report as one page.

use captures::traffic::Traffic;
use record::run_directory::Outcome;
use reports::{analyse, present::figure};

use crate::{
    synthetic::{Scenario, Synthetic},
    tables::nine,
};

fn page(scenarios: &[Scenario]) -> String {
    let synthetic = Synthetic::new(scenarios);
    let run = reports::load(synthetic.directory.path()).unwrap();
    let report = analyse(&run, Traffic::default(), &run.manifest.report);
    report
        .present()
        .html(&figure::draw(&run, &report, figure::Layout::default()).unwrap())
}

/// What is between a tag and its end, the first time.
fn between<'a>(page: &'a str, from: &str, to: &str) -> &'a str {
    let (_, rest) = page.split_once(from).unwrap();
    rest.split_once(to).unwrap().0
}

#[test]
fn it_begins_with_what_was_found() {
    let nine = page(&nine());
    insta::assert_snapshot!(between(&nine, "<div id=\"verdict\">", "</div>"));
    assert!(nine.find("id=\"verdict\"") < nine.find("<table"));

    let nothing = page(&[Scenario::ended("a", Outcome::Errored, "no box")]);
    let verdict = between(&nothing, "<div id=\"verdict\">", "</div>");
    assert!(verdict.starts_with("<p><strong>No two scenarios"), "{verdict}");
}

#[test]
fn it_needs_nothing_from_elsewhere() {
    let page = page(&nine());
    // The name of SVG's language is no address that is fetched.
    let page = page.replace("http://www.w3.org/2000/svg", "");
    for word in ["http:", "https:", "src=", "@import", "url(", "<link"] {
        assert!(!page.contains(word), "{word}");
    }
}

#[test]
fn every_table_and_scenario_and_remark_is_in_it() {
    let synthetic = Synthetic::new(&nine());
    let run = reports::load(synthetic.directory.path()).unwrap();
    let report = analyse(&run, Traffic::default(), &run.manifest.report);
    let page = report.present().html(&[]);
    let escaped = |text: &str| {
        text.replace('&', "&amp;")
            .replace('<', "&lt;")
            .replace('>', "&gt;")
            .replace('"', "&quot;")
    };
    for table in &report.present().tables {
        assert!(page.contains(&escaped(&table.title)), "{}", table.title);
        for note in &table.notes {
            let first = note.split('`').next().unwrap();
            assert!(page.contains(&escaped(first)), "{note}");
        }
        for cell in table.rows.iter().flatten() {
            assert!(page.contains(&escaped(cell)), "{cell}");
        }
    }
    for scenario in &report.scenarios {
        for text in [Some(&scenario.id), scenario.reason.as_ref()]
            .into_iter()
            .flatten()
        {
            assert!(page.contains(&escaped(text)), "{text}");
        }
    }
}

#[test]
fn what_comes_from_elsewhere_is_text_and_nothing_else() {
    let page = page(&[Scenario::ended(
        "a",
        Outcome::Errored,
        "<script>alert(1)</script><img onerror=x>",
    )]);
    assert!(!page.contains("<script>alert"), "{page}");
    assert!(!page.contains("<img"), "{page}");
    assert!(page.contains("&lt;script&gt;alert(1)"), "{page}");
}

#[test]
fn a_run_without_data_says_so_in_every_section() {
    let page = page(&[Scenario::infeasible("a", "no engine")]);
    for words in [
        "No two windows count",
        "No pair of scenarios has data",
        "No window counts",
        "No window has a whole period",
    ] {
        assert!(page.contains(words), "{words}");
    }
}

#[test]
fn its_tags_are_balanced() {
    let page = page(&nine());
    for tag in [
        "section", "table", "tr", "td", "th", "div", "figure", "svg", "g", "details", "p", "ul",
    ] {
        let opened = page.matches(&format!("<{tag}>")).count() + page.matches(&format!("<{tag} ")).count();
        let closed = page.matches(&format!("</{tag}>")).count();
        assert_eq!(opened, closed, "{tag}");
    }
}
