//! The colour of each scenario, the same wherever a report draws it. The function is [`of`].

use crate::analysis::report::Report;

/// Red, green and blue, told apart without colour vision too (Okabe and Ito, *Color Universal Design*, 2008), without their black,
/// which is for letters and marks, and their yellow, which is not seen on white. `style.css` has them as `.s0` to `.s5`.
pub(crate) const COLOURS: [(u8, u8, u8); 6] = [
    (0, 114, 178),
    (213, 94, 0),
    (0, 158, 115),
    (204, 121, 167),
    (86, 180, 233),
    (230, 159, 0),
];

/// The number of a scenario's colour, by its letter. Of more scenarios than there are colours the next ones begin again.
pub(crate) fn of(report: &Report, scenario: &str) -> usize {
    let place = report.scenarios.iter().position(|other| other.id == scenario);
    place.unwrap_or_default() % COLOURS.len()
}

/// Those of two scenarios that are drawn together. Where both have the same, the second has the next one.
pub(crate) fn of_two(report: &Report, scenarios: [&str; 2]) -> [usize; 2] {
    match scenarios.map(|scenario| of(report, scenario)) {
        [first, second] if first == second => [first, (second + 1) % COLOURS.len()],
        different => different,
    }
}
