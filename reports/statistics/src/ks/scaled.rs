//! Numbers from 0 to 1 that do not underflow: a double and a count of factors 2⁻²⁵⁶. The main types are [`Share`],
//! which the recursion of [`super::paths`] is written in, and [`Scaled`].

/// A number from 0 to 1 that the recursion can mix.
pub(super) trait Share: Copy {
    const NONE: Self;
    const ALL: Self;

    /// `(i · a + j · b) / k`, for i + j = k: the mean over the two ways to arrive.
    fn mean(i: f64, a: Self, j: f64, b: Self, k: f64) -> Self;
}

impl Share for f64 {
    const NONE: Self = 0.0;
    const ALL: Self = 1.0;

    #[inline]
    fn mean(i: f64, a: Self, j: f64, b: Self, k: f64) -> Self {
        (i * a + j * b) / k
    }
}

/// 2⁻²⁵⁶.
const BLOCK: f64 = f64::from_bits((1023 - 256) << 52);
/// 2²⁵⁶.
const PER_BLOCK: f64 = f64::from_bits((1023 + 256) << 52);

/// `mantissa · 2^(-256 · blocks)`; the mantissa is 0 or from 2⁻²⁵⁶ to 1.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scaled {
    mantissa: f64,
    blocks: u32,
}

impl Scaled {
    pub(super) fn log10(self) -> f64 {
        self.mantissa.log10() - 256.0 * f64::from(self.blocks) * std::f64::consts::LOG10_2
    }

    pub(super) fn to_f64(self) -> f64 {
        match self.blocks {
            0 => self.mantissa,
            // Up to 2⁻¹⁰⁷⁴ may still be a double.
            1..=4 => (0..self.blocks).fold(self.mantissa, |value, _| value * BLOCK),
            _ => 0.0,
        }
    }
}

impl Share for Scaled {
    const NONE: Self = Self {
        mantissa: 0.0,
        blocks: u32::MAX,
    };
    const ALL: Self = Self {
        mantissa: 1.0,
        blocks: 0,
    };

    #[inline]
    fn mean(i: f64, a: Self, j: f64, b: Self, k: f64) -> Self {
        let blocks = a.blocks.min(b.blocks);
        // A number two blocks down is below 2⁻²⁵⁶ of the other: nothing of it is left in the sum.
        let aligned = |number: Self| match number.blocks - blocks {
            0 => number.mantissa,
            1 => number.mantissa * BLOCK,
            _ => 0.0,
        };
        let mantissa = (i * aligned(a) + j * aligned(b)) / k;
        if mantissa >= BLOCK {
            Self { mantissa, blocks }
        } else if mantissa > 0.0 {
            Self {
                mantissa: mantissa * PER_BLOCK,
                blocks: blocks + 1,
            }
        } else {
            Self::NONE
        }
    }
}
