//! JUnit's XML, which build servers show: a test case for each scenario and metric. The attributes are those of the schema of
//! Apache Ant's task, which Jenkins, GitLab and GitHub's actions read.

use std::fmt::Write;

use crate::drift::{Drift, Judgement, Verdict};

impl Drift {
    /// Drift is a failure; a measurement that is invalid, or missing, is an error, and never a pass.
    #[must_use]
    pub fn junit(&self) -> String {
        let count = |wanted: fn(&Verdict) -> bool| {
            let is_it = |it: &&Judgement| wanted(&it.verdict);
            self.judgements.iter().filter(is_it).count()
        };
        let failures = count(|verdict| matches!(verdict, Verdict::Drift));
        let errors = count(|verdict| matches!(verdict, Verdict::Invalid { .. } | Verdict::TooLittle { .. }));
        // An empty suite would pass.
        let nothing = usize::from(self.judgements.is_empty());
        let mut xml = format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<testsuites>\n  <testsuite name=\"matrix drift\" tests=\"{}\" \
             failures=\"{failures}\" errors=\"{}\" skipped=\"0\">\n",
            self.judgements.len() + nothing,
            errors + nothing,
        );
        if nothing > 0 {
            xml.push_str(
                "    <testcase classname=\"matrix\" name=\"drift\"><error message=\"nothing was judged\"/></testcase>\n",
            );
        }
        for judgement in &self.judgements {
            let _ = writeln!(
                xml,
                "    <testcase classname=\"{}\" name=\"{}\">{}</testcase>",
                escaped(&judgement.scenario),
                escaped(judgement.metric.name()),
                outcome(judgement)
            );
        }
        xml.push_str("  </testsuite>\n</testsuites>\n");
        xml
    }
}

fn outcome(judgement: &Judgement) -> String {
    let details: Vec<String> = judgement
        .findings
        .iter()
        .map(|finding| match finding.silence() {
            Some(silence) => format!("{}; {silence}", finding.in_words(&judgement.metric)),
            None => finding.in_words(&judgement.metric),
        })
        .collect();
    let (words, details) = (escaped(&judgement.in_words()), escaped(&details.join("\n")));
    match judgement.verdict {
        Verdict::Drift => format!("<failure message=\"{words}\">{details}</failure>"),
        Verdict::Invalid { .. } | Verdict::TooLittle { .. } => {
            format!("<error message=\"{words}\">{details}</error>")
        }
        Verdict::NoDrift { .. } => format!("<system-out>{words}\n{details}</system-out>"),
    }
}

/// For text and for attributes. Control characters are none that XML knows.
fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\n' => escaped.push('\n'),
            letter if letter.is_control() || matches!(letter, '\u{fffe}' | '\u{ffff}') => {
                escaped.push('\u{fffd}');
            }
            letter => escaped.push(letter),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_container_said_breaks_no_xml() {
        assert_eq!(
            escaped("a <b> & \"c\"\u{1b}[31m"),
            "a &lt;b&gt; &amp; &quot;c&quot;\u{fffd}[31m"
        );
    }
}
