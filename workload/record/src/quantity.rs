//! Numbers with their units, as people write them: `6000s`, `10ms`, `50Hz`, `1%`, `10Mbit`, `96B`, `2mm`.
//!
//! A quantity is parsed from text and written back as text, so that the matrix file, the manifest and the workload's
//! settings show one and the same spelling. A number without a unit is refused: `delay: 10` has cost people a
//! campaign before. The main types are [`TimeSpan`], [`Frequency`], [`Fraction`], [`BitRate`],
//! [`Bytes`] and [`Length`].

use std::{fmt, str::FromStr, time::Duration};

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// Why a text is not a quantity of the wanted kind.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum QuantityError {
    /// A bare number, such as `10`.
    #[error("`{text}` has no unit: write {what} as {readings}; the units are {units}")]
    NoUnit {
        /// What was written.
        text: String,
        /// What kind of quantity was wanted.
        what: &'static str,
        /// What may have been meant, such as "`10s` or `10ms`".
        readings: String,
        /// The units that are known.
        units: String,
    },
    /// A unit of another kind, or none that is known.
    #[error("`{unit}` is not a unit of {what}: use {units}, as in `{example}`")]
    WrongUnit {
        /// The unit that was written.
        unit: String,
        /// What kind of quantity was wanted.
        what: &'static str,
        /// The units that are known.
        units: String,
        /// A valid one.
        example: &'static str,
    },
    /// No number before the unit, or one that is negative or not finite.
    #[error("`{text}` is not {what}: write a number and a unit, as in `{example}`")]
    NotANumber {
        /// What was written.
        text: String,
        /// What kind of quantity was wanted.
        what: &'static str,
        /// A valid one.
        example: &'static str,
    },
    /// Too large or too small for the quantity.
    #[error("`{text}` is out of range for {what}: write one from `{least}` to `{most}`")]
    OutOfRange {
        /// What was written.
        text: String,
        /// What kind of quantity was wanted.
        what: &'static str,
        /// The smallest.
        least: String,
        /// The largest.
        most: String,
    },
}

/// One kind of quantity.
struct Kind {
    what: &'static str,
    example: &'static str,
    /// Each unit with its factor to the base unit, smallest first.
    units: &'static [(&'static str, f64)],
    /// What a bare number may have been meant in, the likeliest first: by how much to multiply it, and a unit.
    bare: &'static [(f64, &'static str)],
    /// The smallest and the largest value, in the base unit.
    range: [f64; 2],
}

impl Kind {
    /// The value in the base unit.
    fn parse(&self, text: &str) -> Result<f64, QuantityError> {
        let trimmed = text.trim();
        let number_ends = trimmed
            .find(|c: char| !(c.is_ascii_digit() || matches!(c, '.' | '+' | '-' | '_')))
            .unwrap_or(trimmed.len());
        let (number, unit) = trimmed.split_at(number_ends);
        let unit = unit.trim();
        let value: f64 = number
            .replace('_', "")
            .parse()
            .map_err(|_| self.not_a_number(text))?;
        if !value.is_finite() || value < 0.0 {
            return Err(self.not_a_number(text));
        }
        if unit.is_empty() {
            return Err(QuantityError::NoUnit {
                text: text.to_owned(),
                what: self.what,
                readings: self.readings(value),
                units: self.unit_names(),
            });
        }
        let factor = self.factor(unit).ok_or_else(|| QuantityError::WrongUnit {
            unit: unit.to_owned(),
            what: self.what,
            units: self.unit_names(),
            example: self.example,
        })?;
        let value = value * factor;
        match self.has(value) {
            true => Ok(value),
            false => Err(QuantityError::OutOfRange {
                text: text.to_owned(),
                what: self.what,
                least: self.spell(self.range[0]),
                most: self.spell(self.range[1]),
            }),
        }
    }

