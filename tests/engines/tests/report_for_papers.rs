//! What a paper takes of a report, held to by programs that are not ours: the tables by pdflatex, the figures by poppler.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use tests::Workplace;

/// By how much a line may be too wide: the eighth part of a millimetre is not seen, and rounding makes such.
const SEEN_PT: f64 = 0.35;

/// A report of the fake platform, with scenarios in all states and names as long as a user's.
fn report() -> (Workplace, PathBuf) {
    let workplace = Workplace::new();
    workplace.write(
        "m.yaml",
        "matrix:
  hardware: [x86_64, riscv64]
  labels: {kernel: [stable, preempt-rt_100%, tickless, rescue]}
  virtualization: [fake]
hosts: {desk: {connect: local, hardware: x86_64, os: debian-12}}
workload: {windows: 4, window: 30s, period: 1s}
report: {baseline: {kernel: stable}, equivalence_margin: 2mm}
providers: {fake: {scenarios: {x86-64-debian-12-kernel-rescue-fake: {fail: {at: create}}}}}
",
    );
    let ran = workplace.run(&["run", "m.yaml", "--quiet"]);
    assert_eq!(ran.code, Some(3), "one scenario fails: {ran:?}");
    let folder = workplace.run_directory().join("report");
    (workplace, folder)
}

/// Compiles a document in this folder; what LaTeX complained of.
fn compile(folder: &Path, document: &str) -> Vec<String> {
    // Twice, as references want it.
    for _ in 0..2 {
        let compiled = Command::new("pdflatex")
            .args(["-interaction=nonstopmode", "-halt-on-error", document])
            .current_dir(folder)
            .output()
            .expect("tests/prepare has installed pdflatex");
        let said = String::from_utf8_lossy(&compiled.stdout).into_owned();
        assert!(compiled.status.success(), "{document}: {said}");
    }
    let log = fs::read(folder.join(document).with_extension("log")).unwrap();
    let log = String::from_utf8_lossy(&log).into_owned();
    log.lines()
        .filter(|line| match line.strip_prefix("Overfull \\hbox (") {
            Some(rest) => rest.split("pt").next().unwrap().parse::<f64>().unwrap() > SEEN_PT,
            None => line.contains("Warning") || line.starts_with("Overfull"),
        })
        .map(str::to_owned)
        .collect()
}

fn said_by(program: &str, arguments: &[&str]) -> String {
    let ran = Command::new(program)
        .args(arguments)
        .output()
        .expect("tests/prepare has installed it");
    assert!(ran.status.success(), "{program}: {ran:?}");
    String::from_utf8(ran.stdout).unwrap()
}

