//! What a command prints, of which the beginning and the end are kept. The main type is [`Kept`].

use std::{
    collections::VecDeque,
    io::{self, Read, Write},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

/// Bytes that are kept of the beginning, and as many of the end.
const HALF: usize = 512 << 10;

/// The beginning and the end of a stream.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Kept {
    /// How long the stream was.
    pub bytes: u64,
    first: Vec<u8>,
    last: VecDeque<u8>,
}

impl Kept {
    /// Reads a stream to its end, whatever is in it.
    pub fn read(mut from: impl Read, mut sought: Option<Sought>) -> Self {
        let mut kept = Self::default();
        let mut buffer = vec![0; 64 << 10];
        loop {
            match from.read(&mut buffer) {
                Ok(0) => return kept,
                Ok(count) => {
                    let part = buffer.get(..count).unwrap_or_default();
                    kept.add(part);
                    if let Some(sought) = &mut sought {
                        sought.look(part);
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                // What was there is kept.
                Err(_) => return kept,
            }
        }
    }

    fn add(&mut self, part: &[u8]) {
        self.bytes += part.len() as u64;
        let (first, rest) = part.split_at(part.len().min(HALF - self.first.len()));
        self.first.extend_from_slice(first);
        self.last.extend(rest);
        let over = self.last.len().saturating_sub(HALF);
        self.last.drain(..over);
    }

    /// Writes both, and between them how much is missing.
    ///
    /// # Errors
    /// What the file system says.
    pub fn write(&self, mut to: impl Write) -> io::Result<()> {
        to.write_all(&self.first)?;
        let missing = self.bytes - (self.first.len() + self.last.len()) as u64;
        if missing > 0 {
            writeln!(to, "\n[matrix: {missing} bytes are left out here]")?;
        }
        let (begin, end) = self.last.as_slices();
        to.write_all(begin)?;
        to.write_all(end)
    }

    /// The last characters, in one line and without what a terminal would obey.
    #[must_use]
    pub fn last_words(&self, most: usize) -> String {
        let end = if self.last.is_empty() {
            self.first.clone()
        } else {
            self.last.iter().copied().collect()
        };
        let text = String::from_utf8_lossy(&end);
        let lines: Vec<&str> = text
            .lines()
            .map(str::trim)
            .filter(|line| !line.is_empty())
            .collect();
        let shown: Vec<&str> = lines.iter().rev().take(3).rev().copied().collect();
        let shown = shown.join(" | ").replace(char::is_control, "\u{fffd}");
        let over = shown.chars().count().saturating_sub(most);
        shown.chars().skip(over).collect()
    }
}

/// A text that is looked for while a stream is read. A line that has not ended yet may have it.
#[derive(Debug)]
pub struct Sought {
    text: Vec<u8>,
    found: Arc<AtomicBool>,
    /// The end of what came before, which may be the beginning of the text.
    tail: Vec<u8>,
}

impl Sought {
    /// Sets `found` once the text has come.
    #[must_use]
    pub fn new(text: &str, found: &Arc<AtomicBool>) -> Self {
        Self {
            text: text.as_bytes().to_vec(),
            found: Arc::clone(found),
            tail: Vec::new(),
        }
    }

    fn look(&mut self, part: &[u8]) {
        if self.found.load(Ordering::Relaxed) {
            return;
        }
        self.tail.extend_from_slice(part);
        if self
            .tail
            .windows(self.text.len().max(1))
            .any(|window| window == self.text)
        {
            self.found.store(true, Ordering::Relaxed);
        }
        let kept = self.text.len().saturating_sub(1);
        self.tail.drain(..self.tail.len().saturating_sub(kept));
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    fn written(kept: &Kept) -> Vec<u8> {
        let mut to = Vec::new();
        kept.write(&mut to).unwrap();
        to
    }

    #[test]
    fn what_fits_is_kept_as_it_is() {
        let kept = Kept::read(&b"one\n\xfftwo"[..], None);
        assert_eq!(written(&kept), b"one\n\xfftwo");
        assert_eq!(kept.bytes, 8);
    }

    #[test]
    fn of_a_long_stream_the_ends_are_kept_and_how_much_is_missing_is_said() {
        let bytes: Vec<u8> = (0..3 * HALF).map(|at| b'a' + (at / HALF) as u8).collect();
        let kept = Kept::read(bytes.as_slice(), None);
        let text = String::from_utf8(written(&kept)).unwrap();
        assert_eq!(kept.bytes, 3 * HALF as u64);
        let between = format!("\n[matrix: {HALF} bytes are left out here]\n");
        assert_eq!(text.len(), 2 * HALF + between.len());
        assert!(text.starts_with("aaa") && text.ends_with("ccc") && text.contains(&between));
        assert!(!text.contains('b') || text.contains("bytes"));
    }

    #[rstest]
    #[case("", "")]
    #[case(
        "Traceback:\n  File\nValueError: no\n\n",
        "Traceback: | File | ValueError: no"
    )]
    #[case("a\nb\nc\nd\n", "b | c | d")]
    #[case("\u{1b}[31mred\u{7}", "\u{fffd}[31mred\u{fffd}")]
    fn last_words_are_the_last_lines_in_one(#[case] printed: &str, #[case] words: &str) {
        assert_eq!(Kept::read(printed.as_bytes(), None).last_words(300), words);
    }

    #[test]
    fn last_words_are_bounded() {
        assert_eq!(Kept::read(&b"0123456789"[..], None).last_words(4), "6789");
    }

    #[rstest]
    #[case(&["started", " listening on 80\n"], true)]
    #[case(&["lis", "ten", "ing"], true)]
    #[case(&["listenin", "G"], false)]
    #[case(&[], false)]
    fn a_text_is_found_however_it_comes(#[case] parts: &[&str], #[case] is_found: bool) {
        let found = Arc::new(AtomicBool::new(false));
        let mut sought = Sought::new("listening", &found);
        for part in parts {
            sought.look(part.as_bytes());
        }
        assert_eq!(found.load(Ordering::Relaxed), is_found);
    }
}