    fn factor(&self, unit: &str) -> Option<f64> {
        let known = self.units.iter().find(|(name, _)| *name == unit);
        known.map(|(_, factor)| *factor)
    }

    fn has(&self, value: f64) -> bool {
        let [least, most] = self.range;
        (least..=most).contains(&value)
    }

    /// What a bare number may have been meant as: nobody can know whether `32` are seconds or milliseconds, or whether
    /// `0.01` is a share of one or of a hundred.
    fn readings(&self, value: f64) -> String {
        // 0.07 times 100 is 7, and not 7.000000000000001.
        let rounded = |value: f64| (value * 1e9).round() / 1e9;
        let possible = self
            .bare
            .iter()
            .map(|(times, unit)| (rounded(value * times), *unit));
        let possible =
            possible.filter(|(value, unit)| self.has(value * self.factor(unit).unwrap_or(f64::NAN)));
        let mut texts: Vec<_> = possible.map(|(value, unit)| format!("`{value}{unit}`")).collect();
        texts.dedup();
        match texts.is_empty() {
            true => format!("`{}`", self.example),
            false => texts.join(" or "),
        }
    }

    fn unit_names(&self) -> String {
        let names: Vec<_> = self.units.iter().map(|(name, _)| format!("`{name}`")).collect();
        names.join(", ")
    }

    fn not_a_number(&self, text: &str) -> QuantityError {
        QuantityError::NotANumber {
            text: text.to_owned(),
            what: self.what,
            example: self.example,
        }
    }

    /// The shortest spelling: the largest unit in which the value is a whole number, else the largest below it.
    /// Minutes and hours are read but never written: the field says 6000 s.
    fn spell(&self, value: f64) -> String {
        let whole = |factor: f64| (value / factor).fract() == 0.0;
        let units = || {
            self.units
                .iter()
                .rev()
                .filter(|(name, _)| !matches!(*name, "min" | "h"))
        };
        let (name, factor) = units()
            .find(|(_, factor)| value >= *factor && whole(*factor))
            .or_else(|| units().find(|(_, factor)| value >= *factor))
            .unwrap_or(&self.units[0]);
        format!("{}{name}", value / factor)
    }
}

/// Gives a quantity its text forms from its [`Kind`].
macro_rules! text_forms {
    ($name:ident, $kind:expr, $pattern:literal) => {
        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(&$kind.spell(self.in_base_unit()))
            }
        }

        impl FromStr for $name {
            type Err = QuantityError;

            fn from_str(text: &str) -> Result<Self, QuantityError> {
                $kind.parse(text).map(Self::from_base_unit)
            }
        }

        impl Serialize for $name {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.collect_str(self)
            }
        }

        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                struct Visitor;
                impl de::Visitor<'_> for Visitor {
                    type Value = $name;

                    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                        write!(f, "{} such as `{}`", $kind.what, $kind.example)
                    }

                    fn visit_str<E: de::Error>(self, text: &str) -> Result<$name, E> {
                        text.parse().map_err(E::custom)
                    }

                    // A bare number arrives as a number: say that the unit is what is missing.
                    fn visit_i64<E: de::Error>(self, number: i64) -> Result<$name, E> {
                        self.visit_str(&number.to_string())
                    }

                    fn visit_u64<E: de::Error>(self, number: u64) -> Result<$name, E> {
                        self.visit_str(&number.to_string())
                    }

                    fn visit_f64<E: de::Error>(self, number: f64) -> Result<$name, E> {
                        self.visit_str(&number.to_string())
                    }
                }
                deserializer.deserialize_any(Visitor)
            }
        }

        #[cfg(feature = "schema")]
        impl schemars::JsonSchema for $name {
            fn schema_name() -> std::borrow::Cow<'static, str> {
                stringify!($name).into()
            }

            fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
                schemars::json_schema!({
                    "type": "string",
                    "description": format!("{} with its unit", $kind.what),
                    "pattern": $pattern,
                    "examples": [$kind.example],
                })
            }
        }
    };
}

