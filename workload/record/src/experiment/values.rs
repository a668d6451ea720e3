//! The values of a metric, out of the file that the command wrote. The main function is [`read_values`].

use std::io::{self, Read};

use super::{CommandExperiment, Metric};

/// A window has no more values: 80 MB of them.
pub const MOST_VALUES: usize = 10_000_000;
/// No value is written with more bytes than this.
const LONGEST_VALUE: usize = 400;

/// What is wrong with the file, with its place in it: lines and columns are counted from 1.
#[derive(Debug, thiserror::Error)]
pub enum ValueError {
    /// It has no such column.
    #[error("{file}: line 1 names no column `{column}`; it names {}", shown_columns(.there))]
    NoColumn {
        /// The file.
        file: String,
        /// The column that is wanted.
        column: String,
        /// The first of those that there are.
        there: Vec<String>,
    },
    /// Two columns have the name.
    #[error("{file}: line 1 names the column `{column}` twice")]
    TwoColumns {
        /// The file.
        file: String,
        /// The column.
        column: String,
    },
    /// A row has no such field.
    #[error("{file}: line {line} ends before column {field}")]
    Short {
        /// The file.
        file: String,
        /// Where.
        line: u64,
        /// The number of the field.
        field: usize,
    },
    /// A row has more fields than there are columns, as one with a decimal comma.
    #[error("{file}: line {line} has more than {columns} column{}", if *columns == 1 { "" } else { "s" })]
    Long {
        /// The file.
        file: String,
        /// Where.
        line: u64,
        /// How many columns there are.
        columns: usize,
    },
    /// A value is not a number, or none that can be compared.
    #[error("{file}: line {line}, column {field}: `{found}` is not a finite number")]
    NoNumber {
        /// The file.
        file: String,
        /// Where.
        line: u64,
        /// The number of the field.
        field: usize,
        /// What is there, cut.
        found: String,
    },
    /// There is no value.
    #[error("{file} has no value")]
    Empty {
        /// The file.
        file: String,
    },
    /// There are too many.
    #[error("{file} has more than {MOST_VALUES} values")]
    Many {
        /// The file.
        file: String,
    },
    /// It is no CSV, or cannot be read.
    #[error("{file} cannot be read")]
    Unreadable {
        /// The file.
        file: String,
        /// Why.
        source: csv::Error,
    },
}

/// So many columns of a file are named that has not the wanted one.
const SHOWN: usize = 10;

fn shown_columns(there: &[String]) -> String {
    let shown: Vec<String> = there
        .iter()
        .take(SHOWN)
        .map(|column| format!("`{}`", cut(column)))
        .collect();
    match (shown.as_slice(), there.len() > SHOWN) {
        ([], _) => "none".to_owned(),
        (shown, false) => shown.join(", "),
        (shown, true) => format!("{} and others", shown.join(", ")),
    }
}

/// The beginning of what a command wrote, without what a terminal would obey.
fn cut(text: &str) -> String {
    text.chars().take(40).flat_map(char::escape_debug).collect()
}

/// Reads a metric's values, in the order of the file.
///
/// # Errors
/// What is wrong with the file, and where.
pub fn read_values(metric: &Metric, from: impl Read) -> Result<Vec<f64>, ValueError> {
    let file = || metric.from.clone();
    let unreadable = |source| ValueError::Unreadable { file: file(), source };
    let mut rows = csv::ReaderBuilder::new()
        .has_headers(metric.column.is_some())
        .flexible(true)
        .trim(csv::Trim::All)
        .from_reader(BoundedLines { from, of_line: 0 });
    let at = match &metric.column {
        None => 0,
        Some(column) => {
            let there = rows.byte_headers().map_err(unreadable)?;
            let mut places = there
                .iter()
                .enumerate()
                .filter(|(_, name)| *name == column.as_bytes());
            match (places.next(), places.next()) {
                (Some((at, _)), None) => at,
                (Some(_), Some(_)) => {
                    return Err(ValueError::TwoColumns {
                        file: file(),
                        column: column.clone(),
                    });
                }
                (None, _) => {
                    return Err(ValueError::NoColumn {
                        file: file(),
                        column: column.clone(),
                        there: there
                            .iter()
                            .take(SHOWN + 1)
                            .map(|name| String::from_utf8_lossy(name).into_owned())
                            .collect(),
                    });
                }
            }
        }
    };
    // A decimal comma makes two fields of a number, of which the first would be taken for it.
    let columns = match &metric.column {
        None => 1,
        Some(_) => rows.byte_headers().map_err(unreadable)?.len(),
    };
    let mut values = Vec::new();
    let mut row = csv::ByteRecord::new();
    while rows.read_byte_record(&mut row).map_err(unreadable)? {
        let line = row.position().map_or(0, csv::Position::line);
        let field = at + 1;
        if row.len() > columns {
            return Err(ValueError::Long {
                file: file(),
                line,
                columns,
            });
        }
        let Some(written) = row.get(at) else {
            return Err(ValueError::Short {
                file: file(),
                line,
                field,
            });
        };
        let number = std::str::from_utf8(written)
            .ok()
            .filter(|text| text.len() <= LONGEST_VALUE)
            .and_then(|text| text.parse::<f64>().ok())
            .filter(|number| number.is_finite());
        let Some(number) = number else {
            return Err(ValueError::NoNumber {
                file: file(),
                line,
                field,
                found: cut(&String::from_utf8_lossy(written)),
            });
        };
        if values.len() == MOST_VALUES {
            return Err(ValueError::Many { file: file() });
        }
        values.push(number);
    }
    match values.is_empty() {
        true => Err(ValueError::Empty { file: file() }),
        false => Ok(values),
    }
}

