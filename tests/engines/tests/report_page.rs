//! `report.html` in a real browser: headless Chromium, on a telephone, a tablet and a desk, light and dark, without JavaScript and
//! on paper. What was seen is kept in the target folder, `tmp/report-page`, for people to look at.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
    sync::OnceLock,
};

use rstest::rstest;
use tests::{
    Workplace,
    browser::{Browser, Look, Page},
};

/// CSS pixels of A4 between Chromium's margins of 1 cm.
const PAPER: u32 = 718;

/// Platforms that are not there, with all that a report can have: a baseline, effects, a failure and what is infeasible.
const MADE_UP: &str = "\
matrix:
  hardware: [x86_64, riscv64]
  labels: {kernel: [stable, preempt-rt, tickless, rescue]}
  virtualization: [fake]
hosts:
  desk: {connect: local, hardware: x86_64, os: debian-12}
workload: {windows: 4, window: 30s, period: 1s}
report: {baseline: {kernel: stable}, equivalence_margin: 2mm}
providers:
  fake:
    scenarios:
      x86-64-debian-12-kernel-preempt-rt-fake: {shift_m: 0.02}
      x86-64-debian-12-kernel-rescue-fake: {fail: {at: create}}
";

/// A run and its report.
struct Report {
    _workplace: Workplace,
    folder: PathBuf,
}

impl Report {
    fn page(&self) -> PathBuf {
        self.folder.join("report.html")
    }
}

/// Made up by the fake platform: eight scenarios, three of them with data.
fn made_up() -> &'static Report {
    static MADE: OnceLock<Report> = OnceLock::new();
    MADE.get_or_init(|| {
        let workplace = Workplace::new();
        workplace.write("m.yaml", MADE_UP);
        let ran = workplace.run(&["run", "m.yaml", "--quiet"]);
        assert_eq!(ran.code, Some(3), "one scenario fails: {ran:?}");
        Report {
            folder: workplace.run_directory().join("report"),
            _workplace: workplace,
        }
    })
}

/// Of the run that was recorded once, natively and in Docker, with captures.
fn recorded() -> &'static Report {
    static RECORDED: OnceLock<Report> = OnceLock::new();
    RECORDED.get_or_init(|| {
        let workplace = Workplace::new();
        let fixture = concat!(env!("CARGO_MANIFEST_DIR"), "/../fixtures/recorded");
        let copied = Command::new("cp")
            .args(["-r", fixture, "run"])
            .current_dir(workplace.path())
            .status();
        assert!(copied.unwrap().success());
        let ran = workplace.run(&["report", "run"]);
        assert!(ran.err.is_empty(), "{ran:?}");
        Report {
            folder: workplace.path().join("run/report"),
            _workplace: workplace,
        }
    })
}

/// Where what was seen is kept.
fn kept(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("report-page");
    fs::create_dir_all(&folder).unwrap();
    folder.join(name)
}

/// The first cells of a sortable table, from top to bottom.
fn column(page: &mut Page<'_>, table: &str, column: usize) -> Vec<String> {
    let cells = page.value(&format!(
        "[...document.querySelector({table:?}).tBodies[0].rows].map(row => row.cells[{column}].textContent)"
    ));
    serde_json::from_value(cells).unwrap()
}

#[rstest]
#[case::made_up(made_up(), "made-up")]
#[case::recorded(recorded(), "recorded")]
fn it_fits_the_screen_says_nothing_on_the_console_asks_for_nothing_and_shuts_nobody_out(
    #[case] report: &Report,
    #[case] name: &str,
) {
    let mut browser = Browser::start();
    for (look, of) in [
        (Look::PHONE, "phone-light"),
        (Look::PHONE.dark(), "phone-dark"),
        (Look::TABLET, "tablet-light"),
        (Look::DESKTOP, "desktop-light"),
        (Look::DESKTOP.dark(), "desktop-dark"),
    ] {
        let mut page = browser.open(&report.page(), look);
        page.screenshot(&kept(&format!("{name}-{of}.png")));
        assert_eq!(page.complaints(), [""; 0], "{of}");
        assert_eq!(page.overflow(), 0, "{of}");
        assert_eq!(page.barriers(), [""; 0], "{of}");
        // What is folded away is held to the same.
        page.value("document.querySelectorAll('details').forEach(it => it.open = true)");
        assert_eq!(page.overflow(), 0, "{of}, all unfolded");
        assert_eq!(page.barriers(), [""; 0], "{of}, all unfolded");
    }
}

/// The numbers at the lines of a history that a person could not read whole.
const CUT: &str = "[...document.querySelectorAll('.history svg text')].filter(text => {
    const [ink, page] = [text.getBoundingClientRect(), text.ownerSVGElement.getBoundingClientRect()];
    return ink.left < page.left - 1 || ink.right > page.right + 1;
}).map(text => text.textContent)";

