//! The lines of a file of numbers with commas between them, each with its fields, straight from the buffer that the file is
//! read into. Nothing is quoted in such a file; blank lines are skipped. The main type is [`Lines`].
//!
//! Commas and ends of lines are looked for sixteen bytes at a time, in the whole buffer before the first of its lines is
//! handed out (the first stage of Langdale and Lemire, *Parsing gigabytes of JSON per second*, VLDB Journal 28, 2019): in a
//! log there is a comma every 17 bytes, too often to go from one to the next by a search for each.

use std::{
    io::{self, Read},
    ops::Range,
};

use wide::u8x16;

/// Large enough for some hundred lines at a time, small enough for a processor's second cache.
const BUFFER: usize = 1 << 17;
/// No line of a log is nearly so long. What is longer is not kept whole.
const LONGEST: usize = 1 << 20;

/// Goes through the lines of what it reads.
pub(super) struct Lines<R> {
    inner: R,
    buffer: Vec<u8>,
    /// How much of the buffer was read.
    filled: usize,
    /// Where the next line begins.
    begin: usize,
    /// Where the lines and fields are that are whole in the buffer.
    parts: Parts,
    /// Of the parts.
    next_line: usize,
    /// The next line's first mark.
    next_mark: usize,
}

/// Where the fields and lines of a block end.
#[derive(Debug, Default)]
struct Parts {
    /// Where there is a comma or a line's end; there is room behind those that were found.
    marks: Vec<u32>,
    found: usize,
    /// Where a line ends, and how many marks are before that.
    lines: Vec<(usize, usize)>,
    /// Whether there is a byte that only names have, and neither digits, signs, points nor exponents.
    has_names: bool,
}

/// A line, without its end.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Fields<'a> {
    block: &'a [u8],
    begin: usize,
    end: usize,
    /// Where the fields but the last end, in the block.
    ends: &'a [u32],
    may_have_names: bool,
}

impl<R: Read> Lines<R> {
    pub(super) fn of(inner: R) -> Self {
        Self {
            inner,
            buffer: vec![0; BUFFER],
            filled: 0,
            begin: 0,
            parts: Parts::default(),
            next_line: 0,
            next_mark: 0,
        }
    }

