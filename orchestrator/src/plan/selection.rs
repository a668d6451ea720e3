//! Which scenarios were asked for: `--only` and `--skip`. The main type is [`Selection`].

use std::sync::Arc;

use wildmatch::WildMatch;

use crate::matrix_file::{
    Code, Diagnostic, Diagnostics, did_you_mean, list,
    source::{Source, Span},
};

/// Patterns of scenarios: a letter, a slug, `axis=value` or a value of any axis, each with `*` and `?`.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Selection {
    /// Scenarios that match one of these run; all if there are none.
    pub only: Vec<String>,
    /// Scenarios that match one of these do not.
    pub skip: Vec<String>,
}

/// What a pattern is matched against.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Candidate {
    /// The scenario's letter.
    pub letter: String,
    /// Its slug.
    pub slug: String,
    /// Its axes and values.
    pub axes: Vec<(String, String)>,
}

impl Candidate {
    fn is_named(&self, pattern: &str) -> bool {
        let name = WildMatch::new(pattern);
        name.matches(&self.letter) || name.matches(&self.slug)
    }

    fn has_pair(&self, pattern: &str) -> bool {
        pattern.split_once('=').is_some_and(|(axis, value)| {
            let (axis, value) = (axis.trim(), WildMatch::new(value.trim()));
            // Reports call `network.loss` by its last part.
            let is_called = |name: &str| name == axis || name.rsplit('.').next() == Some(axis);
            let mut axes = self.axes.iter();
            axes.any(|(name, text)| is_called(name) && value.matches(text))
        })
    }

    fn has_value(&self, pattern: &str) -> bool {
        let value = WildMatch::new(pattern);
        self.axes.iter().any(|(_, text)| value.matches(text))
    }
}

/// A pattern in the first of its readings that matches a scenario: `a` is a letter, even if an axis has a value `a`.
struct Pattern<'a> {
    text: &'a str,
    matches: fn(&Candidate, &str) -> bool,
}

impl<'a> Pattern<'a> {
    const READINGS: [fn(&Candidate, &str) -> bool; 3] =
        [Candidate::is_named, Candidate::has_pair, Candidate::has_value];

    /// None if it matches nothing.
    fn of(text: &'a str, candidates: &[Candidate]) -> Option<Self> {
        let mut readings = Self::READINGS.into_iter();
        let matches = readings.find(|matches| candidates.iter().any(|candidate| matches(candidate, text)))?;
        Some(Self { text, matches })
    }

    fn selects(&self, candidate: &Candidate) -> bool {
        (self.matches)(candidate, self.text)
    }
}

impl Selection {
    /// For each candidate why it is left out, or none if it runs.
    ///
    /// # Errors
    /// Each pattern that matches nothing, and a selection that leaves nothing.
    pub fn apply<'a>(&'a self, candidates: &[Candidate]) -> Result<Vec<Option<String>>, Diagnostics> {
        let mut found = Diagnostics::new();
        let mut read = |option: &str, texts: &'a [String]| -> Vec<Pattern<'a>> {
            let patterns = texts.iter().filter_map(|text| {
                let pattern = Pattern::of(text, candidates);
                if pattern.is_none() {
                    let message = format!("`{option} {text}` matches no scenario");
                    found.push(error(option, text, message).help(proposal(text, candidates)));
                }
                pattern
            });
            patterns.collect()
        };
        let (only, skip) = (read("--only", &self.only), read("--skip", &self.skip));
        if !found.is_empty() {
            return Err(found);
        }
        let left_out: Vec<_> = candidates
            .iter()
            .map(|candidate| why_not(candidate, &only, &skip))
            .collect();
        if !left_out.is_empty() && left_out.iter().all(Option::is_some) {
            return Err(self.leaves_nothing(candidates).into());
        }
        Ok(left_out)
    }

    /// Each pattern matches something, so that it is `--skip` which takes the rest away.
    fn leaves_nothing(&self, candidates: &[Candidate]) -> Diagnostic {
        let patterns = self.skip.join(",");
        let message = format!("with `--skip {patterns}` no scenario is left");
        error("--skip", &patterns, message).help(all(candidates))
    }
}

fn why_not(candidate: &Candidate, only: &[Pattern<'_>], skip: &[Pattern<'_>]) -> Option<String> {
    if !only.is_empty() && !only.iter().any(|pattern| pattern.selects(candidate)) {
        let texts: Vec<_> = only.iter().map(|pattern| pattern.text).collect();
        return Some(format!("not selected by `--only {}`", texts.join(",")));
    }
    let skipped = skip.iter().find(|pattern| pattern.selects(candidate));
    skipped.map(|pattern| format!("left out by `--skip {}`", pattern.text))
}

/// The option's value is the text that is shown and underlined.
fn error(option: &str, value: &str, message: String) -> Diagnostic {
    let source = Arc::new(Source::new(option, value));
    let span = Span {
        start: 0,
        end: value.len(),
    };
    Diagnostic::error(&source, Code::EmptySelection, span, message)
}

