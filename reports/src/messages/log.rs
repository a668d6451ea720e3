//! The messages that a control log knows of, in its order: each row is a command that was sent, and may be the first
//! that used a state. The main type is [`LoggedMessages`].

use std::fs::File;

use captures::packets::Topic;
use csv::ByteRecord;
use record::{
    run_directory::{Fault, LogError, Place, ReadError},
    settings::Messages,
};
use simulation::message::stamp_in_text;

use super::frames::Label;
use crate::input::short_lines::ShortLines;

/// A message in the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Logged {
    pub label: Label,
    /// As the log counts it.
    pub number: u64,
    /// When the receiver's application had it, on the experiment's clock; only the controller writes that down.
    pub received_ns: Option<i64>,
}

/// One topic's messages of several logs that follow on each other, read as they are asked for.
#[derive(Debug)]
pub(super) struct LoggedMessages {
    topic: Topic,
    messages: Messages,
    logs: std::vec::IntoIter<(Place, u64)>,
    open: Option<OpenLog>,
    last_state: u64,
}

#[derive(Debug)]
struct OpenLog {
    place: Place,
    reader: csv::Reader<ShortLines<File>>,
    record: ByteRecord,
    /// Where the columns are that the topic needs: number, stamp, time of receipt.
    columns: Vec<(&'static str, usize)>,
    line: u64,
}

impl LoggedMessages {
    /// Of these logs, each of at most so many bytes.
    pub fn new(topic: Topic, messages: Messages, logs: Vec<(Place, u64)>) -> Self {
        Self {
            topic,
            messages,
            logs: logs.into_iter(),
            open: None,
            last_state: 0,
        }
    }

    /// The next one.
    ///
    /// # Errors
    /// If a log cannot be read.
    pub fn next(&mut self) -> Result<Option<Logged>, ReadError> {
        loop {
            let open = match &mut self.open {
                Some(open) => open,
                None => match self.logs.next() {
                    Some((log, bytes)) => self.open.insert(OpenLog::new(log, bytes, self.topic)?),
                    None => return Ok(None),
                },
            };
            let Some(numbers) = open.next()? else {
                self.open = None;
                continue;
            };
            let logged = logged(self.topic, self.messages, numbers);
            match self.topic {
                Topic::Command => return Ok(Some(logged)),
                // Number 0 is no state; one that was seen before was used again.
                Topic::State if logged.number == 0 || logged.number == self.last_state => {}
                Topic::State => {
                    self.last_state = logged.number;
                    return Ok(Some(logged));
                }
            }
        }
    }
}

/// The columns of a topic, in the order that [`logged`] takes them.
const fn columns(topic: Topic) -> [&'static str; 3] {
    match topic {
        Topic::State => ["state_seq", "state_stamp_ns", "state_received_ns"],
        Topic::Command => ["step", "actual_ns", "actual_ns"],
    }
}

fn logged(topic: Topic, messages: Messages, [number, stamp_ns, received_ns]: [i64; 3]) -> Logged {
    let (number, received_ns) = match topic {
        Topic::State => (number.unsigned_abs(), Some(received_ns)),
        // Commands count from 1, steps from 0.
        Topic::Command => (number.unsigned_abs() + 1, None),
    };
    let label = match messages {
        Messages::Text => Label {
            seq: 0,
            stamp_ns: stamp_in_text(stamp_ns),
        },
        Messages::Positions | Messages::Rates => Label {
            seq: number,
            stamp_ns,
        },
    };
    Logged {
        label,
        number,
        received_ns,
    }
}

impl OpenLog {
    fn new(place: Place, most_bytes: u64, topic: Topic) -> Result<Self, ReadError> {
        let file = place.open_within(most_bytes).map_err(|source| ReadError::Io {
            path: place.path(),
            source,
        })?;
        let mut reader = csv::ReaderBuilder::new()
            .buffer_capacity(1 << 16)
            .from_reader(ShortLines::new(file));
        let header = reader
            .byte_headers()
            .map_err(|error| unusable(&place, Fault::Csv(error)))?;
        let columns = columns(topic)
            .into_iter()
            .map(|column| {
                let at = header
                    .iter()
                    .position(|name| name.trim_ascii() == column.as_bytes());
                at.map(|at| (column, at))
                    .ok_or_else(|| unusable(&place, Fault::MissingColumn { column }))
            })
            .collect::<Result<_, _>>()?;
        Ok(Self {
            place,
            reader,
            record: ByteRecord::new(),
            columns,
            line: 1,
        })
    }

