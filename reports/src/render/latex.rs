//! LaTeX: plain `tabular`, no package that a minimal installation lacks. `tables.tex` compiles by itself, and each of its
//! tables stands in a file of its own, for `\input` in a paper. The main type is [`LatexTable`].

use crate::{report::Report, table::Table};

/// Latin Modern, where it is installed, has outlines of what Computer Modern has only bitmaps of in T1.
const PREAMBLE: &str = "\\documentclass{article}\n\\usepackage[T1]{fontenc}\n\\usepackage[utf8]{inputenc}\n\
    \\IfFileExists{lmodern.sty}{\\usepackage{lmodern}}{}\n\\usepackage[a4paper,margin=2cm]{geometry}\n\\begin{document}\n";

/// Rows that a page has room for beside the notes; a longer table goes on in another one.
const ROWS_A_PAGE: usize = 36;

/// One table of a report as LaTeX, with nothing around it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LatexTable {
    /// What its file is called, such as `rejections-within-each-scenario`; its label is `tab:` and this.
    pub name: String,
    /// The floats.
    pub text: String,
}

/// Every table of the report.
pub(super) fn tables(report: &Report) -> Vec<LatexTable> {
    let mut tables: Vec<LatexTable> = Vec::new();
    for table in &report.tables {
        let mut name = slug(without_number(&table.title));
        let like_it = tables
            .iter()
            .filter(|other| other.name.starts_with(&name))
            .count();
        if like_it > 0 {
            name.push_str(&format!("-{}", like_it + 1));
        }
        let text = floats(report, table, &name);
        tables.push(LatexTable { name, text });
    }
    tables
}

pub(super) fn render(report: &Report) -> String {
    let mut text = format!(
        "% Report of {}. Compiles by itself; its tables are in the folder tables, too, one a file, for \\input.\n",
        in_comment(&report.run)
    );
    text.push_str(PREAMBLE);
    for remark in &report.remarks {
        text.push_str(&format!("\n\\noindent\\textbf{{{}}}\\par\n", prose(remark)));
    }
    for table in tables(report) {
        text.push('\n');
        text.push_str(&table.text);
    }
    text.push_str("\n\\clearpage\n\\section*{Scenarios}\n\\begin{description}\n\\raggedright\n");
    for scenario in &report.scenarios {
        let about = [
            Some(scenario.standing.name()),
            scenario.reason.as_deref(),
            scenario.hint.as_deref(),
        ];
        let mut about: Vec<String> = about.into_iter().flatten().map(prose).collect();
        if scenario.is_simulated {
            about.push("simulated, not measured".to_owned());
        }
        about.extend(scenario.verdicts().iter().map(|verdict| {
            let reasons = verdict.reasons.join(", ");
            prose(&format!("{verdict}: {reasons}"))
        }));
        let (id, slug) = (escaped(&scenario.id), escaped(&scenario.slug));
        text.push_str(&format!(
            "\\item[{id}] {slug}: {}.\n",
            about.join("; ").trim_end_matches('.')
        ));
    }
    text.push_str("\\end{description}\n\\end{document}\n");
    text
}

/// A float for as many rows as a page holds; the first has the label, the last the notes.
fn floats(report: &Report, table: &Table, name: &str) -> String {
    let alignment: String = table
        .columns
        .iter()
        .map(|column| if column.is_number { 'r' } else { 'l' })
        .collect();
    let title = prose(without_number(&table.title));
    let run = escaped(&report.run);
    // The paper's tables say in their captions what was tested, and how.
    let caption = match is_numbered(&table.title) {
        true => format!("{title}. Run {run}. {}", prose(&report.method())),
        false => format!("{title}. Run {run}."),
    };
    let mut text = String::new();
    let parts: Vec<&[Vec<String>]> = match table.rows.is_empty() {
        true => vec![&[]],
        false => table.rows.chunks(ROWS_A_PAGE).collect(),
    };
    for (part, rows) in parts.iter().enumerate() {
        text.push_str("\\begin{table}[htbp]\n\\centering\n");
        text.push_str(&match part {
            0 => format!("\\caption[{title}]{{{caption}}}\n\\label{{tab:{name}}}\n"),
            _ => format!("\\caption[]{{{title}, continued.}}\n"),
        });
        if !rows.is_empty() {
            text.push_str("\\small\\setlength{\\tabcolsep}{4pt}\n");
            text.push_str(&format!("\\begin{{tabular}}{{{alignment}}}\n\\hline\n"));
            text.push_str(&line(table.columns.iter().map(|column| column.heading.as_str())));
            text.push_str("\\hline\n");
            for row in *rows {
                text.push_str(&line(row.iter().map(String::as_str)));
            }
            text.push_str("\\hline\n\\end{tabular}\n");
        }
        if part + 1 == parts.len() && !table.notes.is_empty() {
            text.push_str("\\par\\smallskip\n\\begin{minipage}{\\linewidth}\\footnotesize\\raggedright\n");
            let notes: Vec<String> = table.notes.iter().map(|note| prose(note)).collect();
            text.push_str(&notes.join("\\par\n"));
            text.push_str("\n\\end{minipage}\n");
        }
        text.push_str("\\end{table}\n");
        // Floats wait for their place, and LaTeX lets only so many wait.
        if parts.len() > 1 {
            text.push_str("\\clearpage\n");
        }
    }
    text
}

