//! The two texts of the author's public code, as both of its programs write and read them (docs/paper.md).
//!
//! ```text
//! plant_state      [x y θx θy t]
//! control_action   /u?&value0=X&value1=Y&time=T&access=8783392&]
//! ```
//!
//! Positions in metres, shaft angles in radians and voltages have four decimals, times in seconds six. `t` is the time of the
//! command that the state answers. The number behind `access` is in each of the author's commands, and nothing reads it.

use std::io::Write as _;

use super::{CommandMessage, StateMessage, nanoseconds, seconds};
use crate::plant::AxisState;

/// Room for either text with any numbers that a loop which has not diverged can have.
pub const MOST_BYTES: usize = 512;

/// Appends the state.
pub fn write_state(out: &mut Vec<u8>, state: &StateMessage) {
    let [x, y] = state.axes;
    // Writing to memory cannot fail.
    let _ = write!(
        out,
        "[{:.4} {:.4} {:.4} {:.4} {:.6}]",
        x.position_m,
        y.position_m,
        x.angle_rad,
        y.angle_rad,
        seconds(state.stamp_ns)
    );
}

/// The state in the first pair of brackets; none if its five numbers are not there.
pub fn read_state(text: &str) -> Option<StateMessage> {
    let (_, text) = text.split_once('[')?;
    let (text, _) = text.split_once(']')?;
    let mut numbers = text.split_ascii_whitespace().map(number);
    let mut next = || numbers.next().flatten();
    let (x_m, y_m, x_angle, y_angle, stamp_s) = (next()?, next()?, next()?, next()?, next()?);
    let axis = |position_m, angle_rad| AxisState {
        position_m,
        angle_rad,
        ..AxisState::default()
    };
    Some(StateMessage {
        seq: 0,
        stamp_ns: nanoseconds(stamp_s),
        axes: [axis(x_m, x_angle), axis(y_m, y_angle)],
    })
}

/// Appends the command.
pub fn write_command(out: &mut Vec<u8>, command: &CommandMessage) {
    let [x_v, y_v] = command.voltage_v;
    let _ = write!(
        out,
        "/u?&value0={x_v:.4}&value1={y_v:.4}&time={:.6}&access=8783392&]",
        seconds(command.stamp_ns)
    );
}

/// The last command that a bracket ends, by the places of its values and not by their names, as the author's plant reads it;
/// none if it is another kind of request.
pub fn read_command(text: &str) -> Option<CommandMessage> {
    let (whole, _) = text.rsplit_once(']')?;
    let last = whole.rsplit(']').next()?;
    let (path, query) = last.split_once('?')?;
    if path.rsplit('/').next() != Some("u") {
        return None;
    }
    let mut values = query
        .split('&')
        .skip(1)
        .map(|field| number(field.split_once('=')?.1));
    let mut next = || values.next().flatten();
    let (x_v, y_v, stamp_s) = (next()?, next()?, next()?);
    Some(CommandMessage {
        seq: 0,
        stamp_ns: nanoseconds(stamp_s),
        voltage_v: [x_v, y_v],
    })
}

/// A stamp as a text carries it: to the microsecond.
#[must_use]
pub fn stamp_in_text(stamp_ns: i64) -> i64 {
    format!("{:.6}", seconds(stamp_ns))
        .parse()
        .map_or(stamp_ns, nanoseconds)
}

fn number(text: &str) -> Option<f64> {
    text.parse().ok().filter(|number: &f64| number.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_several_commands_the_last_whole_one_counts() {
        let text = "/u?&value0=1&value1=2&time=3&]/u?&value0=4&value1=5&time=6&access=1&]/u?&value0=7";
        let command = read_command(text).unwrap();
        assert_eq!((command.voltage_v, command.stamp_ns), ([4.0, 5.0], 6_000_000_000));
    }

    #[rstest::rstest]
    #[case::the_authors_start("/init?&time=0&]")]
    #[case::unfinished("/u?&value0=1.0&value1=2.0&time=0.1")]
    #[case::too_few("/u?&value0=1.0&time=0.1&]")]
    #[case::no_numbers("/u?&value0=one&value1=2.0&time=0.1&]")]
    #[case::nothing("")]
    fn what_is_no_command_is_none(#[case] text: &str) {
        assert_eq!(read_command(text), None);
    }

    #[rstest::rstest]
    #[case::the_answer_to_the_authors_start("[ ]")]
    #[case::four_numbers("[1 2 3 4]")]
    #[case::no_brackets("1 2 3 4 5")]
    fn what_is_no_state_is_none(#[case] text: &str) {
        assert_eq!(read_state(text), None);
    }
}
