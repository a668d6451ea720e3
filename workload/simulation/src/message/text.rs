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
    out.push(b'[');
    for value in [x.position_m, y.position_m, x.angle_rad, y.angle_rad] {
        write_decimals::<4>(out, value);
        out.push(b' ');
    }
    write_decimals::<6>(out, seconds(state.stamp_ns));
    out.push(b']');
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
    out.extend(b"/u?&value0=");
    write_decimals::<4>(out, x_v);
    out.extend(b"&value1=");
    write_decimals::<4>(out, y_v);
    out.extend(b"&time=");
    write_decimals::<6>(out, seconds(command.stamp_ns));
    out.extend(b"&access=8783392&]");
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

/// Appends a number as `{:.DECIMALS}` writes it. That computes exactly, which takes a third of a simulated step's time, and is needed
/// only near the middle of two of them.
fn write_decimals<const DECIMALS: u8>(out: &mut Vec<u8>, value: f64) {
    // Below this, the product is off by less than a thousandth.
    const MOST: f64 = 1e12;
    let scaled = value.abs() * 10_f64.powi(i32::from(DECIMALS));
    let part = scaled.fract();
    if scaled.is_nan() || scaled >= MOST || (part - 0.5).abs() < 0.001 {
        // Writing to memory cannot fail.
        let _ = write!(out, "{value:.*}", usize::from(DECIMALS));
        return;
    }
    if value.is_sign_negative() {
        out.push(b'-');
    }
    let begins = out.len();
    let mut rest = scaled as u64 + u64::from(part > 0.5);
    let mut digits = 0;
    while rest > 0 || digits <= DECIMALS {
        if digits == DECIMALS {
            out.push(b'.');
        }
        out.push(b'0' + (rest % 10) as u8);
        rest /= 10;
        digits += 1;
    }
    if let Some(written) = out.get_mut(begins..) {
        written.reverse();
    }
}

fn number(text: &str) -> Option<f64> {
    text.parse().ok().filter(|number: &f64| number.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case::zero(0.0)]
    #[case::negative_zero(-0.0)]
    #[case::rounds_to_negative_zero(-0.00004)]
    #[case::half_way(0.00005)]
    #[case::half_way_exactly(0.03125)]
    #[case::carries(0.99996)]
    #[case::carries_to_ten(9.99999)]
    #[case::large(1e11)]
    #[case::larger(1e300)]
    #[case::infinite(f64::NEG_INFINITY)]
    #[case::none(f64::NAN)]
    fn a_number_is_written_as_the_library_does(#[case] value: f64) {
        assert_eq!(written(value), [format!("{value:.4}"), format!("{value:.6}")]);
    }

    fn written(value: f64) -> [String; 2] {
        let mut texts = [Vec::new(), Vec::new()];
        write_decimals::<4>(&mut texts[0], value);
        write_decimals::<6>(&mut texts[1], value);
        texts.map(|text| String::from_utf8(text).unwrap())
    }

    proptest::proptest! {
        #[test]
        fn any_number_is_written_as_the_library_does(value in proptest::num::f64::ANY, small in -20.0..20.0_f64, ten_thousandths in -300_000..300_000_i32) {
            // The third is near the middle of two.
            for value in [value, small, (f64::from(ten_thousandths) + 0.5) / 1e4] {
                proptest::prop_assert_eq!(written(value), [format!("{value:.4}"), format!("{value:.6}")]);
            }
        }
    }

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
