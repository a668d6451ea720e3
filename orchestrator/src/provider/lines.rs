//! From the bytes that a workload's standard output brings, in pieces of any size, to its lines. Pure. The main type is
//! [`Lines`].

use record::progress::Progress;

use super::ProviderError;

/// A line is a few hundred bytes; one that is longer than this was not written by a workload.
const LONGEST_LINE: usize = 64 << 10;

/// Joins pieces and takes them apart into lines.
#[derive(Debug, Default)]
pub struct Lines {
    pending: Vec<u8>,
    taken: usize,
}

impl Lines {
    /// Takes in the next piece.
    pub fn push(&mut self, piece: &[u8]) {
        self.pending.drain(..self.taken);
        self.taken = 0;
        self.pending.extend_from_slice(piece);
    }

    /// The next whole line. What follows the last line break waits for its rest; if the workload was killed in the
    /// middle of a line there is none, and what it wanted to say is not known.
    ///
    /// # Errors
    /// When a line is none that a workload says.
    pub fn next_line(&mut self) -> Result<Option<Progress>, ProviderError> {
        loop {
            let rest = self.pending.get(self.taken..).unwrap_or_default();
            let Some(length) = rest.iter().position(|byte| *byte == b'\n') else {
                return if rest.len() > LONGEST_LINE {
                    Err(not_a_line(rest, "it has no end"))
                } else {
                    Ok(None)
                };
            };
            let line = rest.get(..length).unwrap_or_default();
            let parsed = parse(line);
            self.taken += length + 1;
            if let Some(parsed) = parsed {
                return parsed.map(Some);
            }
        }
    }
}

/// A line's meaning; none if the line is blank.
fn parse(line: &[u8]) -> Option<Result<Progress, ProviderError>> {
    let text = line.trim_ascii();
    (!text.is_empty())
        .then(|| serde_json::from_slice(text).map_err(|error| not_a_line(text, &error.to_string())))
}

fn not_a_line(line: &[u8], reason: &str) -> ProviderError {
    let start = String::from_utf8_lossy(line.get(..80).unwrap_or(line)).into_owned();
    ProviderError::Data {
        what: format!("the workload's line {start:?}"),
        reason: reason.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn all_of(lines: &mut Lines) -> Vec<Progress> {
        std::iter::from_fn(|| lines.next_line().unwrap()).collect()
    }

    proptest! {
        #[test]
        fn lines_are_the_same_however_the_bytes_are_cut(
            pids in prop::collection::vec(any::<u32>(), 0..20),
            cuts in prop::collection::vec(1_usize..40, 1..200),
        ) {
            let said: Vec<_> = pids.iter().map(|pid| Progress::Started { pid: *pid }).collect();
            let mut bytes: &[u8] = &said.iter().fold(Vec::new(), |mut bytes, line| {
                bytes.extend(serde_json::to_vec(line).unwrap());
                bytes.push(b'\n');
                bytes
            });
            let mut lines = Lines::default();
            let mut read = Vec::new();
            for cut in cuts.iter().cycle() {
                if bytes.is_empty() {
                    break;
                }
                let (piece, rest) = bytes.split_at((*cut).min(bytes.len()));
                bytes = rest;
                lines.push(piece);
                read.extend(all_of(&mut lines));
            }
            prop_assert_eq!(read, said);
        }
    }

    #[test]
    fn a_line_without_its_end_is_not_said_yet() {
        let mut lines = Lines::default();
        lines.push(b"{\"event\":\"finished\"}");
        assert_eq!(lines.next_line().unwrap(), None);
        lines.push(b"\n\n  \n");
        assert_eq!(all_of(&mut lines), [Progress::Finished]);
    }

    #[rstest::rstest]
    #[case::text(b"Segmentation fault\n".as_slice())]
    #[case::an_event_of_another_version(b"{\"event\":\"dancing\"}\n")]
    #[case::not_text(b"\xff\xfe\n")]
    fn what_no_workload_says_is_refused_and_quoted(#[case] bytes: &[u8]) {
        let mut lines = Lines::default();
        lines.push(bytes);
        let error = lines.next_line().unwrap_err();
        assert!(matches!(error, ProviderError::Data { .. }), "{error}");
        assert_eq!(lines.next_line().unwrap(), None, "it goes on with the line after");
    }

    #[test]
    fn a_line_that_never_ends_is_refused() {
        let mut lines = Lines::default();
        lines.push(&vec![b'x'; LONGEST_LINE + 1]);
        assert!(lines.next_line().is_err());
    }
}
