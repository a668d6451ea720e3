//! A log whose lines are no longer than any that a workload writes. The main type is [`ShortLines`].

use std::io::{self, Read};

/// A line of a log has some 200 bytes. Whatever reads lines whole would need as much memory as a file from elsewhere has in one line.
const LONGEST: usize = 1 << 16;

/// Reads on, and fails within a line that is longer than that.
#[derive(Debug)]
pub struct ShortLines<R> {
    inner: R,
    /// Bytes of the line that has not ended.
    in_line: usize,
}

impl<R> ShortLines<R> {
    /// Of what `inner` reads.
    pub const fn new(inner: R) -> Self {
        Self { inner, in_line: 0 }
    }
}

impl<R: Read> Read for ShortLines<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.inner.read(buffer)?;
        for (nth, part) in buffer
            .get(..read)
            .unwrap_or_default()
            .split(|byte| *byte == b'\n')
            .enumerate()
        {
            self.in_line = match nth {
                0 => self.in_line + part.len(),
                _ => part.len(),
            };
            if self.in_line > LONGEST {
                return Err(io::Error::new(
                    io::ErrorKind::InvalidData,
                    format!("a line has more than {LONGEST} bytes, and no workload writes one that long"),
                ));
            }
        }
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_a_log_are_read_and_an_endless_one_is_an_error() {
        let log = "step,error\n0,0.1\n".repeat(10_000);
        let mut read = String::new();
        ShortLines::new(log.as_bytes()).read_to_string(&mut read).unwrap();
        assert_eq!(read, log);
        let mut endless = ShortLines::new(io::repeat(b'q'));
        let error = endless.read_to_end(&mut Vec::new()).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::InvalidData);
    }
}
