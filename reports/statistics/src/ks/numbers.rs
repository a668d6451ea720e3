//! Files of numbers, one a line, as `matrix ks X Y` takes them. Blank lines and lines that begin with `#` are skipped,
//! so that a file can say where it comes from. The main function is [`read_numbers`]; [`Numbers`] takes line by line what may be long.
//!
//! Numbers are doubles, which from 2^53 on do not hold every whole number: 9007199254740993 would be read as ...992, and two
//! different values be taken for equal. Such a number is refused.

/// Why a text is not a list of numbers.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NumbersError {
    /// A line that is not one number.
    #[error("line {line} is not a number: `{text}`")]
    NotANumber {
        /// Which line, from 1.
        line: usize,
        /// What it says, shortened.
        text: String,
    },
    /// A line with NaN or an infinity.
    #[error("line {line} is not a finite number: `{text}`")]
    NotFinite {
        /// Which line, from 1.
        line: usize,
        /// What it says.
        text: String,
    },
    /// A number of 2^53 or more that a double does not hold.
    #[error("line {line} is a number that a double cannot hold: `{text}` would be read as {read}")]
    NotExact {
        /// Which line, from 1.
        line: usize,
        /// What it says, shortened.
        text: String,
        /// The nearest double, in digits.
        read: String,
    },
    /// More numbers than are tested.
    #[error("there are more than {} numbers in it", Numbers::MOST)]
    Many,
    /// No number at all.
    #[error("there is no number in it")]
    Empty,
}

impl NumbersError {
    /// What to do about it.
    #[must_use]
    pub const fn hint(&self) -> &'static str {
        match self {
            Self::NotANumber { .. } => {
                "write one number a line, such as `0.118` or `1.2e-3`; lines that begin with `#` are skipped"
            }
            Self::NotFinite { .. } => "the test orders values: remove the line, or find out what produced it",
            Self::NotExact { .. } => {
                "values beyond 2^53, such as times in nanoseconds, must not merge: subtract the same whole number from all values \
                 of both files"
            }
            Self::Many => {
                "give a part of it, such as every tenth line (`awk 'NR % 10 == 0'`): so many numbers differ significantly in \
                 whatever they differ"
            }
            Self::Empty => "write at least one number, one a line",
        }
    }
}

/// Reads one number from each line.
///
/// # Errors
/// At the first line that is not a finite number, and when there is none, or more than [`Numbers::MOST`].
pub fn read_numbers(text: &str) -> Result<Vec<f64>, NumbersError> {
    let mut numbers = Numbers::default();
    text.lines().try_for_each(|line| numbers.add(line))?;
    numbers.all()
}

/// The numbers of lines that are read one by one.
#[derive(Debug, Clone, Default)]
pub struct Numbers {
    numbers: Vec<f64>,
    lines: usize,
}

impl Numbers {
    /// More are refused. A test of two files of so many takes some 250 MB.
    pub const MOST: usize = 3_000_000;

    /// Takes the number of the next line, if there is one.
    ///
    /// # Errors
    /// When it is not a finite number, or one too many.
    pub fn add(&mut self, line: &str) -> Result<(), NumbersError> {
        let line = match self.lines {
            0 => line.strip_prefix('\u{feff}').unwrap_or(line),
            _ => line,
        };
        self.lines += 1;
        let text = line.trim();
        if text.is_empty() || text.starts_with('#') {
            return Ok(());
        }
        if self.numbers.len() == Self::MOST {
            return Err(NumbersError::Many);
        }
        self.numbers.push(number(self.lines, text)?);
        Ok(())
    }

    /// All of them.
    ///
    /// # Errors
    /// When there is none.
    pub fn all(mut self) -> Result<Vec<f64>, NumbersError> {
        self.numbers.shrink_to_fit();
        match self.numbers.is_empty() {
            true => Err(NumbersError::Empty),
            false => Ok(self.numbers),
        }
    }
}

fn number(line: usize, text: &str) -> Result<f64, NumbersError> {
    match text.parse::<f64>() {
        Ok(number) if number.is_finite() && is_exact(text, number) => Ok(number),
        Ok(number) if number.is_finite() => Err(NumbersError::NotExact {
            line,
            text: shortened(text),
            read: format!("{number:.0}"),
        }),
        Ok(_) => Err(NumbersError::NotFinite {
            line,
            text: shortened(text),
        }),
        Err(_) => Err(NumbersError::NotANumber {
            line,
            text: shortened(text),
        }),
    }
}