    /// The next line that is not blank; none at the end. A last line need not have an end.
    pub(super) fn next(&mut self) -> io::Result<Option<Fields<'_>>> {
        loop {
            let Some(&(at, marks)) = self.parts.lines.get(self.next_line) else {
                if self.fill()? {
                    continue;
                }
                return Ok(None);
            };
            let (begin, first) = (self.begin, self.next_mark);
            self.begin = at + 1;
            self.next_line += 1;
            self.next_mark = marks + 1;
            let end = match at.checked_sub(1) {
                Some(last) if last >= begin && self.buffer.get(last) == Some(&b'\r') => last,
                _ => at,
            };
            if begin == end {
                continue;
            }
            return Ok(Some(Fields {
                block: &self.buffer,
                begin,
                end,
                ends: self.parts.marks.get(first..marks).unwrap_or_default(),
                may_have_names: self.parts.has_names,
            }));
        }
    }

    /// Reads on until there is a line, and says whether there is one.
    fn fill(&mut self) -> io::Result<bool> {
        let rest = self.begin.min(self.filled)..self.filled;
        let mut searched = 0;
        self.filled = rest.len();
        self.buffer.copy_within(rest, 0);
        self.begin = 0;
        self.next_line = 0;
        self.next_mark = 0;
        self.parts.clear();
        loop {
            if self.filled == self.buffer.len() {
                if self.filled >= LONGEST {
                    // Of what is no line of a log, as much as there is room for.
                    self.end_line_at(self.filled);
                    return Ok(true);
                }
                self.buffer.resize((2 * self.filled).min(LONGEST), 0);
            }
            let at_end = self.read_to_the_brim()?;
            self.parts.find(&self.buffer, searched..self.filled);
            searched = self.filled;
            if at_end && !self.ends_with_a_line() {
                self.end_line_at(self.filled);
            }
            if !self.parts.lines.is_empty() {
                return Ok(true);
            }
            if at_end {
                return Ok(false);
            }
        }
    }

    /// Whether nothing was read after the last line's end.
    fn ends_with_a_line(&self) -> bool {
        let end = self.parts.lines.last().map_or(0, |(at, _)| at + 1);
        end == self.filled
    }

    /// What is left is a line, although it has no end.
    fn end_line_at(&mut self, at: usize) {
        self.parts.lines.push((at, self.parts.found));
    }

    /// Until the buffer is full. Says whether there is no more to read.
    fn read_to_the_brim(&mut self) -> io::Result<bool> {
        while let Some(room @ [_, ..]) = self.buffer.get_mut(self.filled..) {
            match self.inner.read(room) {
                Ok(0) => return Ok(true),
                Ok(read) => self.filled += read,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(false)
    }
}

/// The bits that n and i have, small and capital, and no byte of a number: not e either.
const NAMES: u8 = b'n' & b'i' & b'N' & b'I';

/// Bytes that are looked at together, one bit of a word each.
const STRIDE: usize = 64;

impl Parts {
    fn clear(&mut self) {
        self.found = 0;
        self.lines.clear();
        self.has_names = false;
    }

    /// Adds what is in that range of a block, which follows what was looked through before.
    fn find(&mut self, block: &[u8], range: Range<usize>) {
        let begin = range.start;
        // There may be nothing but marks.
        let room = self.found + range.len() + STRIDE;
        if self.marks.len() < room {
            self.marks.resize(room, 0);
        }
        let (strides, rest) = block.get(range).unwrap_or_default().as_chunks();
        let mut names = u8x16::default();
        for (nth, bytes) in strides.iter().enumerate() {
            self.add(begin + nth * STRIDE, bytes, &mut names);
        }
        let mut padded = [b'0'; STRIDE];
        for (padded, byte) in padded.iter_mut().zip(rest) {
            *padded = *byte;
        }
        self.add(begin + strides.len() * STRIDE, &padded, &mut names);
        self.has_names |= names.any();
    }

    fn add(&mut self, begin: usize, bytes: &[u8; STRIDE], names: &mut u8x16) {
        let (mut marks, mut ends) = (0, 0);
        for (nth, sixteen) in bytes.as_chunks().0.iter().enumerate() {
            let sixteen = u8x16::new(*sixteen);
            let is = |byte: u8| sixteen.cmp_eq(u8x16::splat(byte));
            *names |= (sixteen & u8x16::splat(NAMES)).cmp_eq(u8x16::splat(NAMES));
            let end = is(b'\n');
            marks |= bits(is(b',') | end) << (16 * nth);
            ends |= bits(end) << (16 * nth);
        }
        while ends != 0 {
            let at = ends.trailing_zeros();
            let before = marks & !(u64::MAX << at);
            self.lines
                .push((begin + at as usize, self.found + before.count_ones() as usize));
            ends &= ends - 1;
        }
        let count = marks.count_ones() as usize;
        if let Some(room) = self
            .marks
            .get_mut(self.found..)
            .and_then(|room| room.first_chunk_mut::<STRIDE>())
        {
            // More than there are, as long as these are few: there is room, and no branch to be guessed wrong.
            for (nth, slot) in room.iter_mut().enumerate() {
                if nth % 8 == 0 && nth >= count {
                    break;
                }
                *slot = begin as u32 + marks.trailing_zeros();
                marks &= marks.wrapping_sub(1);
            }
        }
        self.found += count;
    }
}

fn bits(mask: u8x16) -> u64 {
    u64::from(mask.move_mask().cast_unsigned())
}

impl<'a> Fields<'a> {
    /// The whole line.
    pub(super) fn line(&self) -> &'a [u8] {
        self.block.get(self.begin..self.end).unwrap_or_default()
    }

    /// Whether a byte of the line may be an `n` or an `i`, small or capital, as only NaN and infinity have. If not, none is.
    pub(super) fn may_have_names(&self) -> bool {
        self.may_have_names
    }

    /// How many fields there are; at least one.
    pub(super) fn len(&self) -> usize {
        self.ends.len() + 1
    }

    /// A field, from 0; empty if there is none.
    pub(super) fn get(&self, at: usize) -> &'a [u8] {
        let begin = match at.checked_sub(1) {
            None => Some(self.begin),
            Some(before) => self.ends.get(before).map(|end| *end as usize + 1),
        };
        let end = self.ends.get(at).map_or(self.end, |end| *end as usize);
        begin
            .and_then(|begin| self.block.get(begin..end))
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
        let endless = io::repeat(b'1').take(3 * LONGEST as u64);
        let mut lines = Lines::of(endless);
        let mut lengths = Vec::new();
        while let Some(fields) = lines.next().unwrap() {
            lengths.push(fields.line().len());
        }
        assert_eq!(lengths, [LONGEST; 3]);
    }
}
