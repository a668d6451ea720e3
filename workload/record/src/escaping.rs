//! Text from elsewhere in lines that a terminal shows and a CI system records: what comes from a host, an engine, a run directory
//! or another user does nothing but be read. The main function is [`harmless`].

use std::fmt::Write as _;

/// A text that a terminal only shows and a CI system only records. Control characters, C1 among them, and what turns the direction
/// of writing are spelt out. So that GitHub's and Azure's runners take no line for a command of theirs (`::set-output …` at a
/// line's beginning, `##[…]` and `##vso[…]` anywhere in it), a space stands in it.
#[must_use]
pub fn harmless(text: &str) -> String {
    let mut harmless = String::with_capacity(text.len());
    for line in text.split_inclusive('\n') {
        harmless.push_str(&without_commands(&visible(line)));
    }
    harmless
}

/// The same in one line, without any control character.
#[must_use]
pub fn harmless_line(text: &str) -> String {
    harmless(&text.replace('\n', "\\n").replace('\t', "\\t"))
}

/// A text as it is, but for what a reader would not see: that is spelt out. Ends of lines and tabs stay.
#[must_use]
pub fn visible(text: &str) -> String {
    let mut visible = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '\n' | '\t' => visible.push(character),
            _ if is_unseen(character) => {
                let _ = write!(visible, "{}", character.escape_unicode());
            }
            _ => visible.push(character),
        }
    }
    visible
}

/// Whether a reader would not see it, or see what follows elsewhere.
#[must_use]
pub fn is_unseen(character: char) -> bool {
    // Unicode's Default_Ignorable_Code_Point but for variation selectors, which belong to emoji, and what separates lines.
    character.is_control()
        || matches!(character,
            '\u{ad}' | '\u{34f}' | '\u{61c}' | '\u{115f}' | '\u{1160}' | '\u{17b4}' | '\u{17b5}'
            | '\u{180b}'..='\u{180f}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}'
            | '\u{2060}'..='\u{206f}' | '\u{3164}' | '\u{feff}' | '\u{ffa0}' | '\u{fff9}'..='\u{fffb}'
            | '\u{e0000}'..='\u{e0fff}')
}

/// One line that no runner takes for a command.
#[must_use]
pub fn without_commands(line: &str) -> String {
    let shown = line.replace("##[", "## [").replace("##vso[", "## vso[");
    let words = shown.trim_start();
    match words.strip_prefix("::") {
        Some(rest) => {
            let indent = shown.get(..shown.len() - words.len()).unwrap_or_default();
            format!("{indent}: :{rest}")
        }
        None => shown,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case::plain("window 1 complete\n\tvalid – 3 µs", "window 1 complete\n\tvalid – 3 µs")]
    #[case::title("\u{1b}]0;mine\u{7}x", "\\u{1b}]0;mine\\u{7}x")]
    #[case::c1("\u{9b}31m", "\\u{9b}31m")]
    #[case::carriage_return("ok\rno", "ok\\u{d}no")]
    #[case::bidi("a\u{202e}b\u{2066}", "a\\u{202e}b\\u{2066}")]
    #[case::soft_hyphen("a\u{ad}b", "a\\u{ad}b")]
    #[case::joiner("a\u{200d}b\u{2060}", "a\\u{200d}b\\u{2060}")]
    #[case::filler("\u{115f}\u{3164}\u{ffa0}", "\\u{115f}\\u{3164}\\u{ffa0}")]
    #[case::annotation("\u{fff9}a\u{fffb}", "\\u{fff9}a\\u{fffb}")]
    #[case::tag("a\u{e0041}\u{e007f}", "a\\u{e0041}\\u{e007f}")]
    #[case::accent("é e\u{301}", "é e\u{301}")]
    #[case::command("::error::no", ": :error::no")]
    #[case::command_in_the_second_line("x\n  ::set-output name=a::b", "x\n  : :set-output name=a::b")]
    #[case::old_command("all is well ##[set-output name=a;]b", "all is well ## [set-output name=a;]b")]
    #[case::azure("##vso[task.setvariable variable=a]b", "## vso[task.setvariable variable=a]b")]
    #[case::address_of_ipv6("fe80::1 is a::b", "fe80::1 is a::b")]
    #[case::heading("## Table I", "## Table I")]
    fn a_text_from_elsewhere_only_shows(#[case] text: &str, #[case] shown: &str) {
        assert_eq!(harmless(text), shown);
    }

    #[test]
    fn one_line_stays_one() {
        assert_eq!(harmless_line("a\n::error::b"), "a\\n::error::b");
        assert_eq!(harmless_line("a \tb"), "a \\tb");
    }

    proptest::proptest! {
        #[test]
        fn whatever_it_is_nothing_of_it_is_done(text in "(::|##\\[|\\PC|\\p{Cc}|\n| ){0,40}") {
            let shown = harmless(&text);
            proptest::prop_assert!(!shown.chars().any(|it| is_unseen(it) && it != '\n' && it != '\t'));
            proptest::prop_assert!(!shown.contains("##["));
            proptest::prop_assert!(!shown.lines().any(|line| line.trim_start().starts_with("::")));
            proptest::prop_assert!(!harmless_line(&text).contains(is_unseen));
        }
    }
}