#[test]
fn a_history_fits_the_screen_and_no_number_of_it_is_cut() {
    let workplace = Workplace::new();
    for night in 0..6 {
        let shift = if night == 5 { "0.5" } else { "0" };
        workplace.write(
            "m.yaml",
            format!(
                "matrix: {{virtualization: [fake], labels: {{place: [here, there]}}}}\n\
                 hosts: {{desk: {{connect: local, hardware: x86_64, os: debian-12}}}}\n\
                 workload: {{windows: 4, window: 8s, period: 1s}}\n\
                 providers: {{fake: {{seed: {night}, scenarios: {{x86-64-debian-12-fake-place-here: {{shift_m: {shift}}}}}}}}}\n"
            ),
        );
        let ran = workplace.run(&["run", "m.yaml", "--quiet"]);
        assert_eq!(ran.code, Some(0), "{ran:?}");
    }
    let drift = workplace.run(&["drift", "runs", "--html", "history.html"]);
    assert_eq!(drift.code, Some(4), "{drift:?}");
    let history = workplace.path().join("history.html");
    let mut browser = Browser::start();
    for (look, of) in [
        (Look::PHONE, "phone"),
        (Look::TABLET, "tablet"),
        (Look::DESKTOP, "desktop"),
        (Look::DESKTOP.dark(), "desktop-dark"),
    ] {
        let mut page = browser.open(&history, look);
        page.screenshot(&kept(&format!("history-{of}.png")));
        assert_eq!(page.complaints(), [""; 0], "{of}");
        assert_eq!(page.overflow(), 0, "{of}");
        assert_eq!(page.barriers(), [""; 0], "{of}");
        assert_eq!(page.value(CUT), serde_json::json!([]), "{of}");
        // The error of both scenarios; how long provisioning takes may be the same each night.
        let drawings = page.value("document.querySelectorAll('.history svg').length");
        assert!(
            drawings.as_u64().is_some_and(|drawings| drawings >= 2),
            "{of}: {drawings}"
        );
    }
}

#[test]
fn dark_is_dark_and_light_is_light() {
    let file = made_up().page();
    let mut browser = Browser::start();
    let mut brightness = |look| {
        let mut page = browser.open(&file, look);
        let colour =
            page.value("getComputedStyle(document.body).backgroundColor.match(/[0-9]+/g).map(Number)");
        let parts: Vec<u32> = serde_json::from_value(colour).unwrap();
        parts.iter().sum::<u32>() / 3
    };
    assert!(brightness(Look::DESKTOP) > 230);
    assert!(brightness(Look::DESKTOP.dark()) < 40);
}

#[test]
fn a_table_is_sorted_by_mouse_and_by_keyboard() {
    let file = made_up().page();
    let mut browser = Browser::start();
    let mut page = browser.open(&file, Look::DESKTOP);
    let below_its_heading = "document.getElementById('table-the-layers-of-a-robot-simulation')\
         .compareDocumentPosition(it) & Node.DOCUMENT_POSITION_FOLLOWING";
    page.value(&format!(
        "[...document.querySelectorAll('#tables table.sortable')].find(it => {below_its_heading}).id = 'first'"
    ));
    let before = column(&mut page, "#first", 1);
    let mut rising = before.clone();
    // As a dictionary has them.
    rising.sort_by_key(|cell| cell.to_lowercase());
    let falling: Vec<String> = rising.iter().rev().cloned().collect();
    assert_ne!(before, rising, "the order of the matrix is another one");

    page.click("#first th:nth-child(2) button");
    assert_eq!(column(&mut page, "#first", 1), rising);
    let said = page.value("document.querySelector('#first th:nth-child(2)').ariaSort");
    assert_eq!(said, "ascending");

    // Numbers by their size, not by their first digit.
    page.click("details summary");
    page.click("#heatmap th:nth-child(4) button");
    let sorted = column(&mut page, "#heatmap table", 3);
    let numbers: Vec<f64> = sorted.iter().map(|cell| cell.parse().unwrap()).collect();
    assert!(numbers.len() > 20 && numbers.is_sorted(), "{sorted:?}");

    // From the top of the page, as somebody without a mouse comes there.
    page.value("document.activeElement.blur(); scrollTo(0, 0)");
    let is_there = "document.activeElement === document.querySelector('#first th:nth-child(2) button')";
    let reached = (0..100).any(|_| {
        page.press("Tab");
        page.value(is_there) == true
    });
    assert!(reached, "Tab comes to the heading");
    let outline = page.value("getComputedStyle(document.activeElement).outlineStyle");
    assert_ne!(outline, "none", "where the keyboard is can be seen");
    page.press("Enter");
    assert_eq!(column(&mut page, "#first", 1), falling);
    assert_eq!(page.complaints(), [""; 0]);
}