    /// The three numbers of the next row.
    fn next(&mut self) -> Result<Option<[i64; 3]>, ReadError> {
        let line = self.line + 1;
        let more = self.reader.read_byte_record(&mut self.record).map_err(|error| {
            let fault = match error.kind() {
                csv::ErrorKind::UnequalLengths { .. } => Fault::Cut { line },
                _ => Fault::Csv(error),
            };
            unusable(&self.place, fault)
        })?;
        if !more {
            return Ok(None);
        }
        self.line = line;
        let mut numbers = [0; 3];
        for (number, (column, at)) in numbers.iter_mut().zip(&self.columns) {
            let field = self.record.get(*at).unwrap_or_default();
            let parsed = std::str::from_utf8(field)
                .ok()
                .and_then(|text| text.trim().parse().ok());
            *number = parsed.ok_or_else(|| {
                let fault = Fault::NotANumber {
                    line,
                    column: (*column).to_owned(),
                    text: field.escape_ascii().to_string(),
                };
                unusable(&self.place, fault)
            })?;
        }
        Ok(Some(numbers))
    }
}

fn unusable(log: &Place, fault: Fault) -> ReadError {
    ReadError::Log {
        path: log.path(),
        source: LogError {
            fault,
            changed: false,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(folder: &std::path::Path, name: &str, rows: &str) -> Place {
        let place = Place::root(folder).join(name);
        let header = "step,actual_ns,state_seq,state_stamp_ns,state_received_ns\n";
        std::fs::write(place.path(), format!("{header}{rows}")).unwrap();
        place
    }

    fn all(topic: Topic, logs: Vec<Place>) -> Result<Vec<(u64, i64, Option<i64>)>, ReadError> {
        let logs = logs.into_iter().map(|log| (log, 1 << 20)).collect();
        let mut messages = LoggedMessages::new(topic, Messages::Rates, logs);
        let mut found = Vec::new();
        while let Some(Logged {
            label, received_ns, ..
        }) = messages.next()?
        {
            found.push((label.seq, label.stamp_ns, received_ns));
        }
        Ok(found)
    }

    #[test]
    fn each_state_is_logged_once_and_each_command_once_across_windows() {
        let folder = tempfile::tempdir().unwrap();
        let first = write(
            folder.path(),
            "1",
            "0,100,0,0,0\n1,200,1,90,115\n2,300,1,90,115\n",
        );
        let second = write(folder.path(), "2", "3,400,1,90,115\n4,500,4,370,395\n");
        let paths = vec![first, second];
        assert_eq!(
            all(Topic::State, paths.clone()).unwrap(),
            [(1, 90, Some(115)), (4, 370, Some(395))]
        );
        let commands = [1, 2, 3, 4, 5].map(|seq| (seq, seq as i64 * 100, None));
        assert_eq!(all(Topic::Command, paths).unwrap(), commands);
    }

    #[test]
    fn a_log_that_is_longer_than_what_was_measured_is_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let log = write(folder.path(), "1", "0,100,0,0,0\n");
        let mut messages = LoggedMessages::new(Topic::Command, Messages::Rates, vec![(log, 10)]);
        let told = record::causes::with_causes(&messages.next().unwrap_err());
        assert!(
            told.ends_with("it has 70 bytes, and 10 at most are read"),
            "{told}"
        );
    }

    #[test]
    fn a_cut_log_is_an_error_with_its_line() {
        let folder = tempfile::tempdir().unwrap();
        let cut = write(folder.path(), "1", "0,100,0,0,0\n1,200");
        let error = all(Topic::Command, vec![cut]).unwrap_err();
        let cause = std::error::Error::source(&error).unwrap().to_string();
        assert_eq!(cause, "line 3 is cut short");
    }
}
