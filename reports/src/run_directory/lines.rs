//! The lines of a file of numbers with commas between them, each with its fields, straight from the buffer that the file is
//! read into. Nothing is quoted in such a file; blank lines are skipped. The main type is [`Lines`].

use std::io::{self, BufRead, BufReader, Read};

use memchr::memchr2_iter;

/// Large enough for some hundred lines at a time, small enough for a processor's second cache.
const BUFFER: usize = 1 << 17;
/// No line of a log is nearly so long. What is longer is not kept whole.
const LONGEST: u64 = 1 << 20;

/// Goes through the lines of what it reads.
pub(super) struct Lines<R> {
    reader: BufReader<R>,
    /// Bytes of the buffer that the last line took.
    taken: usize,
    /// A line that lies across two fillings of the buffer.
    across: Vec<u8>,
    /// Where the fields but the last end.
    ends: Vec<usize>,
}

/// A line, without its end.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Fields<'a> {
    line: &'a [u8],
    ends: &'a [usize],
}

impl<R: Read> Lines<R> {
    pub(super) fn of(inner: R) -> Self {
        Self {
            reader: BufReader::with_capacity(BUFFER, inner),
            taken: 0,
            across: Vec::new(),
            ends: Vec::new(),
        }
    }

    /// The next line that is not blank; none at the end. A last line need not have an end.
    pub(super) fn next(&mut self) -> io::Result<Option<Fields<'_>>> {
        loop {
            self.reader.consume(std::mem::take(&mut self.taken));
            let block = self.reader.fill_buf()?;
            if block.is_empty() {
                return Ok(None);
            }
            let Some(length) = parted(block, &mut self.ends) else {
                self.across.clear();
                (&mut self.reader)
                    .take(LONGEST)
                    .read_until(b'\n', &mut self.across)?;
                let length = parted(&self.across, &mut self.ends).unwrap_or(self.across.len());
                self.across.truncate(length);
                if is_blank(&self.across) {
                    continue;
                }
                return Ok(Some(Fields::of(&self.across, &self.ends)));
            };
            self.taken = length + 1;
            if is_blank(block.get(..length).unwrap_or_default()) {
                continue;
            }
            // The same bytes: they are in the buffer until they are consumed.
            let block = self.reader.fill_buf()?;
            return Ok(Some(Fields::of(
                block.get(..length).unwrap_or_default(),
                &self.ends,
            )));
        }
    }
}

/// Where the first line ends, if it does, and in `ends` where its fields do.
fn parted(block: &[u8], ends: &mut Vec<usize>) -> Option<usize> {
    ends.clear();
    for at in memchr2_iter(b',', b'\n', block) {
        if block.get(at) == Some(&b'\n') {
            return Some(at);
        }
        ends.push(at);
    }
    None
}

fn is_blank(line: &[u8]) -> bool {
    matches!(line, [] | [b'\r'])
}

impl<'a> Fields<'a> {
    fn of(line: &'a [u8], ends: &'a [usize]) -> Self {
        Self {
            line: line.strip_suffix(b"\r").unwrap_or(line),
            ends,
        }
    }

    /// The whole line.
    pub(super) fn line(&self) -> &'a [u8] {
        self.line
    }

    /// How many fields there are; at least one.
    pub(super) fn len(&self) -> usize {
        self.ends.len() + 1
    }

    /// A field, from 0; empty if there is none.
    pub(super) fn get(&self, at: usize) -> &'a [u8] {
        let begin = match at.checked_sub(1) {
            None => Some(0),
            Some(before) => self.ends.get(before).map(|end| end + 1),
        };
        let end = self.ends.get(at).copied().unwrap_or(self.line.len());
        begin
            .and_then(|begin| self.line.get(begin..end))
            .unwrap_or_default()
    }

    /// All fields, in order.
    pub(super) fn iter(self) -> impl Iterator<Item = &'a [u8]> {
        (0..self.len()).map(move |at| self.get(at))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Hands out few bytes at a time, so that lines lie across.
    struct Trickle<'a>(&'a [u8], usize);

    impl Read for Trickle<'_> {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            let (now, later) = self.0.split_at(self.1.min(self.0.len()).min(buffer.len()));
            buffer[..now.len()].copy_from_slice(now);
            self.0 = later;
            Ok(now.len())
        }
    }

    fn read(text: &str, at_a_time: usize) -> Vec<Vec<String>> {
        let mut lines = Lines::of(Trickle(text.as_bytes(), at_a_time));
        let mut found = Vec::new();
        while let Some(fields) = lines.next().unwrap() {
            assert_eq!(fields.iter().count(), fields.len());
            let text = |field: &[u8]| String::from_utf8(field.to_vec()).unwrap();
            found.push(fields.iter().map(text).collect());
        }
        found
    }

    #[test]
    fn lines_and_fields_are_the_same_however_the_bytes_come() {
        let text = "step,x\r\n\n1,2.5\n\r\n,\n3\n4,5,,6";
        let expected = [
            &["step", "x"][..],
            &["1", "2.5"],
            &["", ""],
            &["3"],
            &["4", "5", "", "6"],
        ];
        for at_a_time in 1..=text.len() + 1 {
            assert_eq!(read(text, at_a_time), expected, "{at_a_time}");
        }
    }

    #[test]
    fn nothing_has_no_lines() {
        assert_eq!(read("", 1), Vec::<Vec<String>>::new());
        assert_eq!(read("\n\r\n", 1), Vec::<Vec<String>>::new());
    }

    #[test]
    fn a_line_without_an_end_is_cut_and_not_kept_whole() {
        let endless = io::repeat(b'1').take(3 * LONGEST);
        let mut lines = Lines::of(endless);
        let mut lengths = Vec::new();
        while let Some(fields) = lines.next().unwrap() {
            lengths.push(fields.line().len() as u64);
        }
        assert_eq!(lengths, [LONGEST; 3]);
    }
}
