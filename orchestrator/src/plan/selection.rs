//! Which scenarios were asked for: `--only` and `--skip`. The main type is [`Selection`].

use std::sync::Arc;

use wildmatch::WildMatch;

use crate::matrix_file::{
    Code, Diagnostic, Diagnostics, did_you_mean, list,
    source::{Source, Span},
};

/// Patterns of scenarios: a letter, a slug, `axis=value`, each with `*` and `?`.
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
    fn matches(&self, pattern: &str) -> bool {
        let glob = WildMatch::new(pattern);
        if glob.matches(&self.letter) || glob.matches(&self.slug) {
            return true;
        }
        pattern.split_once('=').is_some_and(|(axis, value)| {
            let value = WildMatch::new(value.trim());
            let mut axes = self.axes.iter();
            axes.any(|(name, text)| name == axis.trim() && value.matches(text))
        })
    }
}

impl Selection {
    /// For each candidate why it is left out, or none if it runs.
    ///
    /// # Errors
    /// Each pattern that matches nothing, and a selection that leaves nothing.
    pub fn apply(&self, candidates: &[Candidate]) -> Result<Vec<Option<String>>, Diagnostics> {
        let mut found = Diagnostics::new();
        for (option, patterns) in [("--only", &self.only), ("--skip", &self.skip)] {
            for pattern in patterns {
                if !candidates.iter().any(|candidate| candidate.matches(pattern)) {
                    let message = format!("`{option} {pattern}` matches no scenario");
                    found.push(error(option, pattern, message).help(proposal(pattern, candidates)));
                }
            }
        }
        if !found.is_empty() {
            return Err(found);
        }
        let left_out: Vec<_> = candidates
            .iter()
            .map(|candidate| self.why_not(candidate))
            .collect();
        if !left_out.is_empty() && left_out.iter().all(Option::is_some) {
            return Err(self.leaves_nothing(candidates).into());
        }
        Ok(left_out)
    }

    fn why_not(&self, candidate: &Candidate) -> Option<String> {
        if !self.only.is_empty() && !self.only.iter().any(|pattern| candidate.matches(pattern)) {
            return Some(format!("not selected by `--only {}`", self.only.join(",")));
        }
        let skipped = self.skip.iter().find(|pattern| candidate.matches(pattern));
        skipped.map(|pattern| format!("left out by `--skip {pattern}`"))
    }

    /// Each pattern matches something, so that it is `--skip` which takes the rest away.
    fn leaves_nothing(&self, candidates: &[Candidate]) -> Diagnostic {
        let patterns = self.skip.join(",");
        let message = format!("with `--skip {patterns}` no scenario is left");
        error("--skip", &patterns, message).help(all(candidates))
    }
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

/// A slug that is nearly it, or a value without its axis.
fn meant_word(word: &str, candidates: &[Candidate]) -> Option<String> {
    let with_axis = |value: &str| {
        let (axis, _) = pairs(candidates).find(|(_, text)| *text == value)?;
        Some(format!("{axis}={value}"))
    };
    let slugs = candidates.iter().map(|candidate| candidate.slug.as_str());
    with_axis(word)
        .or_else(|| did_you_mean(word, slugs).map(str::to_owned))
        .or_else(|| with_axis(did_you_mean(word, pairs(candidates).map(|(_, value)| value))?))
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
    #[case::skip_wins(&["virtualization=docker"], &["a"], "c")]
    fn patterns_select(#[case] only: &[&str], #[case] skip: &[&str], #[case] kept: &str) {
        assert_eq!(selected(only, skip).unwrap(), kept);
    }

    #[rstest]
    #[case::a_misspelt_value(&["virtualization=dokcer"], "did you mean `virtualization=docker`?")]
    #[case::a_misspelt_axis(&["hardwear=i686"], "did you mean `hardware=i686`?")]
    #[case::a_bare_value(&["docker"], "did you mean `virtualization=docker`?")]
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
