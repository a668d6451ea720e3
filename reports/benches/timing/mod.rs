//! How long something takes, and the middle of several such times.

use std::{
    hint::black_box,
    time::{Duration, Instant},
};

pub fn time<T>(work: impl FnOnce() -> T) -> Duration {
    let begun = Instant::now();
    black_box(work());
    begun.elapsed()
}

pub fn median(mut times: Vec<Duration>) -> Duration {
    times.sort();
    times[times.len() / 2]
}
