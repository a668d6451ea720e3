//! Which packets are captured: an expression of pcap-filter(7), made a program of the kernel's packet filter by tcpdump
//! itself (`tcpdump -ddd`), so that it means what it means there. The main function is [`compile`].
//!
//! libpcap has the only compiler of that language, and the deployed binary is static and does without it.

use std::process::{Command, Stdio};

use super::{error::CaptureError, tcpdump};

/// One instruction, as `struct sock_filter` of `linux/filter.h`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Instruction {
    /// What to do.
    pub code: u16,
    /// How far to jump if so.
    pub jump_if: u8,
    /// How far to jump if not.
    pub jump_if_not: u8,
    /// What with.
    pub operand: u32,
}

/// The program of an expression for Ethernet.
///
/// # Errors
/// If tcpdump is not there, or does not understand the expression.
pub fn compile(expression: &str) -> Result<Vec<Instruction>, CaptureError> {
    let output = Command::new(tcpdump::NAME)
        .args(["-y", "EN10MB", "-ddd", "--", expression])
        .stdin(Stdio::null())
        .output()
        .map_err(tcpdump::not_started)?;
    let refused = |said: &str| CaptureError::Filter {
        expression: expression.to_owned(),
        said: said.trim().trim_start_matches("tcpdump: ").to_owned(),
    };
    if !output.status.success() {
        return Err(refused(&String::from_utf8_lossy(&output.stderr)));
    }
    parse(&String::from_utf8_lossy(&output.stdout)).ok_or_else(|| refused("its answer is no program"))
}

/// The number of instructions, then four numbers for each.
fn parse(text: &str) -> Option<Vec<Instruction>> {
    let mut lines = text.lines();
    let count: usize = lines.next()?.trim().parse().ok()?;
    let instruction = |line: &str| {
        let mut numbers = line.split_whitespace();
        let instruction = Instruction {
            code: numbers.next()?.parse().ok()?,
            jump_if: numbers.next()?.parse().ok()?,
            jump_if_not: numbers.next()?.parse().ok()?,
            operand: numbers.next()?.parse().ok()?,
        };
        numbers.next().is_none().then_some(instruction)
    };
    let program = lines.map(instruction).collect::<Option<Vec<_>>>()?;
    (program.len() == count && count > 0).then_some(program)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_is_read_as_tcpdump_prints_it() {
        // `tcpdump -y EN10MB -ddd arp`, 4.99.3.
        let program = parse("4\n40 0 0 12\n21 0 1 2054\n6 0 0 262144\n6 0 0 0\n").unwrap();
        assert_eq!(program.len(), 4);
        let second = Instruction {
            code: 21,
            jump_if: 0,
            jump_if_not: 1,
            operand: 2054,
        };
        assert_eq!(program.get(1), Some(&second));
    }

    #[rstest::rstest]
    #[case::empty("")]
    #[case::no_instructions("0\n")]
    #[case::one_too_few("2\n6 0 0 0\n")]
    #[case::five_numbers("1\n6 0 0 0 0\n")]
    #[case::text("1\nld 0 0 0\n")]
    fn what_is_no_program_is_refused(#[case] text: &str) {
        assert_eq!(parse(text), None);
    }
}