const TIME: Kind = Kind {
    what: "a duration",
    example: "10ms",
    units: &[
        ("ns", 1.0),
        ("us", 1e3),
        ("ms", 1e6),
        ("s", 1e9),
        ("min", 60e9),
        ("h", 3600e9),
    ],
    bare: &[(1.0, "s"), (1.0, "ms")],
    // 2^53 ns are 104 days: beyond that a double is no longer exact, and no window is that long.
    range: [0.0, 9_007_199e9],
};

/// A length of time, exact to the nanosecond.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct TimeSpan(Duration);

impl TimeSpan {
    /// From whole milliseconds.
    #[must_use]
    pub const fn from_millis(milliseconds: u64) -> Self {
        Self(Duration::from_millis(milliseconds))
    }

    /// From whole seconds.
    #[must_use]
    pub const fn from_secs(seconds: u64) -> Self {
        Self(Duration::from_secs(seconds))
    }

    /// As the standard library's duration.
    #[must_use]
    pub const fn duration(self) -> Duration {
        self.0
    }

    /// In seconds.
    #[must_use]
    pub fn as_secs_f64(self) -> f64 {
        self.0.as_secs_f64()
    }

    /// In nanoseconds.
    #[must_use]
    pub fn as_nanos(self) -> u64 {
        u64::try_from(self.0.as_nanos()).unwrap_or(u64::MAX)
    }

    fn in_base_unit(self) -> f64 {
        self.0.as_nanos() as f64
    }

    fn from_base_unit(nanoseconds: f64) -> Self {
        Self(Duration::from_nanos(nanoseconds.round() as u64))
    }
}

impl From<Duration> for TimeSpan {
    fn from(duration: Duration) -> Self {
        Self(duration)
    }
}

text_forms!(TimeSpan, TIME, r"^[0-9][0-9_]*(\.[0-9]+)?\s*(ns|us|ms|s|min|h)$");

const FREQUENCY: Kind = Kind {
    what: "a rate",
    example: "50Hz",
    units: &[("Hz", 1.0), ("kHz", 1e3)],
    bare: &[(1.0, "Hz")],
    // Once in twelve days is as seldom as anything happens that is counted here.
    range: [1e-6, 1e6],
};

/// How often something happens, in hertz.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Frequency(f64);

impl Frequency {
    /// From hertz.
    #[must_use]
    pub const fn from_hz(hertz: f64) -> Self {
        Self(hertz)
    }

    /// In hertz.
    #[must_use]
    pub const fn hz(self) -> f64 {
        self.0
    }

    /// The time from one occurrence to the next, rounded to the nanosecond.
    #[must_use]
    pub fn step(self) -> Duration {
        Duration::from_nanos((1e9 / self.0).round() as u64)
    }

    fn in_base_unit(self) -> f64 {
        self.0
    }

    fn from_base_unit(hertz: f64) -> Self {
        Self(hertz)
    }
}

text_forms!(Frequency, FREQUENCY, r"^[0-9][0-9_]*(\.[0-9]+)?\s*(Hz|kHz)$");

const FRACTION: Kind = Kind {
    what: "a share",
    example: "1%",
    units: &[("%", 1.0)],
    bare: &[(100.0, "%"), (1.0, "%")],
    range: [0.0, 100.0],
};

/// A share from 0 % to 100 %, kept in percent so that `1%` reads back as `1%`.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Default)]
pub struct Fraction(f64);

impl Fraction {
    /// From percent.
    #[must_use]
    pub const fn from_percent(percent: f64) -> Self {
        Self(percent)
    }

    /// As a probability from 0 to 1.
    #[must_use]
    pub fn probability(self) -> f64 {
        self.0 / 100.0
    }

    fn in_base_unit(self) -> f64 {
        self.0
    }

