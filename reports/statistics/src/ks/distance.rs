//! How far two samples lie apart, in whole units of 1 / lcm(n, m): counting, and nothing else. The main type is
//! [`Farthest`].

use std::ops::{Add, Mul, Sub};

/// By how much one value of each sample moves the distance, in units of 1 / lcm.
#[derive(Debug, Clone, Copy)]
pub(super) struct Steps {
    pub(super) of_x: u64,
    pub(super) of_y: u64,
}

impl Steps {
    pub(super) fn of(n: u64, m: u64) -> Self {
        if n == m {
            return Self { of_x: 1, of_y: 1 };
        }
        let (mut divisor, mut rest) = (n, m);
        while rest != 0 {
            (divisor, rest) = (rest, divisor % rest);
        }
        Self {
            of_x: m / divisor,
            of_y: n / divisor,
        }
    }
}

/// Where two distribution functions are farthest apart, to both sides.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Farthest {
    /// How far the first's comes to lie above the second's.
    pub(super) above: u64,
    /// How many of the first's values there are up to where that is first reached; 0 if it never lies above.
    pub(super) above_after: usize,
    /// How far it comes to lie below.
    pub(super) below: u64,
    /// How many of the second's values there are up to where that is first reached; 0 if it never lies below.
    pub(super) below_after: usize,
    /// Whether a value is in both samples.
    pub(super) has_shared: bool,
}

impl Farthest {
    /// Of a sample of n values, of which `counts[r]` have a rank below r, and one of the ranks `second`, ascending.
    pub(super) fn of(n: usize, counts: &[u32], second: &[u32], steps: Steps) -> Self {
        // A distance and its place go into one number, distance × places − place: the larger distance is the larger
        // number, and of equal ones the first. No branch is to be foreseen, which would take longer than all else.
        let places = n.max(second.len()) as u64 + 1;
        let largest = (steps.of_x * n as u64).checked_mul(places).map(i64::try_from);
        if matches!(largest, Some(Ok(_))) {
            Self::in_numbers::<i64>(places as i64, counts, second, steps)
        } else {
            Self::in_numbers::<i128>(places.into(), counts, second, steps)
        }
    }

    fn in_numbers<T>(places: T, counts: &[u32], second: &[u32], steps: Steps) -> Self
    where
        T: Copy + Ord + From<u32> + Add<Output = T> + Sub<Output = T> + Mul<Output = T> + Into<i128>,
    {
        let (zero, one) = (T::from(0), T::from(1));
        // Steps are at most n and m, which are ranks.
        let of_x = T::from(steps.of_x as u32) * places;
        let of_y = T::from(steps.of_y as u32) * places;
        let (mut above, mut below, mut shared) = (zero, zero, 0);
        let (mut y, mut after) = (zero, zero);
        for rank in second {
            let rank = *rank as usize;
            let (less, up_to) = (counts[rank], counts[rank + 1]);
            // The first's rises at its values: it is farthest above right before one of the second's, and reaches
            // that at the last of its own before; and it is farthest below at one of the second's.
            above = above.max(T::from(less) * (of_x - one) - y);
            (y, after) = (y + of_y, after + one);
            below = below.max(y - after - T::from(up_to) * of_x);
            shared |= less ^ up_to;
        }
        let (above, above_after) = parted(above.into(), places.into());
        let (below, below_after) = parted(below.into(), places.into());
        Self {
            above,
            above_after,
            below,
            below_after,
            has_shared: shared != 0,
        }
    }
}

/// The distance and the place of distance × places − place.
fn parted(number: i128, places: i128) -> (u64, usize) {
    let distance = (number + places - 1) / places;
    (distance as u64, (distance * places - number) as usize)
}
