//! `control.csv`: one row a control step, written by the controller on `sta1`. The main type is [`ControlRow`].
//!
//! The first line names the columns, units in the names. Times are nanoseconds on the experiment's clock: the
//! monotonic clock, zero at the first control step of the run, so that they go on from one window to the next.
//! Positions are metres, angles radians (of the motor shaft, 16 × the plate's), commands volts.

use std::io::Write;

use serde::{Deserialize, Serialize};

/// One control step. Of the state, `seq` is 0 and the rest zero until the first message has arrived.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct ControlRow {
    /// Counts the control steps of the run, from 0, across windows.
    pub step: u64,
    /// When the step was due.
    pub scheduled_ns: i64,
    /// When it began.
    pub actual_ns: i64,
    /// When the command had been handed to the socket.
    pub done_ns: i64,
    /// The wanted position, x.
    pub reference_x_m: f64,
    /// The wanted position, y.
    pub reference_y_m: f64,
    /// The plant's number for the state that this step used; a number seen before means nothing newer had arrived.
    pub state_seq: u64,
    /// The plant's own stamp on that state.
    pub state_stamp_ns: i64,
    /// When that state had been received.
    pub state_received_ns: i64,
    /// Ball position, x.
    pub x_m: f64,
    /// Ball speed, x.
    pub x_rate_m_s: f64,
    /// Motor shaft angle, x axis.
    pub angle_x_rad: f64,
    /// Its rate.
    pub angle_x_rate_rad_s: f64,
    /// Ball position, y.
    pub y_m: f64,
    /// Ball speed, y.
    pub y_rate_m_s: f64,
    /// Motor shaft angle, y axis.
    pub angle_y_rad: f64,
    /// Its rate.
    pub angle_y_rate_rad_s: f64,
    /// The command, x axis.
    pub command_x_v: f64,
    /// The command, y axis.
    pub command_y_v: f64,
}

impl ControlRow {
    /// The columns, in the order they are written: the first line of the file.
    pub const HEADER: &'static str = "step,scheduled_ns,actual_ns,done_ns,reference_x_m,reference_y_m,state_seq,\
        state_stamp_ns,state_received_ns,x_m,x_rate_m_s,angle_x_rad,angle_x_rate_rad_s,y_m,y_rate_m_s,angle_y_rad,\
        angle_y_rate_rad_s,command_x_v,command_y_v";

    /// Writes the row as one line. Floats are written so that they read back to the same bits.
    ///
    /// # Errors
    /// What the writer says.
    pub fn write_to(&self, out: &mut impl Write) -> std::io::Result<()> {
        writeln!(
            out,
            "{},{},{},{},{:?},{:?},{},{},{},{:?},{:?},{:?},{:?},{:?},{:?},{:?},{:?},{:?},{:?}",
            self.step,
            self.scheduled_ns,
            self.actual_ns,
            self.done_ns,
            self.reference_x_m,
            self.reference_y_m,
            self.state_seq,
            self.state_stamp_ns,
            self.state_received_ns,
            self.x_m,
            self.x_rate_m_s,
            self.angle_x_rad,
            self.angle_x_rate_rad_s,
            self.y_m,
            self.y_rate_m_s,
            self.angle_y_rad,
            self.angle_y_rate_rad_s,
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
        ControlRow {
            x_m: 0.1 + 0.2,
            ..ControlRow::default()
        }
        .write_to(&mut line)
        .unwrap();
        let line = String::from_utf8(line).unwrap();
        assert_eq!(line.split(',').count(), ControlRow::HEADER.split(',').count());
        assert!(line.contains("0.30000000000000004"));
    }
}
