//! `message_ages` on a guest's kernel in virtual time, whatever else this machine does:
//!
//! ```text
//! cargo run -p tests --example guest_message_ages -- ARGUMENTS OF message_ages
//! ```
//!
//! Prints its line of JSON. The guest is the one of the tests, which `tests/prepare` makes: Debian 12 and its kernel, with one processor
//! that runs an instruction a nanosecond. For the `mininet` network it starts Open vSwitch first.

#![allow(clippy::print_stdout)]

use std::env;

use tests::{virtual_time, workload_example};

const OPEN_VSWITCH: &str =
    "modprobe openvswitch; /usr/share/openvswitch/scripts/ovs-ctl --system-id=random start";

fn main() {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let needs_a_switch = arguments.iter().any(|argument| argument.contains("mininet"));
    let words = arguments
        .iter()
        .map(|argument| format!("'{}'", argument.replace('\'', r"'\''")));
    let script = format!(
        "modprobe tun\n{}\n./message_ages {} >$RESULT",
        if needs_a_switch { OPEN_VSWITCH } else { "" },
        words.collect::<Vec<_>>().join(" ")
    );
    let mut tell = |line: &str| eprintln!("{line}");
    print!(
        "{}",
        virtual_time::follow(&[&workload_example("message_ages")], &script, &mut tell)
    );
}
