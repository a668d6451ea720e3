//! The checksums of a journal's lines: each is of its line and of the one before it, so that a line that was changed, taken
//! out or put in is found. The main type is [`Chain`].
//!
//! ```text
//! {"at":"…","event":"run-finished","sum":"0123456789abcdef"}
//!                                   the first 16 digits of SHA-256(sum of the line before, this line without its sum)
//! ```
//!
//! Lines of earlier versions have none. They are covered all the same by the sum of the first line after them that has one.

use sha2::{Digest, Sha256};

use super::JournalEntry;

/// 64 bits: chance does not meet them, and against intent no checksum helps.
const DIGITS: usize = 16;
const KEY: &[u8] = br#","sum":""#;
const END: &[u8] = br#""}"#;

/// Where a journal's checksums have come to.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Chain {
    /// Of the last line, whether or not it says so itself; empty before the first.
    last: String,
    /// Whether the last line has its sum.
    is_summed: bool,
}

/// A line that is not as it was written, or does not follow on the one before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Changed;

impl Chain {
    /// Whether the last line has a checksum, and so all lines are checked.
    #[must_use]
    pub const fn is_checked(&self) -> bool {
        self.is_summed
    }

    /// An entry as the next line, with its checksum and a line feed.
    ///
    /// # Errors
    /// When the entry has no JSON.
    pub fn line(&mut self, entry: &JournalEntry) -> serde_json::Result<Vec<u8>> {
        let mut line = serde_json::to_vec(entry)?;
        // The brace comes behind the sum.
        line.pop();
        self.last = self.sum_of(&line);
        self.is_summed = true;
        line.extend_from_slice(KEY);
        line.extend_from_slice(self.last.as_bytes());
        line.extend_from_slice(END);
        line.push(b'\n');
        Ok(line)
    }

    /// Goes on with a line that was read, without its line feed.
    pub(super) fn follow(&mut self, line: &[u8]) -> Result<(), Changed> {
        let (content, said) = split(line);
        self.last = self.sum_of(content);
        let holds = match said {
            Some(said) => said == self.last.as_bytes(),
            // Who writes sums writes them to the end.
            None => !self.is_summed,
        };
        self.is_summed = said.is_some();
        if holds { Ok(()) } else { Err(Changed) }
    }

    fn sum_of(&self, content: &[u8]) -> String {
        let hash = Sha256::new().chain_update(&self.last).chain_update(content);
        let mut sum = format!("{:x}", hash.finalize());
        sum.truncate(DIGITS);
        sum
    }
}

/// What a line's sum is of, and the sum; all of the line if it has none.
fn split(line: &[u8]) -> (&[u8], Option<&[u8]>) {
    let found = line.strip_suffix(END).and_then(|rest| {
        let (rest, sum) = rest.split_at_checked(rest.len().checked_sub(DIGITS)?)?;
        Some((rest.strip_suffix(KEY)?, sum))
    });
    match found {
        Some((content, sum)) => (content, Some(sum)),
        None => (line, None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run_directory::Event;

    fn lines() -> Vec<Vec<u8>> {
        let mut chain = Chain::default();
        let events = [Event::RunInterrupted, Event::RunInterrupted, Event::RunFinished];
        events
            .map(|event| {
                let at = "2026-11-21T04:00:00.000Z".to_owned();
                let mut line = chain.line(&JournalEntry { at, event }).unwrap();
                assert_eq!(line.pop(), Some(b'\n'));
                line
            })
            .to_vec()
    }

    fn follow(lines: &[Vec<u8>]) -> Result<Chain, Changed> {
        let mut chain = Chain::default();
        lines.iter().try_for_each(|line| chain.follow(line))?;
        Ok(chain)
    }

    #[test]
    fn a_line_is_an_entry_with_its_sum_and_lines_follow_on_each_other() {
        let lines = lines();
        let text = std::str::from_utf8(&lines[0]).unwrap();
        let begin = r#"{"at":"2026-11-21T04:00:00.000Z","event":"run-interrupted","sum":""#;
        assert_eq!(text.strip_prefix(begin).map(str::len), Some(DIGITS + END.len()));
        assert_ne!(lines[0], lines[1], "the same event again is another line");
        let entry: JournalEntry = serde_json::from_str(text).unwrap();
        assert_eq!(entry.event, Event::RunInterrupted);
        assert!(follow(&lines).unwrap().is_checked());
    }

    #[test]
    fn a_line_that_was_changed_taken_out_put_in_or_moved_is_found() {
        let whole = lines();
        for (line, content) in whole.iter().enumerate() {
            for at in 0..content.len() {
                let mut changed = whole.clone();
                changed[line][at] ^= 1;
                assert!(follow(&changed).is_err(), "byte {at} of line {line}");
            }
        }
        let mut changed = whole.clone();
        changed.remove(1);
        assert_eq!(follow(&changed), Err(Changed));
        let mut changed = whole.clone();
        changed.insert(1, whole[0].clone());
        assert_eq!(follow(&changed), Err(Changed));
        let mut changed = whole.clone();
        changed.swap(0, 1);
        assert_eq!(follow(&changed), Err(Changed));
        let mut changed = whole;
        changed.push(br#"{"at":"x","event":"run-finished"}"#.to_vec());
        assert_eq!(follow(&changed), Err(Changed), "a line without a sum");
    }

    #[test]
    fn lines_of_an_earlier_version_are_covered_by_what_follows_on_them() {
        let old = br#"{"at":"x","event":"run-interrupted"}"#.to_vec();
        let mut chain = follow(std::slice::from_ref(&old)).unwrap();
        assert!(!chain.is_checked());
        let at = "y".to_owned();
        let mut new = chain
            .line(&JournalEntry {
                at,
                event: Event::RunFinished,
            })
            .unwrap();
        new.pop();
        assert!(follow(&[old.clone(), new.clone()]).unwrap().is_checked());
        let mut other = old;
        other[7] = b'z';
        assert_eq!(follow(&[other, new]), Err(Changed));
    }
}