fn is_numbered(title: &str) -> bool {
    without_number(title) != title
}

/// LaTeX numbers tables itself.
fn without_number(title: &str) -> &str {
    match title.split_once(". ") {
        Some((number, rest)) if number.starts_with("Table ") => rest,
        _ => title,
    }
}

/// Letters, digits and hyphens: a name that a file, a label and LaTeX take.
fn slug(title: &str) -> String {
    let words = title.split(|character: char| !character.is_ascii_alphanumeric());
    let words: Vec<String> = words
        .filter(|word| !word.is_empty())
        .map(str::to_ascii_lowercase)
        .collect();
    words.join("-")
}

fn line<'a>(cells: impl Iterator<Item = &'a str>) -> String {
    format!("{} \\\\\n", cells.map(escaped).collect::<Vec<_>>().join(" & "))
}

/// A text whose names of files and settings stand between backticks, as in Markdown.
fn prose(text: &str) -> String {
    let parts = text.split('`').enumerate();
    let parts = parts.map(|(index, part)| match index % 2 {
        0 => escaped(part),
        // May be long and has no spaces to break at.
        _ => format!("\\texttt{{{}}}", escaped(part).replace('.', ".\\allowbreak{}")),
    });
    parts.collect()
}

/// Text that LaTeX sets as it stands here.
fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '\\' => escaped.push_str("\\textbackslash{}"),
            '~' => escaped.push_str("\\textasciitilde{}"),
            '^' => escaped.push_str("\\textasciicircum{}"),
            // In the font encoding that LaTeX begins with these are other characters.
            '<' | '>' | '|' => escaped.extend(['$', character, '$']),
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => escaped.extend(['\\', character]),
            'α' => escaped.push_str("$\\alpha$"),
            '×' => escaped.push_str("$\\times$"),
            '≥' => escaped.push_str("$\\geq$"),
            '…' => escaped.push_str("\\ldots{}"),
            '–' => escaped.push_str("--"),
            character if character.is_control() => escaped.push(' '),
            // What pdfTeX sets without further packages: Latin letters with their accents.
            character if (character as u32) < 0x180 => escaped.push(character),
            other => escaped.push_str(&format!("(U+{:04X})", other as u32)),
        }
    }
    escaped
}

fn in_comment(text: &str) -> String {
    text.chars()
        .map(|character| if character.is_control() { ' ' } else { character })
        .collect()
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    #[rstest]
    #[case("p < 0.1", "p $<$ 0.1")]
    #[case("i686_ubuntu & 100 %", "i686\\_ubuntu \\& 100 \\%")]
    #[case(
        "a\\b{c}~^$#",
        "a\\textbackslash{}b\\{c\\}\\textasciitilde{}\\textasciicircum{}\\$\\#"
    )]
    #[case("α ≥ ü\n漢", "$\\alpha$ $\\geq$ ü (U+6F22)")]
    fn what_latex_would_take_as_a_command_is_escaped(#[case] text: &str, #[case] latex: &str) {
        assert_eq!(escaped(text), latex);
    }

    #[test]
    fn names_of_settings_are_set_as_such_and_may_be_broken_at_their_dots() {
        assert_eq!(
            prose("see `report.figures_of`."),
            "see \\texttt{report.\\allowbreak{}figures\\_of}."
        );
    }

    #[test]
    fn a_tables_file_is_called_as_its_title_is() {
        assert_eq!(
            slug(without_number("Table 3. Rejections of a (continued)")),
            "rejections-of-a-continued"
        );
    }
}
