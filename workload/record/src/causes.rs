//! How an error and its causes are told to a person. The main function is [`with_causes`].

use std::{error::Error, iter};

/// An error and its causes, as one line. Many an error repeats its cause's words at its end: they are said once.
#[must_use]
pub fn with_causes(error: &dyn Error) -> String {
    let causes = iter::successors(error.source(), |cause: &&dyn Error| (*cause).source());
    causes.fold(error.to_string(), |line, cause| {
        let words = cause.to_string();
        match line.ends_with(&words) {
            true => line,
            false => format!("{line}: {words}"),
        }
    })
}

#[cfg(test)]
mod tests {
    use std::io;

    use rstest::rstest;

    use super::*;

    /// An error with its own words and a cause.
    #[derive(Debug, thiserror::Error)]
    #[error("{words}")]
    struct Failed {
        words: &'static str,
        source: io::Error,
    }

    #[rstest]
    #[case::with_words_of_its_own("cannot write x", "cannot write x: disk full")]
    #[case::with_the_words_of_its_cause("cannot write x: disk full", "cannot write x: disk full")]
    #[case::with_its_causes_words_elsewhere("disk full of x", "disk full of x: disk full")]
    fn an_error(#[case] words: &'static str, #[case] line: &str) {
        let source = io::Error::other("disk full");
        assert_eq!(with_causes(&Failed { words, source }), line);
    }
}
