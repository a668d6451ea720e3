//! LaTeX: plain `tabular`, no package that a minimal installation lacks. The document compiles by itself, and a paper
//! takes it whole with `\usepackage{docmute}` and `\input{tables}`, or copies a table out of it.

use crate::{report::Report, table::Table};

const PREAMBLE: &str = "\\documentclass{article}\n\\usepackage[T1]{fontenc}\n\\usepackage[utf8]{inputenc}\n\
    \\usepackage[margin=2cm]{geometry}\n\\begin{document}\n";

pub(super) fn render(report: &Report) -> String {
    let mut text = format!(
        "% Report of {}. Compiles by itself; a paper takes it with \\usepackage{{docmute}} and \\input{{tables}}.\n",
        in_comment(&report.run)
    );
    text.push_str(PREAMBLE);
    for remark in &report.remarks {
        text.push_str(&format!("\n\\noindent\\textbf{{{}}}\\par\n", escaped(remark)));
    }
    for table in &report.tables {
        render_table(&mut text, table, &report.method());
    }
    text.push_str("\n\\section*{Scenarios}\n\\begin{description}\n");
    for scenario in &report.scenarios {
        let about = [
            Some(scenario.standing.name()),
            scenario.reason.as_deref(),
            scenario.hint.as_deref(),
        ];
        let mut about: Vec<String> = about.into_iter().flatten().map(escaped).collect();
        if scenario.is_simulated {
            about.push("simulated, not measured".to_owned());
        }
        about.extend(scenario.verdicts().iter().map(|verdict| {
            let reasons = verdict.reasons.join(", ");
            escaped(&format!("{verdict}: {reasons}"))
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

fn render_table(text: &mut String, table: &Table, method: &str) {
    let alignment: String = table
        .columns
        .iter()
        .map(|column| if column.is_number { 'r' } else { 'l' })
        .collect();
    text.push_str("\n\\begin{table}[htbp]\n\\centering\n");
    text.push_str(&format!(
        "\\caption{{{}}}\n",
        escaped(without_number(&table.title))
    ));
    if !table.rows.is_empty() {
        text.push_str(&format!("\\begin{{tabular}}{{{alignment}}}\n\\hline\n"));
        text.push_str(&line(table.columns.iter().map(|column| column.heading.as_str())));
        text.push_str("\\hline\n");
        for row in &table.rows {
            text.push_str(&line(row.iter().map(String::as_str)));
        }
        text.push_str("\\hline\n\\end{tabular}\n");
    }
    for note in table.notes.iter().map(String::as_str).chain([method]) {
        text.push_str(&format!("\n\\footnotesize {}\n", escaped(note)));
    }
    text.push_str("\\end{table}\n");
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

/// Text that LaTeX sets as it stands here.
fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '\\' => escaped.push_str("\\textbackslash{}"),
            '~' => escaped.push_str("\\textasciitilde{}"),
            '^' => escaped.push_str("\\textasciicircum{}"),
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
    #[case("i686_ubuntu & 100 %", "i686\\_ubuntu \\& 100 \\%")]
    #[case(
        "a\\b{c}~^$#",
        "a\\textbackslash{}b\\{c\\}\\textasciitilde{}\\textasciicircum{}\\$\\#"
    )]
    #[case("α ≥ ü\n漢", "$\\alpha$ $\\geq$ ü (U+6F22)")]
    fn what_latex_would_take_as_a_command_is_escaped(#[case] text: &str, #[case] latex: &str) {
        assert_eq!(escaped(text), latex);
    }
}