    fn from_base_unit(percent: f64) -> Self {
        Self(percent)
    }
}

text_forms!(Fraction, FRACTION, r"^[0-9]+(\.[0-9]+)?\s*%$");

const BIT_RATE: Kind = Kind {
    what: "a bandwidth",
    example: "10Mbit",
    // As `tc` and Mininet write them: decimal, bits a second.
    units: &[("bit", 1.0), ("kbit", 1e3), ("Mbit", 1e6), ("Gbit", 1e9)],
    bare: &[(1.0, "Mbit"), (1.0, "bit")],
    range: [1.0, 1e12],
};

/// Bits a second.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct BitRate(u64);

impl BitRate {
    /// From megabits a second.
    #[must_use]
    pub const fn from_mbit(mbit: u64) -> Self {
        Self(mbit * 1_000_000)
    }

    /// In bits a second.
    #[must_use]
    pub const fn bits_per_second(self) -> u64 {
        self.0
    }

    fn in_base_unit(self) -> f64 {
        self.0 as f64
    }

    fn from_base_unit(bits: f64) -> Self {
        Self(bits.round() as u64)
    }
}

text_forms!(
    BitRate,
    BIT_RATE,
    r"^[0-9][0-9_]*(\.[0-9]+)?\s*(bit|kbit|Mbit|Gbit)$"
);

const LENGTH: Kind = Kind {
    what: "a length",
    example: "2mm",
    // Kept in micrometres, so that `2mm` reads back as `2mm`.
    units: &[("um", 1.0), ("mm", 1e3), ("cm", 1e4), ("m", 1e6)],
    bare: &[(1.0, "mm"), (1.0, "m")],
    range: [0.001, 1e9],
};

/// A length in space.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Length(f64);

impl Length {
    /// From millimetres.
    #[must_use]
    pub const fn from_millimetres(millimetres: f64) -> Self {
        Self(millimetres * 1e3)
    }

    /// In metres.
    #[must_use]
    pub fn metres(self) -> f64 {
        self.0 / 1e6
    }

    fn in_base_unit(self) -> f64 {
        self.0
    }

    fn from_base_unit(micrometres: f64) -> Self {
        Self(micrometres)
    }
}

text_forms!(Length, LENGTH, r"^[0-9][0-9_]*(\.[0-9]+)?\s*(um|mm|cm|m)$");

const BYTES: Kind = Kind {
    what: "a size",
    example: "512MiB",
    units: &[
        ("B", 1.0),
        ("KiB", 1024.0),
        ("MiB", 1_048_576.0),
        ("GiB", 1_073_741_824.0),
    ],
    bare: &[(1.0, "MiB"), (1.0, "B")],
    // Beyond 2^53 a double is no longer exact.
    range: [0.0, 9_007_199_254_740_992.0],
};

/// A number of bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Bytes(u64);

impl Bytes {
    /// From bytes.
    #[must_use]
    pub const fn new(bytes: u64) -> Self {
        Self(bytes)
    }

    /// In bytes.
    #[must_use]
    pub const fn get(self) -> u64 {
        self.0
    }

    fn in_base_unit(self) -> f64 {
        self.0 as f64
    }

    fn from_base_unit(bytes: f64) -> Self {
        Self(bytes.round() as u64)
    }
}