#[test]
fn the_tables_compile_as_they_are_and_one_by_one_in_a_papers_column() {
    let (_workplace, folder) = report();
    assert_eq!(compile(&folder, "tables.tex"), [""; 0]);
    let pdf = folder.join("tables.pdf");
    let words = said_by("pdftotext", &["-layout", pdf.to_str().unwrap(), "-"]);
    for expected in [
        "Table 1: How large the differences are, all at once. Run",
        "Table 2: The layers of a robot simulation. Run",
        "Table 4: Rejections within each scenario. Run",
        "preempt-rt",
        "p < 0.001",
        "Scenarios",
    ] {
        assert!(words.contains(expected), "{expected}: {words}");
    }

    // A column of two, as narrow as that of an IEEE conference: 252 pt.
    let mut document =
        "\\documentclass[10pt,twocolumn]{article}\n\\usepackage[textwidth=516pt,columnsep=12pt]{geometry}\n\
         \\usepackage{booktabs,graphicx,amsmath}\n\\begin{document}\n\\listoftables\n"
            .to_owned();
    let mut names: Vec<String> = fs::read_dir(folder.join("tables"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    assert!(names.len() > 7, "{names:?}");
    for name in &names {
        let label = name.trim_end_matches(".tex");
        document.push_str(&format!(
            "\n\\raggedright See table~\\ref{{tab:{label}}}.\n\\input{{tables/{name}}}\n\\clearpage\n"
        ));
    }
    document.push_str("\\end{document}\n");
    fs::write(folder.join("paper.tex"), document).unwrap();
    assert_eq!(compile(&folder, "paper.tex"), [""; 0]);
    let pdf = folder.join("paper.pdf");
    let words = said_by("pdftotext", &["-layout", pdf.to_str().unwrap(), "-"]);
    assert!(
        words.contains("mean |ex | + mean |ey |"),
        "a formula is set as one: {words}"
    );
}

#[test]
fn the_figures_compile_as_they_are_and_one_by_one_in_a_paper_of_two_columns() {
    let (workplace, folder) = report();
    assert_eq!(compile(&folder, "figures.tex"), [""; 0]);
    let pdf = folder.join("figures.pdf");
    let words = said_by("pdftotext", &[pdf.to_str().unwrap(), "-"]);
    assert!(words.contains("Simulated, not measured."), "{words}");

    let mut document =
        "\\documentclass[twocolumn]{article}\n\\usepackage{graphicx}\n\\graphicspath{{figures/}}\n\
        \\begin{document}\n"
            .to_owned();
    let mut names: Vec<String> = fs::read_dir(folder.join("figures"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| name.ends_with(".tex"))
        .collect();
    names.sort();
    for kind in [
        "cdf-a-b",
        "control-loop-a",
        "histogram-a-b",
        "ks-test",
        "topology-a",
        "trajectory-a",
    ] {
        assert!(names.contains(&format!("{kind}.tex")), "{kind}: {names:?}");
    }
    for name in &names {
        let label = name.trim_end_matches(".tex");
        document.push_str(&format!(
            "See figure~\\ref{{fig:{label}}}.\n\\input{{figures/{label}}}\n\n"
        ));
    }
    document.push_str("\\end{document}\n");
    fs::write(folder.join("paper.tex"), document).unwrap();
    assert_eq!(compile(&folder, "paper.tex"), [""; 0]);

    let run = workplace.run_directory();
    for layout in ["ieee-page", "lncs-page", "slide"] {
        let ran = workplace.run(&["report", run.to_str().unwrap(), "--for", layout]);
        assert_eq!(ran.code, Some(0), "{ran:?}");
        assert_eq!(compile(&folder, "figures.tex"), [""; 0], "{layout}");
    }
}

#[test]
fn what_latex_complains_of_is_seen() {
    let workplace = Workplace::new();
    workplace.write(
        "wide.tex",
        "\\documentclass{article}\\begin{document}\\noindent\\hbox{\\hskip 400pt}\\ref{nowhere}\\end{document}",
    );
    let complaints = compile(workplace.path(), "wide.tex").join("\n");
    for expected in ["Overfull", "Reference `nowhere'"] {
        assert!(complaints.contains(expected), "{expected}: {complaints}");
    }
}

#[test]
fn a_figure_as_pdf_is_one_page_of_lines_and_text_with_its_font() {
    let (_workplace, folder) = report();
    let figures = folder.join("figures");
    for (name, height_pt, expected) in [
        (
            "cdf-a-b.pdf",
            192,
            ["D = ", "window", "SIMULATED, NOT MEASURED", "|e_x|"],
        ),
        ("trajectory-a.pdf", 177, ["target", "actual", "time (s)", "x (m)"]),
    ] {
        let pdf = figures.join(name);
        let pdf = pdf.to_str().unwrap();
        let about = said_by("pdfinfo", &[pdf]);
        let field = |wanted: &str| {
            about
                .lines()
                .find(|line| line.starts_with(wanted))
                .unwrap()
                .to_owned()
        };
        assert!(field("Pages:").ends_with(" 1"), "{about}");
        // A column of 3.5 inches, a point being 1/72.
        assert!(
            field("Page size:").contains(&format!(" 252 x {height_pt} pts")),
            "{about}"
        );
        let words = said_by("pdftotext", &["-layout", pdf, "-"]);
        for expected in expected {
            assert!(words.contains(expected), "{name}, {expected}: {words}");
        }
        let fonts = said_by("pdffonts", &[pdf]);
        let fonts: Vec<&str> = fonts.lines().skip(2).collect();
        assert!(!fonts.is_empty(), "text is text");
        for font in fonts {
            // Name, type, encoding, embedded, subset, Unicode, object.
            let said: Vec<&str> = font.split_whitespace().rev().collect();
            assert_eq!(said[2..5], ["yes", "yes", "yes"], "{font}");
        }
        let images = said_by("pdfimages", &["-list", pdf]);
        assert_eq!(images.lines().count(), 2, "no bitmap, only the heading: {images}");
    }
}