/// The first double that is followed by a whole number which is none.
const FIRST_WITH_A_GAP: f64 = 9_007_199_254_740_992.0;

/// Whether the number is what the text says, as far as whole numbers go: below 2^53 always. Beyond, a double is a whole number, and
/// the text has all of its digits, or is the shortest one with an exponent that programs write for this double.
fn is_exact(text: &str, number: f64) -> bool {
    if number.abs() < FIRST_WITH_A_GAP {
        return true;
    }
    let said = digits(text);
    let has_exponent = text.contains(['e', 'E']);
    said == digits(&format!("{number:.0}")) || (has_exponent && said == digits(&format!("{number:e}")))
}

/// The significant digits of a number in decimals: those of `-1.20e5` are `12`.
fn digits(text: &str) -> String {
    let mantissa = text.split(['e', 'E']).next().unwrap_or_default();
    let digits: String = mantissa.chars().filter(char::is_ascii_digit).collect();
    digits.trim_matches('0').to_owned()
}

/// The first characters of a line, control characters made visible.
fn shortened(text: &str) -> String {
    const LONGEST: usize = 40;
    let mut shown: String = text.chars().take(LONGEST).flat_map(char::escape_debug).collect();
    if text.chars().nth(LONGEST).is_some() {
        shown.push('…');
    }
    shown
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    #[test]
    fn blank_lines_comments_and_carriage_returns_are_skipped() {
        let text = "\u{feff}# errors, m\r\n0.1\r\n\r\n  2e-1  \n-3\n";
        assert_eq!(read_numbers(text), Ok(vec![0.1, 0.2, -3.0]));
    }

    #[rstest]
    #[case("1\nerror_m\n", "line 2 is not a number: `error_m`")]
    #[case("1 2\n", "line 1 is not a number: `1 2`")]
    #[case("1\n\nNaN", "line 3 is not a finite number: `NaN`")]
    #[case("-inf", "line 1 is not a finite number: `-inf`")]
    #[case("1e999", "line 1 is not a finite number: `1e999`")]
    #[case(
        "1\n9007199254740993",
        "line 2 is a number that a double cannot hold: `9007199254740993` would be read as 9007199254740992"
    )]
    #[case(
        "-1700000000000000001.5",
        "line 1 is a number that a double cannot hold: `-1700000000000000001.5` would be read as -1700000000000000000"
    )]
    #[case(
        "9.007199254740993e15",
        "line 1 is a number that a double cannot hold: `9.007199254740993e15` would be read as 9007199254740992"
    )]
    #[case("", "there is no number in it")]
    #[case("# only words\n\n", "there is no number in it")]
    #[case("\0\u{1b}[31m", "line 1 is not a number: `\\0\\u{1b}[31m`")]
    fn what_is_not_a_list_of_numbers_is_refused_with_its_line(#[case] text: &str, #[case] message: &str) {
        assert_eq!(read_numbers(text).unwrap_err().to_string(), message);
    }

    #[test]
    fn whole_numbers_that_a_double_holds_are_exact_however_large() {
        let text = "9007199254740991\n9007199254740992\n-9007199254740994\n1700000000000000000.0\n1e300\n1.7976931348623157e308\n";
        let expected = [
            9_007_199_254_740_991.0,
            9_007_199_254_740_992.0,
            -9_007_199_254_740_994.0,
            1.7e18,
            1e300,
            f64::MAX,
        ];
        assert_eq!(read_numbers(text), Ok(expected.to_vec()));
        assert_eq!(read_numbers(&format!("{:.0}", f64::MAX)), Ok(vec![f64::MAX]));
    }

    #[test]
    fn more_numbers_than_are_tested_are_refused() {
        let mut numbers = Numbers::default();
        for _ in 0..Numbers::MOST {
            numbers.add("1").unwrap();
        }
        assert_eq!(numbers.add("# the end"), Ok(()));
        let error = numbers.add("2").unwrap_err();
        assert_eq!(error.to_string(), "there are more than 3000000 numbers in it");
    }

    #[test]
    fn a_long_line_is_shortened_in_the_message() {
        let NumbersError::NotANumber { text, .. } = read_numbers(&"x".repeat(1000)).unwrap_err() else {
            panic!("expected a line that is not a number")
        };
        assert_eq!(text.chars().count(), 41);
    }
}
