//! `plant.csv` of one window: where the ball truly was, and when. The main type is [`PlantTrace`].

use std::io::Read;

use super::{
    Place,
    lines::Lines,
    log::{Fault, Header, LogError, read_log},
};
use crate::window::FileRecord;

/// Where the ball was from each tick of the plant on.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PlantTrace {
    ticks: Vec<Tick>,
}

#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Tick {
    actual_ns: i64,
    /// (x, y), in metres.
    position_m: (f64, f64),
}

impl PlantTrace {
    /// Reads a log.
    ///
    /// # Errors
    /// When it cannot be read, has no tick or has a field that is wrong.
    pub fn read(place: &Place, file: &FileRecord) -> Result<Self, LogError> {
        read_log(place, file, |log| parse(log))
    }

    /// Its positions, to be asked for in the order of time.
    pub(super) fn in_time(&self) -> InTime<'_> {
        let (now, later) = match self.ticks.split_first() {
            Some((first, later)) => (*first, later),
            None => (Tick::default(), [].as_slice()),
        };
        InTime { now, later }
    }
}

/// The trace, and how many lines the log has.
fn parse(log: impl Read) -> Result<(PlantTrace, u64), Fault> {
    let mut lines = Lines::of(log);
    let header = Header::of(lines.next().map_err(Fault::unreadable)?.unwrap_or_default());
    let [actual_ns, x_m, y_m] = [
        header.find("actual_ns")?,
        header.find("x_m")?,
        header.find("y_m")?,
    ];
    let mut trace = PlantTrace::default();
    let mut line = 1;
    while let Some(record) = lines.next().map_err(Fault::unreadable)? {
        line += 1;
        if record.len() != header.len() {
            return Err(Fault::Cut { line });
        }
        trace.ticks.push(Tick {
            actual_ns: header.number(record, line, actual_ns)?,
            position_m: header.position(record, line, x_m, y_m)?,
        });
    }
    if trace.ticks.is_empty() {
        return Err(Fault::NoTick);
    }
    Ok((trace, line))
}

/// Goes through the ticks as time goes on.
pub(super) struct InTime<'a> {
    now: Tick,
    later: &'a [Tick],
}

impl InTime<'_> {
    /// Where the ball was then, in metres: at the last tick that was not later, or at the first of the log before that.
    pub(super) fn at(&mut self, time_ns: i64) -> (f64, f64) {
        while let [next, later @ ..] = self.later
            && next.actual_ns <= time_ns
        {
            self.now = *next;
            self.later = later;
        }
        self.now.position_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_position_holds_until_the_next_tick_and_the_first_one_before_it_too() {
        let log = "actual_ns,y_m,x_m\n100,0.5,1\n200,0.25,2\n300,0,3\n";
        let (trace, lines) = parse(log.as_bytes()).unwrap();
        assert_eq!(lines, 4);
        let mut positions = trace.in_time();
        let found = [50, 100, 199, 200, 450].map(|time_ns| positions.at(time_ns));
        assert_eq!(
            found,
            [(1.0, 0.5), (1.0, 0.5), (1.0, 0.5), (2.0, 0.25), (3.0, 0.0)]
        );
    }

    #[rstest::rstest]
    #[case("actual_ns,x_m\n1,1\n", "column `y_m` is missing")]
    #[case("actual_ns,x_m,y_m\n", "no tick")]
    #[case("actual_ns,x_m,y_m\n1,1\n", "line 2 is cut short")]
    #[case("actual_ns,x_m,y_m\n1,inf,1\n", "`inf` in column `x_m`")]
    #[case("actual_ns,x_m,y_m\n1.5,1,1\n", "`1.5` in column `actual_ns`")]
    fn what_is_no_log_of_a_plant_is_an_error(#[case] log: &str, #[case] words: &str) {
        let said = parse(log.as_bytes()).unwrap_err().to_string();
        assert!(said.contains(words), "{said}");
    }
}
