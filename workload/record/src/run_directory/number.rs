//! Numbers as a log spells them. The main trait is [`Number`].
//!
//! A log of 6000 s has 2.4 million that are needed, and most of the time that reading it takes beside its checksum is in
//! here. So the two forms that nearly all have are read eight digits at a time: whole numbers, and decimals with one digit
//! before the point. All others are left to what reads any.

/// What a column can hold.
pub(super) trait Number: Sized {
    /// The number that a field spells; none if it spells anything else.
    fn read(field: &[u8]) -> Option<Self>;
}

impl Number for f64 {
    /// To the nearest double, as the standard library's.
    #[inline]
    fn read(field: &[u8]) -> Option<Self> {
        plain_decimal(field).or_else(|| fast_float2::parse(field).ok())
    }
}

impl Number for u64 {
    #[inline]
    fn read(field: &[u8]) -> Option<Self> {
        let (eights, rest) = field.as_chunks::<8>();
        // With more than 19 digits it may be too large.
        if field.len() > 19 {
            return digit_by_digit(field);
        }
        let mut number = 0;
        for digits in eights {
            number = number * 100_000_000 + eight_digits(word(*digits))?;
        }
        match (field.last_chunk(), rest) {
            (Some(_), []) => Some(number),
            (Some(last), rest) => {
                // Of the last eight those that were not taken yet, and zeros before them.
                let others = 8 * (8 - rest.len() as u32);
                let digits = word(*last) >> others << others;
                Some(number * TENS.get(rest.len())? + eight_digits(digits)?)
            }
            (None, _) => few_digits(field),
        }
    }
}

impl Number for i64 {
    #[inline]
    fn read(field: &[u8]) -> Option<Self> {
        match field.strip_prefix(b"-") {
            Some(digits) => 0_i64.checked_sub_unsigned(u64::read(digits)?),
            None => u64::read(field)?.try_into().ok(),
        }
    }
}

/// Of 10, from 0.
const TENS: [u64; 19] = {
    let mut powers = [1; 19];
    let mut at = 1;
    while at < powers.len() {
        powers[at] = powers[at - 1] * 10;
        at += 1;
    }
    powers
};

/// Of less than eight digits.
#[inline]
fn few_digits(field: &[u8]) -> Option<u64> {
    let (Some(first), Some(last)) = (field.first_chunk(), field.last_chunk()) else {
        return digit_by_digit(field);
    };
    // The first four and the last four, which may be some of the first, moved up until zeros are before them.
    let [first, last] = [first, last].map(|four: &[u8; 4]| u64::from(u32::from_le_bytes(*four)));
    let others = 8 * (8 - field.len() as u32);
    let digits = (first | last << (32 - others)) ^ (word([0; 8]) >> others);
    eight_digits(digits << others)
}

fn digit_by_digit(field: &[u8]) -> Option<u64> {
    let add = |number: u64, digit: &u8| {
        let digit = digit.checked_sub(b'0').filter(|digit| *digit < 10)?;
        number.checked_mul(10)?.checked_add(digit.into())
    };
    let mut digits = field.iter();
    let first = add(0, digits.next()?)?;
    digits.try_fold(first, add)
}

/// Eight digits, the first in the lowest byte, less the code of `0`.
fn word(digits: [u8; 8]) -> u64 {
    u64::from_le_bytes(digits) ^ 0x3030_3030_3030_3030
}

/// The number that a word of digits spells. Neighbours are added up in pairs, then pairs and fours of them, all in one word
/// (Lemire, *Quickly parsing eight digits*, 2018).
fn eight_digits(digits: u64) -> Option<u64> {
    // What is no digit has a high half now, or gets one by adding 6.
    if (digits | digits.wrapping_add(0x0606_0606_0606_0606)) & 0xF0F0_F0F0_F0F0_F0F0 != 0 {
        return None;
    }
    let pairs = digits.wrapping_mul(10).wrapping_add(digits >> 8) & 0x00FF_00FF_00FF_00FF;
    let fours = pairs.wrapping_mul(100).wrapping_add(pairs >> 16) & 0x0000_FFFF_0000_FFFF;
    Some(fours.wrapping_mul(10_000).wrapping_add(fours >> 32) & 0xFFFF_FFFF)
}

/// The number that the digits behind the point spell. Nearly all have 16 to 18, at random: no branch could be guessed.
#[inline]
fn places_of(fraction: &[u8]) -> Option<u64> {
    let ([first, second], Some(last), 16..=18) =
        (fraction.as_chunks().0, fraction.last_chunk(), fraction.len())
    else {
        return u64::read(fraction);
    };
    let rest = fraction.len() - 16;
    let others = 8 * (8 - rest as u32);
    let digits = word(*last).checked_shr(others).unwrap_or(0) << (others & 63);
    let sixteen = eight_digits(word(*first))? * 100_000_000 + eight_digits(word(*second))?;
    Some(sixteen * TENS.get(rest)? + eight_digits(digits)?)
}

/// A divisor 5^q: its bits b, and ⌊2^(63 + b) / 5^q⌋, which has 64 bits.
#[derive(Clone, Copy)]
struct Reciprocal {
    bits: u32,
    of: u64,
}

