//! Each target reads what it begins with, and what becomes of that by one wrong byte or a cut, without a fuzzer.

use std::{
    num::NonZero,
    sync::atomic::{AtomicUsize, Ordering},
    thread,
};

use fuzz::{TARGETS, Target};

/// Of a target that begins with more, so many are taken.
const MOST_SEEDS: usize = 16;
/// Of each seed so many bytes are changed, and it is cut in so many places: a read may be a whole report, and a fuzzer takes more.
const PLACES: usize = 6;

fn read(target: &Target, seed: &[u8]) {
    (target.read)(seed);
    for place in (0..PLACES).map(|nth| nth * seed.len() / PLACES) {
        (target.read)(&seed[..place]);
        let mut changed = seed.to_vec();
        changed[place] ^= 0x15;
        (target.read)(&changed);
    }
}

#[test]
fn every_reader_survives_what_others_write_and_what_a_wrong_byte_makes_of_it() {
    let mut seeds = Vec::new();
    for target in &TARGETS {
        let of_it = (target.seeds)();
        assert!(!of_it.is_empty(), "{} begins with nothing", target.name);
        // A fuzzer has time for all of them.
        let step = of_it.len().div_ceil(MOST_SEEDS);
        seeds.extend(of_it.into_iter().step_by(step).map(|seed| (target, seed)));
    }
    let next = AtomicUsize::new(0);
    let take = || seeds.get(next.fetch_add(1, Ordering::Relaxed));
    // A panic in any of the threads is one of the test.
    thread::scope(|scope| {
        for _ in 0..thread::available_parallelism().map_or(1, NonZero::get) {
            scope.spawn(|| {
                while let Some((target, seed)) = take() {
                    read(target, seed);
                }
            });
        }
    });
}
