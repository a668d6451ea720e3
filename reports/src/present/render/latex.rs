//! LaTeX: `tabular` with the rules of booktabs, in the largest size in which a table fits the column that it stands in.
//! `tables.tex` compiles by itself, and each of its tables stands in a file of its own, for `\input` in a paper. The main type
//! is [`LatexTable`].

use crate::{
    analysis::report::Report,
    present::{Presentation, table::Table},
};

/// Latin Modern, where it is installed, has outlines of what Computer Modern has only bitmaps of in T1.
const PREAMBLE: &str = "\\documentclass{article}\n\\usepackage[T1]{fontenc}\n\\usepackage[utf8]{inputenc}\n\
    \\IfFileExists{lmodern.sty}{\\usepackage{lmodern}}{}\n\\usepackage[a4paper,margin=2cm]{geometry}\n\\usepackage{booktabs,graphicx}\n";

/// What the tables use besides booktabs and graphicx; a document that has a command of that name keeps it. A table is scaled
/// only if it does not fit the column in the smallest size.
const COMMANDS: &str = "\\providecommand{\\lvert}{\\mathopen|}\\providecommand{\\rvert}{\\mathclose|}\n\
    \\providecommand{\\matrixfit}[1]{\\small\\setlength{\\tabcolsep}{4pt}\\sbox0{#1}%\n\
    \\ifdim\\wd0>\\linewidth\\footnotesize\\setlength{\\tabcolsep}{3pt}\\sbox0{#1}\\fi\n\
    \\ifdim\\wd0>\\linewidth\\scriptsize\\setlength{\\tabcolsep}{2pt}\\sbox0{#1}\\fi\n\
    \\ifdim\\wd0>\\linewidth\\resizebox{\\linewidth}{!}{\\usebox0}\\else\\usebox0\\fi}\n";

/// Rows that a page has room for beside the notes; a longer table goes on in another one.
const ROWS_A_PAGE: usize = 36;

/// One table of a report as LaTeX, with nothing around it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LatexTable {
    /// What its file is called: the table's id, such as `rejections-within-each-scenario`. Its label is `tab:` and this.
    pub name: String,
    /// The floats.
    pub text: String,
}

impl LatexTable {
    /// What its file holds: the commands it uses, and the floats.
    #[must_use]
    pub fn file(&self) -> String {
        format!(
            "% Needs \\usepackage{{booktabs,graphicx}}.\n{COMMANDS}{}",
            self.text
        )
    }
}

/// Every table of the report.
pub(super) fn tables(page: &Presentation<'_>) -> Vec<LatexTable> {
    page.tables
        .iter()
        .map(|table| LatexTable {
            name: table.id.clone(),
            text: floats(page.report, table),
        })
        .collect()
}

