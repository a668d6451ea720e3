//! Each target reads what it begins with, and what becomes of that by one wrong byte or a cut, without a fuzzer.

use fuzz::TARGETS;

/// Of a target that begins with more, so many are taken.
const MOST_SEEDS: usize = 16;
/// Of each seed so many bytes are changed, and it is cut in so many places.
const PLACES: usize = 12;

#[test]
fn every_reader_survives_what_others_write_and_what_a_wrong_byte_makes_of_it() {
    for target in TARGETS {
        let seeds = (target.seeds)();
        assert!(!seeds.is_empty(), "{} begins with nothing", target.name);
        // A fuzzer has time for all of them.
        for seed in seeds.iter().step_by(seeds.len().div_ceil(MOST_SEEDS)) {
            (target.read)(seed);
            for place in (0..PLACES).map(|nth| nth * seed.len() / PLACES) {
                (target.read)(&seed[..place]);
                let mut changed = seed.clone();
                changed[place] ^= 0x15;
                (target.read)(&changed);
            }
        }
    }
}