#[test]
fn everything_is_there_without_javascript() {
    // Every drawing with its size, every table with its rows, every text that is not folded away.
    let seen = "({ \
        drawings: [...document.querySelectorAll('svg')].map(it => it.getBoundingClientRect()) \
            .map(box => box.width > 100 && box.height > 100), \
        rows: [...document.querySelectorAll('table')].map(it => it.rows.length), \
        text: document.querySelector('main').textContent.replace(/\\s+/g, ' '), \
        verdict: document.querySelector('#verdict').getBoundingClientRect().bottom < innerHeight, \
        buttons: document.querySelectorAll('button').length })";
    let file = made_up().page();
    let mut browser = Browser::start();
    let mut with = browser.open(&file, Look::DESKTOP).value(seen);
    let mut page = browser.open(&file, Look::DESKTOP.without_scripts());
    let mut without = page.value(seen);
    assert!(with["buttons"].as_u64() > Some(10), "{with}");
    assert_eq!(without["buttons"], 0, "nothing is offered that does not work");
    for seen in [&mut with, &mut without] {
        seen["buttons"].take();
        let drawings = seen["drawings"].as_array().unwrap();
        assert!(drawings.len() > 5, "{drawings:?}");
        assert!(drawings.iter().all(|it| *it == true), "{drawings:?}");
        assert_eq!(seen["verdict"], true, "the verdict is on the first screen");
    }
    assert_eq!(with, without);
    // A list that is folded away opens without a script.
    page.click("details summary");
    assert_eq!(page.value("document.querySelector('details').open"), true);
}

#[rstest]
#[case::made_up(made_up(), "made-up")]
#[case::recorded(recorded(), "recorded")]
fn on_paper_nothing_is_cut_off_or_folded_away(#[case] report: &Report, #[case] name: &str) {
    let mut browser = Browser::start();
    let mut page = browser.open(&report.page(), Look::DESKTOP);
    let pdf = kept(&format!("{name}-paper.pdf"));
    page.print(&pdf);
    let printed = Command::new("pdftotext")
        .args(["-layout", pdf.to_str().unwrap(), "-"])
        .output()
        .unwrap();
    let printed = String::from_utf8(printed.stdout).unwrap();
    let words: Vec<&str> = printed.split_whitespace().collect();
    let printed = words.join(" ");
    let titles = page.value(
        "[...document.querySelectorAll('h2, h3, dt, #verdict')].map(it => it.innerText || it.textContent)",
    );
    let titles: Vec<String> = serde_json::from_value(titles).unwrap();
    assert!(titles.len() > 20, "{titles:?}");
    // A hyphen or a line's end may be within a long word.
    let plain = |text: &str| text.replace(char::is_whitespace, "");
    let printed = plain(&printed);
    for title in titles {
        assert!(
            printed.contains(&plain(&title)),
            "{title} is on paper:\n{printed}"
        );
    }

    page.on_paper(PAPER);
    let cut = page.value(&format!(
        "[...document.querySelectorAll('table, svg, p, dl')].filter(it => it.getBoundingClientRect().right > {PAPER}) \
         .map(it => it.outerHTML.slice(0, 300))"
    ));
    assert_eq!(cut, serde_json::json!([]), "wider than the paper");
    let hidden =
        page.value("[...document.querySelectorAll('dt')].filter(it => !it.checkVisibility()).length");
    assert_eq!(hidden, 0, "folded away");
    page.screenshot(&kept(&format!("{name}-paper.png")));
}

#[test]
fn what_a_bad_page_does_is_seen() {
    let workplace = Workplace::new();
    workplace.write(
        "bad.html",
        "<!DOCTYPE html><title>bad</title><img src='nowhere.png'><div style='width: 2000px'>wide</div>\
         <script>console.log('here'); nothing()</script>",
    );
    let mut browser = Browser::start();
    let mut page = browser.open(&workplace.path().join("bad.html"), Look::PHONE);
    assert!(page.overflow() > 1000);
    let barriers = page.barriers();
    for rule in ["image-alt", "html-has-lang"] {
        assert!(
            barriers.iter().any(|it| it.contains(rule)),
            "{rule}: {barriers:?}"
        );
    }
    let complaints = page.complaints();
    for said in ["nowhere.png", "nothing is not defined", "consoleAPICalled"] {
        assert!(
            complaints.iter().any(|it| it.contains(said)),
            "{said}: {complaints:?}"
        );
    }
}