/// A reader that refuses a line of more than [`CommandExperiment::LONGEST_LINE`], so that no file makes a reader of its rows keep more.
struct BoundedLines<R> {
    from: R,
    /// Bytes since the last line began.
    of_line: u64,
}

impl<R: Read> Read for BoundedLines<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.from.read(buffer)?;
        for part in buffer
            .get(..read)
            .unwrap_or_default()
            .split_inclusive(|byte| *byte == b'\n')
        {
            self.of_line += part.len() as u64;
            if self.of_line > CommandExperiment::LONGEST_LINE {
                let longest = CommandExperiment::LONGEST_LINE;
                return Err(io::Error::other(format!("a line has more than {longest} bytes")));
            }
            if part.ends_with(b"\n") {
                self.of_line = 0;
            }
        }
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::{super::Compare, *};

    fn read(column: Option<&str>, text: impl AsRef<[u8]>) -> Result<Vec<f64>, String> {
        read_values(&metric(column), text.as_ref()).map_err(|error| error.to_string())
    }

    fn metric(column: Option<&str>) -> Metric {
        Metric {
            name: "m".to_owned(),
            unit: String::new(),
            from: "errors.csv".to_owned(),
            column: column.map(str::to_owned),
            compare: Compare::Ks,
            equivalence_margin: None,
        }
    }

    #[rstest]
    #[case(Some("error"), "step,error\n1,0.5\n2,-1e-3\n", &[0.5, -1e-3])]
    #[case(Some("error"), "error\r\n 7 \r\n\r\n8\r\n", &[7.0, 8.0])]
    #[case(Some("my error"), "\"my error\",x\n1,\n2,\n", &[1.0, 2.0])]
    #[case(None, "1\n2\n3", &[1.0, 2.0, 3.0])]
    fn values_are_read_in_their_order(
        #[case] column: Option<&str>,
        #[case] text: &str,
        #[case] values: &[f64],
    ) {
        assert_eq!(read(column, text).unwrap(), values);
    }

    #[rstest]
    #[case(
        Some("b"),
        "a,c\n1,2\n",
        "errors.csv: line 1 names no column `b`; it names `a`, `c`"
    )]
    #[case(Some("a"), "a,a\n1,2\n", "errors.csv: line 1 names the column `a` twice")]
    #[case(Some("a"), "", "errors.csv: line 1 names no column `a`; it names none")]
    #[case(Some("a"), "a\n", "errors.csv has no value")]
    #[case(None, "0,5\n1,5\n", "errors.csv: line 1 has more than 1 column")]
    #[case(Some("a"), "a\n0\n0,5\n", "errors.csv: line 3 has more than 1 column")]
    #[case(Some("b"), "a,b\n1,2\n3,4,5\n", "errors.csv: line 3 has more than 2 columns")]
    #[case(Some("b"), "a,b\n1,2\n3\n", "errors.csv: line 3 ends before column 2")]
    #[case(
        Some("b"),
        "a,b\n1,2\n3,\n",
        "errors.csv: line 3, column 2: `` is not a finite number"
    )]
    #[case(
        None,
        "1\nNaN\n",
        "errors.csv: line 2, column 1: `NaN` is not a finite number"
    )]
    #[case(
        None,
        "1\n1e999\n",
        "errors.csv: line 2, column 1: `1e999` is not a finite number"
    )]
    #[case(
        None,
        "\u{1b}[31mred\n",
        "errors.csv: line 1, column 1: `\\u{1b}[31mred` is not a finite number"
    )]
    fn what_is_no_value_is_told_with_its_place(
        #[case] column: Option<&str>,
        #[case] text: &str,
        #[case] words: &str,
    ) {
        assert_eq!(read(column, text).unwrap_err(), words);
    }

    #[rstest]
    #[case::header(Some("b"), ",".repeat(2 << 20))]
    #[case::row(Some("a"), format!("a\n1\n{}", "2".repeat(2 << 20)))]
    fn a_line_without_an_end_is_refused(#[case] column: Option<&str>, #[case] text: String) {
        let metric = metric(column);
        let error = read_values(&metric, text.as_bytes()).unwrap_err();
        let causes = format!("{error}: {}", std::error::Error::source(&error).unwrap());
        assert_eq!(
            causes,
            "errors.csv cannot be read: a line has more than 1048576 bytes"
        );
    }

    #[test]
    fn a_file_of_long_lines_is_read() {
        let row = format!("1,{}\n", "x".repeat(1 << 19));
        let text = format!("a,b\n{}", row.repeat(4));
        assert_eq!(read(Some("a"), text).unwrap(), [1.0; 4]);
    }

    #[test]
    fn bytes_that_are_no_text_are_told_and_not_printed() {
        let error = read(None, b"1\n\xff\xfe\x00\n").unwrap_err();
        assert_eq!(
            error,
            "errors.csv: line 2, column 1: `\u{fffd}\u{fffd}\\0` is not a finite number"
        );
    }
}