const RECIPROCALS: [Reciprocal; 19] = {
    let mut all = [Reciprocal {
        bits: 1,
        of: u64::MAX,
    }; 19];
    let (mut at, mut power) = (1, 5_u128);
    while at < all.len() {
        let bits = u128::BITS - power.leading_zeros();
        all[at] = Reciprocal {
            bits,
            of: ((1_u128 << (63 + bits)) / power) as u64,
        };
        power *= 5;
        at += 1;
    }
    all
};

/// `-0.12345678` and the like: one digit before the point and 8 to 18 behind it, which make a whole number w of 64 bits. None
/// of any other form, and none where the nearest double is not known for certain from 64 bits of the quotient w / 10^q: one
/// in five hundred.
fn plain_decimal(field: &[u8]) -> Option<f64> {
    let (sign, digits) = match field {
        [b'-', digits @ ..] => (-1.0, digits),
        digits => (1.0, digits),
    };
    let [whole @ b'0'..=b'9', b'.', fraction @ ..] = digits else {
        return None;
    };
    let places = fraction.len();
    let reciprocal = RECIPROCALS.get(places).filter(|_| places >= 8)?;
    let number = u64::from(whole - b'0') * TENS.get(places)? + places_of(fraction)?;
    if number == 0 {
        return Some(sign * 0.0);
    }
    // V = w' 2^(b − 1) / 5^q, of w shifted until its first bit is set; 62 to 64 bits before its point. Since the reciprocal is
    // too small by less than 1, V is in [quotient, quotient + 2).
    let zeros = number.leading_zeros();
    let product = u128::from(number << zeros) * u128::from(reciprocal.of);
    let quotient = (product >> 64) as u64;
    let spare = 10 + (quotient >> 63) as u32;
    let (kept, rest, half) = (
        quotient >> spare,
        quotient & ((1 << spare) - 1),
        1_u64 << (spare - 1),
    );
    if rest == half || rest == half - 1 {
        return None;
    }
    let significand = kept + u64::from(rest > half);
    let exponent = i64::from(spare) - i64::from(reciprocal.bits - 1) - i64::from(zeros) - places as i64;
    let power = f64::from_bits(((1023 + exponent) as u64) << 52);
    Some(sign * significand as f64 * power)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]

        #[test]
        fn a_decimal_is_the_double_that_the_standard_library_reads(
            text in "-?[0-9]\\.(0{0,9})[0-9]{1,18}(e-?[0-9]{1,2})?"
        ) {
            let expected: f64 = text.parse().unwrap();
            prop_assert_eq!(f64::read(text.as_bytes()).map(f64::to_bits), Some(expected.to_bits()));
        }

        #[test]
        fn a_double_is_read_as_it_was_written(number in -10.0..10.0) {
            let number: f64 = number;
            prop_assert_eq!(f64::read(format!("{number:?}").as_bytes()).map(f64::to_bits), Some(number.to_bits()));
        }

        #[test]
        fn halves_between_two_doubles_are_read_as_they_are_by_the_standard_library(
            half in (1_u64 << 52)..(1_u64 << 53), more in -3..=3_i128
        ) {
            // Of doubles from 1 to 2, which are 2^-52 apart, to 18 places; and what is next to it.
            let scaled = (((i128::from(half) * 2 + 1) * 10_i128.pow(18)) >> 53) + more;
            let text = format!("{}.{:018}", scaled / 10_i128.pow(18), scaled % 10_i128.pow(18));
            let expected: f64 = text.parse().unwrap();
            prop_assert_eq!(f64::read(text.as_bytes()).map(f64::to_bits), Some(expected.to_bits()));
        }

        #[test]
        fn what_is_a_number_is_what_the_standard_library_takes_for_one(text in "[-0-9][-0-9 ./:+e]{0,21}") {
            prop_assert_eq!(u64::read(text.as_bytes()), text.parse().ok());
            prop_assert_eq!(i64::read(text.as_bytes()), text.parse().ok());
        }

        #[test]
        fn small_numbers_are_read_with_zeros_before_them_or_not(number in 0..100_000_000_u64, width in 1..12_usize) {
            prop_assert_eq!(u64::read(format!("{number:0width$}").as_bytes()), Some(number));
        }

        #[test]
        fn whole_numbers_are_read(number: u64, signed: i64) {
            prop_assert_eq!(u64::read(number.to_string().as_bytes()), Some(number));
            prop_assert_eq!(i64::read(signed.to_string().as_bytes()), Some(signed));
        }
    }

    #[test]
    fn the_largest_and_what_is_larger() {
        assert_eq!(u64::read(b"18446744073709551615"), Some(u64::MAX));
        assert_eq!(u64::read(b"18446744073709551616"), None);
        assert_eq!(u64::read(b"00000000000000000000007"), Some(7));
        assert_eq!(i64::read(b"-9223372036854775808"), Some(i64::MIN));
        assert_eq!(i64::read(b"9223372036854775808"), None);
        assert_eq!(
            (u64::read(b""), f64::read(b""), f64::read(b"0.")),
            (None, None, Some(0.0))
        );
    }
}
