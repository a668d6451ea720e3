//! `plant.csv`: one row a tick of the plant, on `sta2`: where the ball truly was. The main type is [`PlantRow`].
//!
//! Columns and times are as in `control.csv` ([`super::control_log`]), on the same clock.

use std::io::Write;

use serde::{Deserialize, Serialize};

/// One tick of the plant.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct PlantRow {
    /// Counts the ticks of the run, from 0, across windows. Numbers that are missing are ticks that were lost.
    pub step: u64,
    /// When the tick was due; where ticks before it were lost, when the first of them was due.
    pub scheduled_ns: i64,
    /// When it began.
    pub actual_ns: i64,
    /// Ball position from this tick on, x.
    pub x_m: f64,
    /// Ball position from this tick on, y.
    pub y_m: f64,
    /// Motor shaft angle from this tick on, x axis.
    pub angle_x_rad: f64,
    /// Motor shaft angle from this tick on, y axis.
    pub angle_y_rad: f64,
    /// The controller's stamp on the command that was in force at this tick.
    pub command_stamp_ns: i64,
    /// That command, x axis; zero before the first has arrived.
    pub command_x_v: f64,
    /// That command, y axis.
    pub command_y_v: f64,
}

impl PlantRow {
    /// The columns, in the order they are written: the first line of the file.
    pub const HEADER: &'static str = "step,scheduled_ns,actual_ns,x_m,y_m,angle_x_rad,angle_y_rad,command_stamp_ns,\
        command_x_v,command_y_v";

    /// Writes the row as one line. Floats are written so that they read back to the same bits.
    ///
    /// # Errors
    /// What the writer says.
    pub fn write_to(&self, out: &mut impl Write) -> std::io::Result<()> {
        writeln!(
            out,
            "{},{},{},{:?},{:?},{:?},{:?},{},{:?},{:?}",
            self.step,
            self.scheduled_ns,
            self.actual_ns,
            self.x_m,
            self.y_m,
            self.angle_x_rad,
            self.angle_y_rad,
            self.command_stamp_ns,
            self.command_x_v,
            self.command_y_v,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_has_as_many_fields_as_the_header() {
        let mut line = Vec::new();
        PlantRow::default().write_to(&mut line).unwrap();
        let line = String::from_utf8(line).unwrap();
        assert_eq!(line.split(',').count(), PlantRow::HEADER.split(',').count());
    }
}
