//! How the kernel's clock is steered: adjtimex(2), which only reads here. The main function is [`read`].

// adjtimex(2) has no safe interface in nix.
#![allow(unsafe_code)]
// The fields are 32 bits wide on some architectures.
#![allow(clippy::unnecessary_cast)]

use std::mem::MaybeUninit;

use record::platform::ClockRecord;

/// The state of the clock's discipline; none where it may not be asked for.
pub fn read() -> Option<ClockRecord> {
    // SAFETY: a timex of zeros is a valid one; its modes are 0, so that the kernel changes nothing.
    let (state, clock) = unsafe {
        let mut clock: libc::timex = MaybeUninit::zeroed().assume_init();
        let state = libc::adjtimex(&raw mut clock);
        (state, clock)
    };
    (state >= 0).then(|| {
        let to_ns = if clock.status & libc::STA_NANO == 0 {
            1000
        } else {
            1
        };
        ClockRecord {
            synchronised: state != libc::TIME_ERROR && clock.status & libc::STA_UNSYNC == 0,
            status: clock.status,
            offset_ns: clock.offset as i64 * to_ns,
            // In units of 2^-16 ppm.
            frequency_ppm: clock.freq as f64 / 65_536.0,
            max_error_us: clock.maxerror as i64,
        }
    })
}