pub(super) fn render(page: &Presentation<'_>) -> String {
    let report = page.report;
    let mut text = format!(
        "% Report of {}. Compiles by itself; its tables are in the folder tables, too, one a file, for \\input.\n",
        in_comment(&report.run)
    );
    text.push_str(PREAMBLE);
    text.push_str(COMMANDS);
    text.push_str("\\begin{document}\n");
    for remark in &page.remarks {
        text.push_str(&format!("\n\\noindent\\textbf{{{}}}\\par\n", prose(remark)));
    }
    for origin in report.origins() {
        text.push_str(&format!("\n\\noindent {}\\par\n", prose(&origin)));
    }
    for table in tables(page) {
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
            let reasons = record::window::reasons_in_one_line(verdict.reasons);
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
fn floats(report: &Report, table: &Table) -> String {
    let alignment: String = table
        .columns
        .iter()
        .map(|column| if column.is_number { 'r' } else { 'l' })
        .collect();
    let title = prose(without_number(&table.title));
    let run = escaped(&report.run);
    // The paper's tables say in their captions what was tested, and how.
    let caption = match table.has_counts() {
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
            0 => format!("\\caption[{title}]{{{caption}}}\n\\label{{tab:{}}}\n", table.id),
            _ => format!("\\caption[]{{{title}, continued.}}\n"),
        });
        if !rows.is_empty() {
            text.push_str(&format!(
                "\\matrixfit{{\\begin{{tabular}}{{@{{}}{alignment}@{{}}}}\n\\toprule\n"
            ));
            text.push_str(&line(table.columns.iter().map(|column| column.heading.as_str())));
            text.push_str("\\midrule\n");
            for row in *rows {
                text.push_str(&line(row.iter().map(String::as_str)));
            }
            text.push_str("\\bottomrule\n\\end{tabular}}\n");
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

/// LaTeX numbers tables itself.
fn without_number(title: &str) -> &str {
    match title.split_once(". ") {
        Some((number, rest)) if number.starts_with("Table ") => rest,
        _ => title,
    }
}

fn line<'a>(cells: impl Iterator<Item = &'a str>) -> String {
    format!("{} \\\\\n", cells.map(escaped).collect::<Vec<_>>().join(" & "))
}

/// A text whose names of files and settings stand between backticks, as in Markdown.
pub(crate) fn prose(text: &str) -> String {
    let parts = text.split('`').enumerate();
    let parts = parts.map(|(index, part)| match index % 2 {
        0 => escaped(part),
        // May be long and has no spaces to break at.
        _ => format!("\\texttt{{{}}}", escaped(part).replace('.', ".\\allowbreak{}")),
    });
    parts.collect()
}

/// Text that LaTeX sets as it stands here, and formulas as formulas.
fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    let mut rest = text;
    let mut before = ' ';
    while let Some(character) = rest.chars().next() {
        let length = match formula(rest, before) {
            Some((length, formula)) => {
                escaped.push_str(&format!("${formula}$"));
                length
            }
            None => {
                push_escaped(&mut escaped, character);
                character.len_utf8()
            }
        };
        let (taken, after) = rest.split_at(length);
        before = taken.chars().next_back().unwrap_or(before);
        rest = after;
    }
    escaped
}

fn push_escaped(escaped: &mut String, character: char) {
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

/// A formula that a text begins with, in math mode, and how many bytes of the text it is: `|e_x|`, `p < 0.001`, `N`, and numbers
/// with a sign or an exponent. `before` is the character before, since these may be parts of a word.
fn formula(text: &str, before: char) -> Option<(usize, String)> {
    if let Some((name, _)) = text.strip_prefix('|').and_then(|rest| rest.split_once('|')) {
        return matches!(name, "e_x" | "e_y").then(|| (name.len() + 2, format!("\\lvert {name}\\rvert")));
    }
    let ends = |length: usize| {
        let after = text[length..].chars().next();
        !after.is_some_and(|it| it.is_alphanumeric() || it == '_' || it == '-')
    };
    if before.is_alphanumeric() || "_-./".contains(before) {
        return None;
    }
    if text.starts_with('N') && ends(1) {
        return Some((1, "N".to_owned()));
    }
    if let Some(rest) = text.strip_prefix("p < ") {
        let (length, limit) = number(rest)?;
        return Some((length + 4, format!("p < {limit}")));
    }
    let (length, in_math) = number(text)?;
    let is_plain = text.starts_with(|it: char| it.is_ascii_digit()) && in_math.len() == length;
    (!is_plain && ends(length)).then_some((length, in_math))
}

/// A number that a text begins with, its bytes and how it is set.
fn number(text: &str) -> Option<(usize, String)> {
    let digits = |text: &str| text.len() - text.trim_start_matches(|it: char| it.is_ascii_digit()).len();
    let sign = usize::from(text.starts_with(['+', '-']));
    let whole = digits(&text[sign..]);
    let mut length = sign + whole;
    if let Some(rest) = text[length..].strip_prefix('.')
        && digits(rest) > 0
    {
        length += 1 + digits(rest);
    }
    let mantissa = text[..length].to_owned();
    if whole == 0 {
        return None;
    }
    let Some(rest) = text[length..].strip_prefix('e') else {
        return Some((length, mantissa));
    };
    let sign = usize::from(rest.starts_with('-'));
    match digits(&rest[sign..]) {
        0 => Some((length, mantissa)),
        exponent => {
            let exponent = &rest[..sign + exponent];
            let set = format!("{mantissa}\\times10^{{{exponent}}}");
            Some((length + 1 + exponent.len(), set))
        }
    }
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
    #[case("p < 0.1, or a < b", "$p < 0.1$, or a $<$ b")]
    #[case(
        "mean |e_x| + mean |e_y|",
        "mean $\\lvert e_x\\rvert$ + mean $\\lvert e_y\\rvert$"
    )]
    #[case("-0.41 [-4.54, +59.9]", "$-0.41$ [$-4.54$, $+59.9$]")]
    #[case("1.0e-4 of N", "$1.0\\times10^{-4}$ of $N$")]
    #[case("2026-11-21 on i686-e5 of 119", "2026-11-21 on i686-e5 of 119")]
    #[case("|e_z| 3e NN", "$|$e\\_z$|$ 3e NN")]
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
}