text_forms!(Bytes, BYTES, r"^[0-9][0-9_]*(\.[0-9]+)?\s*(B|KiB|MiB|GiB)$");

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case("2mm", 0.002)]
    #[case("1.5 cm", 0.015)]
    #[case("250um", 0.00025)]
    #[case("1m", 1.0)]
    fn lengths_are_read_in_metres_and_read_back(#[case] text: &str, #[case] metres: f64) {
        let length: Length = text.parse().unwrap();
        assert_eq!(length.metres(), metres);
        assert_eq!(length.to_string().parse::<Length>().unwrap(), length);
        assert!("0mm".parse::<Length>().is_err() && "2".parse::<Length>().is_err());
    }

    #[rstest::rstest]
    #[case("6000s", 6_000_000_000_000)]
    #[case("10ms", 10_000_000)]
    #[case("1.5 h", 5_400_000_000_000)]
    #[case("0s", 0)]
    #[case("100us", 100_000)]
    fn durations_are_read_to_the_nanosecond(#[case] text: &str, #[case] nanoseconds: u64) {
        assert_eq!(text.parse::<TimeSpan>().unwrap().as_nanos(), nanoseconds);
    }

    #[test]
    fn a_number_without_its_unit_is_refused_and_told_what_to_write() {
        let error = "10".parse::<TimeSpan>().unwrap_err();
        assert_eq!(
            error.to_string(),
            "`10` has no unit: write a duration as `10s` or `10ms`; the units are `ns`, `us`, `ms`, `s`, `min`, `h`"
        );
        let error = serde_json::from_str::<BitRate>("10").unwrap_err();
        assert!(
            error
                .to_string()
                .starts_with("`10` has no unit: write a bandwidth as `10Mbit` or `10bit`;"),
            "{error}"
        );
    }

    #[rstest::rstest]
    #[case("0.01", "`1%` or `0.01%`")]
    #[case("0.07", "`7%` or `0.07%`")]
    #[case("1", "`100%` or `1%`")]
    #[case("0", "`0%`")]
    #[case("5", "`5%`")]
    #[case("500", "`1%`")]
    fn a_share_without_its_unit_may_be_one_of_a_hundred_or_of_one(
        #[case] text: &str,
        #[case] readings: &str,
    ) {
        let error = text.parse::<Fraction>().unwrap_err();
        let expected = format!("`{text}` has no unit: write a share as {readings}; the units are `%`");
        assert_eq!(error.to_string(), expected);
    }

    #[test]
    fn a_unit_of_another_kind_is_refused_with_the_right_ones() {
        let error = "50ms".parse::<Frequency>().unwrap_err();
        assert_eq!(
            error.to_string(),
            "`ms` is not a unit of a rate: use `Hz`, `kHz`, as in `50Hz`"
        );
    }

    #[rstest::rstest]
    #[case("-1s")]
    #[case("s")]
    #[case("")]
    #[case("1.2.3s")]
    fn what_is_not_a_number_is_refused(#[case] text: &str) {
        assert!(matches!(
            text.parse::<TimeSpan>(),
            Err(QuantityError::NotANumber { .. })
        ));
    }

    #[test]
    fn what_is_out_of_range_is_refused_with_the_range() {
        let error = |error: QuantityError| error.to_string();
        assert_eq!(
            "101%".parse::<Fraction>().map_err(error),
            Err("`101%` is out of range for a share: write one from `0%` to `100%`".to_owned())
        );
        assert_eq!(
            "0Hz".parse::<Frequency>().map_err(error),
            Err("`0Hz` is out of range for a rate: write one from `0.000001Hz` to `1000kHz`".to_owned())
        );
        assert_eq!(
            "9999h".parse::<TimeSpan>().map_err(error),
            Err("`9999h` is out of range for a duration: write one from `0ns` to `9007199s`".to_owned())
        );
    }

    proptest::proptest! {
        #[test]
        fn every_duration_reads_back_as_it_was(ns in 0_u64..9_007_199_000_000_000) {
            let span = TimeSpan::from(Duration::from_nanos(ns));
            proptest::prop_assert!(span.to_string().parse::<TimeSpan>().unwrap().as_nanos().abs_diff(ns) <= 1);
        }

        #[test]
        fn every_bit_rate_reads_back_as_it_was(bits in 1_u64..1_000_000_000_000) {
            let rate = BitRate(bits);
            proptest::prop_assert_eq!(rate.to_string().parse::<BitRate>().unwrap(), rate);
        }
    }
}
