//! Why something is as it is, in words that a person reads. The main function is [`shortened`].
//!
//! Hosts and run directories say reasons, too, and a report has all of them in memory, some of them several times.

/// Characters of a reason. A command's last words are 300 of them, and a sentence of ours is some hundred.
const LONGEST: usize = 1000;

/// A reason as it is kept: the end of one that nobody would read is left out.
#[must_use]
pub fn shortened(reason: &str) -> String {
    match reason.char_indices().nth(LONGEST) {
        None => reason.to_owned(),
        Some((end, _)) => {
            let kept = reason.get(..end).unwrap_or_default();
            format!("{kept}{MARK}")
        }
    }
}

/// The same, of each that is there.
pub(crate) fn shorten<'a>(reasons: impl IntoIterator<Item = &'a mut String>) {
    for it in reasons {
        *it = shortened(it);
    }
}

/// Stands for what was left out.
const MARK: &str = "…";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reason_of_ours_stays_and_a_long_one_loses_its_end() {
        let ours = "window.json is missing, so it was never finished";
        assert_eq!(shortened(ours), ours);
        let long = "µ".repeat(5000);
        let kept = shortened(&long);
        assert_eq!(kept, format!("{}…", "µ".repeat(1000)));
        assert_eq!(shortened(&kept), kept);
    }
}