fn proposal(pattern: &str, candidates: &[Candidate]) -> String {
    let meant = match pattern.split_once('=') {
        Some((axis, value)) => meant_pair(axis, value, candidates),
        None => meant_word(pattern, candidates),
    };
    match meant {
        Some(meant) => format!("did you mean `{meant}`? {}", all(candidates)),
        None => all(candidates),
    }
}

fn pairs(candidates: &[Candidate]) -> impl Iterator<Item = (&str, &str)> + Clone {
    let pairs = candidates.iter().flat_map(|candidate| &candidate.axes);
    pairs.map(|(axis, value)| (axis.as_str(), value.as_str()))
}

fn meant_pair(axis: &str, value: &str, candidates: &[Candidate]) -> Option<String> {
    let values: Vec<_> = pairs(candidates).filter(|(name, _)| *name == axis).collect();
    if values.is_empty() {
        let axis = did_you_mean(axis, pairs(candidates).map(|(name, _)| name))?;
        return Some(format!("{axis}={value}"));
    }
    let value = did_you_mean(value, values.iter().map(|(_, value)| *value))?;
    Some(format!("{axis}={value}"))
}

/// A slug or a value that is nearly it.
fn meant_word(word: &str, candidates: &[Candidate]) -> Option<String> {
    let slugs = candidates.iter().map(|candidate| candidate.slug.as_str());
    let values = pairs(candidates).map(|(_, value)| value);
    let meant = did_you_mean(word, slugs).or_else(|| did_you_mean(word, values))?;
    Some(meant.to_owned())
}

/// What there is to select, as long as a person still reads it.
fn all(candidates: &[Candidate]) -> String {
    const SHOWN: usize = 30;
    let names: Vec<_> = candidates
        .iter()
        .take(SHOWN)
        .map(|candidate| format!("{} {}", candidate.letter, candidate.slug))
        .collect();
    let names = list(names.iter().map(String::as_str));
    match candidates.len().saturating_sub(SHOWN) {
        0 => format!("there are {names}"),
        rest => format!("there are {names} and {rest} more"),
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    fn candidates() -> Vec<Candidate> {
        [
            ("a", "i686", "docker"),
            ("b", "i686", "native"),
            ("c", "arm64", "docker"),
        ]
        .iter()
        .map(|(letter, hardware, virtualization)| Candidate {
            letter: (*letter).to_owned(),
            slug: format!("{hardware}-{virtualization}"),
            axes: vec![
                ("hardware".to_owned(), (*hardware).to_owned()),
                ("virtualization".to_owned(), (*virtualization).to_owned()),
            ],
        })
        .collect()
    }

    fn selected(only: &[&str], skip: &[&str]) -> Result<String, Diagnostics> {
        let words = |words: &[&str]| words.iter().map(|word| (*word).to_owned()).collect();
        let selection = Selection {
            only: words(only),
            skip: words(skip),
        };
        let left_out = selection.apply(&candidates())?;
        let kept = std::iter::zip(candidates(), left_out).filter(|(_, why)| why.is_none());
        Ok(kept.map(|(candidate, _)| candidate.letter).collect())
    }

    #[rstest]
    #[case::all(&[], &[], "abc")]
    #[case::a_letter(&["b"], &[], "b")]
    #[case::several(&["b", "c"], &[], "bc")]
    #[case::a_slug(&["i686-native"], &[], "b")]
    #[case::a_glob(&["i686-*"], &[], "ab")]
    #[case::an_axis(&["virtualization=docker"], &[], "ac")]
    #[case::an_axis_with_a_glob(&["hardware=a*"], &[], "c")]
    #[case::a_value(&["native"], &[], "b")]
    #[case::a_value_with_a_glob(&["nat*"], &[], "b")]
    #[case::letters_and_slugs_before_values(&["a*"], &[], "ac")]
    #[case::a_value_to_skip(&[], &["docker"], "b")]
    #[case::skip_wins(&["virtualization=docker"], &["a"], "c")]
    fn patterns_select(#[case] only: &[&str], #[case] skip: &[&str], #[case] kept: &str) {
        assert_eq!(selected(only, skip).unwrap(), kept);
    }

    #[rstest]
    #[case::a_misspelt_value(&["virtualization=dokcer"], "did you mean `virtualization=docker`?")]
    #[case::a_misspelt_axis(&["hardwear=i686"], "did you mean `hardware=i686`?")]
    #[case::a_misspelt_bare_value(&["dokcer"], "did you mean `docker`?")]
    #[case::a_letter_too_far(&["z"], "there are `a i686-docker`, `b i686-native`, `c arm64-docker`")]
    fn a_pattern_that_matches_nothing_is_an_error(#[case] only: &[&str], #[case] help: &str) {
        let found = selected(only, &[]).unwrap_err();
        let told = found.iter().next().unwrap();
        assert!(told.help.as_deref().unwrap().starts_with(help), "{:?}", told.help);
    }

    #[test]
    fn a_selection_that_leaves_nothing_is_an_error() {
        assert!(selected(&["a"], &["hardware=i686"]).is_err());
    }
}
