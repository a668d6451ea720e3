//! What a person probably meant to write. The main function is [`did_you_mean`].

/// The candidate that `word` is most likely a misspelling of, if one is close enough.
///
/// Close is a third of the letters, by optimal string alignment: a swapped pair is one mistake. Words that differ in
/// their digits alone are two versions of a thing: `debian-12` is not a misspelt `debian-13`, though `x86_46` is a
/// misspelt `x86_64`.
#[must_use]
pub fn did_you_mean<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let lower = word.to_lowercase();
    candidates
        .into_iter()
        .filter(|candidate| *candidate != word)
        .map(|candidate| {
            let other = candidate.to_lowercase();
            (distance(&lower, &other), candidate, other)
        })
        .filter(|(distance, _, other)| {
            let longest = lower.chars().count().max(other.chars().count());
            *distance <= (longest / 3).max(1) && (longest > 1) && !are_two_versions(&lower, other)
        })
        .min_by_key(|(distance, _, _)| *distance)
        .map(|(_, candidate, _)| candidate)
}

/// `write one of …` with what was probably meant in front.
#[must_use]
pub fn propose<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str> + Clone) -> String {
    match did_you_mean(word, candidates.clone()) {
        Some(meant) => format!("did you mean `{meant}`?"),
        None => match list(candidates) {
            known if known.is_empty() => "leave it out".to_owned(),
            known => format!("write one of {known}"),
        },
    }
}

/// The words between backticks, with commas.
#[must_use]
pub fn list<'a>(words: impl IntoIterator<Item = &'a str>) -> String {
    let words: Vec<_> = words.into_iter().map(|word| format!("`{word}`")).collect();
    words.join(", ")
}

/// Number of mistakes. Words are cut at 100 letters: what is longer is no misspelling, and costs its square.
fn distance(a: &str, b: &str) -> usize {
    if a.chars().count() > 100 || b.chars().count() > 100 {
        return usize::MAX;
    }
    strsim::osa_distance(a, b)
}

fn are_two_versions(a: &str, b: &str) -> bool {
    let letters = |word: &str| -> String { word.chars().filter(|c| !c.is_ascii_digit()).collect() };
    let digits = |word: &str| {
        let mut digits: Vec<_> = word.chars().filter(char::is_ascii_digit).collect();
        digits.sort_unstable();
        digits
    };
    a != b && letters(a) == letters(b) && digits(a) != digits(b)
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    #[rstest]
    #[case::swapped_letters("dokcer", Some("docker"))]
    #[case::another_case("Docker", Some("docker"))]
    #[case::a_letter_too_few("natve", Some("native"))]
    #[case::something_else("kubernetes", None)]
    #[case::the_word_itself_is_no_misspelling("docker", None)]
    #[case::another_version("debian-13", None)]
    #[case::swapped_digits("debian-21", Some("debian-12"))]
    #[case::a_novel(&"x".repeat(1000), None)]
    fn a_near_miss_is_proposed(#[case] word: &str, #[case] meant: Option<&str>) {
        assert_eq!(did_you_mean(word, ["native", "docker", "debian-12"]), meant);
    }

    #[test]
    fn without_a_near_miss_all_there_is_is_proposed() {
        assert_eq!(
            propose("zzz", ["native", "docker"]),
            "write one of `native`, `docker`"
        );
    }
}
