//! For a terminal of 80 columns.

use textwrap::{Options, WordSeparator, WordSplitter};

use crate::drift::Drift;

const WIDTH: usize = 80;

impl Drift {
    /// The verdict, what changed, and a line for each scenario and metric.
    #[must_use]
    pub fn text(&self) -> String {
        let mut text = format!("{}\n", wrapped(&self.headline(), "", ""));
        let mut news = self.news().peekable();
        if news.peek().is_some() {
            text.push_str("\nChanged\n");
        }
        for (judgement, finding) in news {
            let told = format!(
                "{} {} {}",
                judgement.scenario,
                judgement.metric.name(),
                finding.in_words(&judgement.metric)
            );
            text.push_str(&format!("{}\n", wrapped(&told, "- ", "  ")));
        }
        if let Some((judgement, finding)) = self.news().next() {
            text.push_str("\nTo acknowledge a change, write it into drift.yaml; the first of these is\n\n");
            for line in self.acknowledgement(judgement, finding).lines() {
                text.push_str(&format!("    {line}\n"));
            }
        }
        text.push_str("\nEach scenario and metric\n");
        for judgement in &self.judgements {
            let told = format!(
                "{} {}: {}",
                judgement.scenario,
                judgement.metric.name(),
                judgement.in_words()
            );
            text.push_str(&format!("{}\n", wrapped(&told, "- ", "  ")));
            for finding in &judgement.findings {
                if let Some(silence) = finding.silence() {
                    let told = format!("{}; {silence}", finding.in_words(&judgement.metric));
                    text.push_str(&format!("{}\n", wrapped(&told, "  - ", "    ")));
                }
            }
        }
        if !self.remarks.is_empty() {
            text.push_str("\nRemarks\n");
        }
        for remark in &self.remarks {
            text.push_str(&format!("{}\n", wrapped(remark, "- ", "  ")));
        }
        text
    }
}

fn wrapped(text: &str, first: &str, rest: &str) -> String {
    let options = Options::new(WIDTH)
        .initial_indent(first)
        .subsequent_indent(rest)
        // Slugs and runs have hyphens, and are to be found again.
        .word_splitter(WordSplitter::NoHyphenation)
        .word_separator(WordSeparator::AsciiSpace);
    // A reason may come from a container's output, and this is a terminal.
    let plain: String = text
        .chars()
        .map(|letter| if letter.is_control() { ' ' } else { letter })
        .collect();
    textwrap::fill(&plain, options)
}
