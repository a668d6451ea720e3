//! Names in a sentence, of which a sweep has hundreds. The function is [`listed`].

/// Names up to which each is said. `report.json` has all of them.
const MOST: usize = 12;

/// The first names, and how many more there are: `a, b, c and 7 more`. Only the first are made.
pub(crate) fn listed<T: AsRef<str>>(
    names: impl IntoIterator<Item = T, IntoIter: ExactSizeIterator>,
) -> String {
    let names = names.into_iter();
    let all = names.len();
    let named = match all {
        // One more is named in no more room than it is counted.
        few if few <= MOST + 1 => few,
        _ => MOST,
    };
    let mut text = String::new();
    for (place, name) in names.take(named).enumerate() {
        if place > 0 {
            text.push_str(", ");
        }
        text.push_str(name.as_ref());
    }
    match all - named {
        0 => text,
        more => format!("{text} and {more} more"),
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    #[rstest]
    #[case(0, "")]
    #[case(2, "s1, s2")]
    #[case(13, "s1, s2, s3, s4, s5, s6, s7, s8, s9, s10, s11, s12, s13")]
    #[case(500, "s1, s2, s3, s4, s5, s6, s7, s8, s9, s10, s11, s12 and 488 more")]
    fn many_names_are_counted(#[case] count: usize, #[case] expected: &str) {
        let names: Vec<String> = (1..=count).map(|number| format!("s{number}")).collect();
        assert_eq!(listed(&names), expected);
    }
}
