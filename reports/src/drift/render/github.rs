//! For GitHub's actions: workflow commands that become annotations, and the Markdown of a step's summary.

use std::fmt::Write;

use record::escaping::{harmless, is_unseen};

use crate::drift::{Drift, Verdict};

impl Drift {
    /// A line for each change and for each scenario and metric without a verdict: `::error …` and `::warning …`
    /// (docs.github.com, *Workflow commands*).
    #[must_use]
    pub fn github_annotations(&self) -> String {
        let mut lines = String::new();
        for (judgement, finding) in self.news() {
            let _ = writeln!(
                lines,
                "::error title={}::{}",
                property(&format!(
                    "drift of {} {}",
                    judgement.scenario,
                    judgement.metric.name()
                )),
                message(&finding.in_words(&judgement.metric))
            );
        }
        for judgement in &self.judgements {
            if matches!(
                judgement.verdict,
                Verdict::Invalid { .. } | Verdict::TooLittle { .. }
            ) {
                let _ = writeln!(
                    lines,
                    "::warning title={}::{}",
                    property(&format!("{} {}", judgement.scenario, judgement.metric.name())),
                    message(&judgement.in_words())
                );
            }
        }
        lines
    }

    /// The verdict, what changed, and a table of all, as Markdown.
    #[must_use]
    pub fn github_summary(&self) -> String {
        let mut text = format!("### {}\n", cell(&self.verdict_in_words()));
        let withdrawn = self.told_before();
        if !withdrawn.is_empty() {
            let _ = writeln!(text, "\n{}", cell(withdrawn.trim_start()));
        }
        for (judgement, finding) in self.news() {
            let _ = write!(
                text,
                "\n- **{} {}** {}",
                cell(&judgement.scenario),
                cell(judgement.metric.name()),
                cell(&finding.in_words(&judgement.metric))
            );
        }
        text.push_str("\n\n| scenario | metric | nights | verdict |\n|---|---|---:|---|\n");
        for judgement in &self.judgements {
            let _ = writeln!(
                text,
                "| {} | {} | {} | {} |",
                cell(&judgement.scenario),
                cell(judgement.metric.name()),
                judgement.nights,
                cell(&judgement.in_words())
            );
        }
        for remark in &self.remarks {
            let _ = writeln!(text, "\n- {}", cell(remark));
        }
        text
    }
}

/// As `@actions/core` escapes data. Hosts say a part of it, and a terminal may show it, too.
fn message(text: &str) -> String {
    harmless(text).replace('%', "%25").replace('\n', "%0A")
}

/// As it escapes properties.
fn property(text: &str) -> String {
    message(text).replace(':', "%3A").replace(',', "%2C")
}

/// Without what would end a cell or be markup.
fn cell(text: &str) -> String {
    let mut cell = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '|' | '*' | '_' | '`' | '<' | '>' | '[' | ']' | '\\' => {
                cell.push('\\');
                cell.push(letter);
            }
            letter if is_unseen(letter) => cell.push(' '),
            letter => cell.push(letter),
        }
    }
    cell
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_container_said_is_neither_a_command_nor_markup() {
        assert_eq!(message("50 %\n::set-env::"), "50 %25%0A: :set-env::");
        assert_eq!(
            message("\u{1b}]0;a\u{7}\r##[error]"),
            "\\u{1b}]0;a\\u{7}\\u{d}## [error]"
        );
        assert_eq!(property("a: b, c"), "a%3A b%2C c");
        assert_eq!(property("a\u{1b}b"), "a\\u{1b}b");
        assert_eq!(cell("a\u{202e}b"), "a b");
        assert_eq!(cell("a|b\n**c**"), "a\\|b \\*\\*c\\*\\*");
    }
}
