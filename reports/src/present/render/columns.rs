//! The comparisons and the samples as columns, for those who go on with their own tools: CSV and Parquet, by polars. Half a
//! million comparisons are a file of 95 MB, so that a table comes in [`Pieces`] and is written piece by piece.

use std::{io::Write, iter};

use captures::{packets::Topic, traffic::PeriodTraffic};
use polars::{
    df,
    error::PolarsResult,
    frame::DataFrame,
    prelude::{CsvWriter, IntoColumn, NamedFrom, ParquetCompression, ParquetWriter, SerWriter, Series},
};
use statistics::{
    effect::{Effect, Estimate},
    shape::DISTANCES,
};

use crate::{
    analysis::{contrast::Contrast, report::Report},
    present::frames,
};

/// The rows of a table in order, at least one piece, all with the same columns.
pub(crate) type Pieces<'a> = Box<dyn Iterator<Item = PolarsResult<DataFrame>> + 'a>;

/// The columns of the comparisons, in the order of the file.
const COMPARISONS: [&str; 32] = [
    "a",
    "a_slug",
    "a_window",
    "b",
    "b_slug",
    "b_window",
    "n",
    "m",
    "d",
    "h",
    "lcm",
    "p",
    "log10_p",
    "signed_d",
    "at",
    "method",
    "alpha",
    "rejected",
    "unlike",
    "same_scenario",
    "a_hardware",
    "b_hardware",
    "a_os",
    "b_os",
    "a_virtualization",
    "b_virtualization",
    "a_platform",
    "b_platform",
    "a_is_control",
    "b_is_control",
    "a_paper",
    "b_paper",
];

/// Comparisons in a piece, and in a row group of Parquet.
const PIECE: usize = 16_384;

/// The frame of the comparisons, with what there is of their scenarios.
pub(crate) fn comparisons(report: &Report) -> Pieces<'_> {
    let frame = report.comparisons.frame();
    let pieces = frame.height().div_ceil(PIECE).max(1);
    let piece = move |nth: usize| {
        let mut piece = frame.slice((nth * PIECE) as i64, PIECE);
        let alpha = vec![report.settings.alpha; piece.height()];
        piece.with_column(Series::new("alpha".into(), alpha).into_column())?;
        frames::with_scenarios(report, &piece, &frames::scenarios(report)?)?.select(COMPARISONS)
    };
    Box::new((0..pieces).map(piece))
}

/// One row a scenario of the plan.
pub(crate) fn scenarios(report: &Report) -> Pieces<'_> {
    Box::new(iter::once_with(|| frames::scenarios(report)))
}

/// One row a pair of the family.
pub(crate) fn contrasts(report: &Report) -> Pieces<'_> {
    Box::new(iter::once_with(|| all_contrasts(report)))
}

fn all_contrasts(report: &Report) -> PolarsResult<DataFrame> {
    fn column<'a, T>(report: &'a Report, of: impl Fn(&'a Contrast) -> T) -> Vec<T> {
        report.contrasts.pairs.iter().map(of).collect()
    }
    let value = |of: fn(&Effect) -> &Estimate| column(report, move |c| of(&c.effect).value);
    let low = |of: fn(&Effect) -> &Estimate| column(report, move |c| of(&c.effect).interval.map(|i| i.low));
    let high = |of: fn(&Effect) -> &Estimate| column(report, move |c| of(&c.effect).interval.map(|i| i.high));
    let unlike = |a: &str, b: &str| unlike(report, a, b);
    let mut frame = df![
        "a" => column(report, |c| c.a.as_str()),
        "b" => column(report, |c| c.b.as_str()),
        "n" => column(report, |c| c.n as u64),
        "m" => column(report, |c| c.m as u64),
        "p" => column(report, |c| c.level.p),
        "smallest_p" => column(report, |c| c.level.smallest_p),
        "labellings" => column(report, |c| c.level.labellings),
        "method" => column(report, |c| c.level.coverage.name()),
        "shape_labellings" => column(report, |c| c.shape.labellings()),
        "p_holm" => column(report, |c| c.p_holm),
        "p_benjamini_yekutieli" => column(report, |c| c.p_benjamini_yekutieli),
        "p_max_t" => column(report, |c| c.p_max_t),
        "verdict" => column(report, |c| c.verdict.name()),
        "unlike" => column(report, |c| unlike(&c.a, &c.b)),
        "shift" => value(|e| &e.shift),
        "shift_low" => low(|e| &e.shift),
        "shift_high" => high(|e| &e.shift),
        "shift_confidence" => column(report, |c| c.effect.shift.interval.map(|i| i.confidence)),
        "wasserstein" => value(|e| &e.wasserstein),
        "wasserstein_low" => low(|e| &e.wasserstein),
        "wasserstein_high" => high(|e| &e.wasserstein),
        "superiority" => value(|e| &e.superiority),
        "superiority_low" => low(|e| &e.superiority),
        "superiority_high" => high(|e| &e.superiority),
        "p_shift" => column(report, |c| c.p_shift),
        "p_shift_holm" => column(report, |c| c.p_shift_holm),
        "shift_simultaneous_low" => column(report, |c| c.simultaneous.map(|i| i.low)),
        "shift_simultaneous_high" => column(report, |c| c.simultaneous.map(|i| i.high)),
        "simultaneous_confidence" => column(report, |c| c.simultaneous.map(|i| i.confidence)),
    ]?;
    // Before the number of their labellings.
    let first = frame.try_get_column_index("shape_labellings")?;
    for (nth, distance) in DISTANCES.iter().enumerate() {
        let p: Vec<Option<f64>> = column(report, |c| c.shape.each().nth(nth).map(|(_, test)| test.p));
        frame.insert_column(first + nth, Series::new(distance.column.into(), p).into_column())?;
    }
    Ok(frame)
}

/// What is not the same of the experiments of two scenarios; none if they ran the same.
fn unlike(report: &Report, a: &str, b: &str) -> Option<String> {
    let fields = report.setup_differences(a, b);
    (!fields.is_empty()).then(|| fields.join(" "))
}

/// One row a period that counts.
pub(crate) fn samples(report: &Report) -> Pieces<'_> {
    Box::new(iter::once_with(|| all_samples(report)))
}

fn all_samples(report: &Report) -> PolarsResult<DataFrame> {
    let mut columns = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for sample in &report.samples {
        for (period, value) in (sample.first_value..).zip(&sample.values) {
            columns.0.push(sample.scenario.as_str());
            columns.1.push(sample.window);
            columns.2.push(period);
            columns.3.push(*value);
        }
    }
    df!["scenario" => columns.0, "window" => columns.1, "number" => columns.2, "value" => columns.3]
}

/// One row a period and direction of the windows that count, whether or not the period counts.
pub(crate) fn packets(report: &Report) -> Pieces<'_> {
    Box::new(iter::once_with(|| all_packets(report)))
}

fn all_packets(report: &Report) -> PolarsResult<DataFrame> {
    struct Row<'a> {
        scenario: &'a str,
        window: u32,
        period: u32,
        topic: Topic,
        packets: &'a PeriodTraffic,
    }
    let mut rows = Vec::new();
    for (scenario, found) in &report.traffic.scenarios {
        for window in &found.windows {
            for direction in &window.directions {
                rows.extend((1..).zip(&direction.periods).map(|(period, packets)| Row {
                    scenario,
                    window: window.window,
                    period,
                    topic: direction.topic,
                    packets,
                }));
            }
        }
    }
    fn column<'a, T>(rows: &[Row<'a>], of: impl Fn(&Row<'a>) -> T) -> Vec<T> {
        rows.iter().map(of).collect()
    }
    df![
        "scenario" => column(&rows, |row| row.scenario),
        "window" => column(&rows, |row| row.window),
        "period" => column(&rows, |row| row.period),
        "topic" => column(&rows, |row| row.topic.name()),
        "sent" => column(&rows, |row| row.packets.sent),
        "retransmitted" => column(&rows, |row| row.packets.retransmitted),
        "lost" => column(&rows, |row| row.packets.lost),
        "reordered" => column(&rows, |row| row.packets.reordered),
        "one_way_s" => column(&rows, |row| row.packets.one_way_s),
        "rtt_s" => column(&rows, |row| row.packets.rtt_s),
        "jitter_s" => column(&rows, |row| row.packets.jitter_s),
        "longest_gap_s" => column(&rows, |row| row.packets.longest_gap_s),
    ]
}

pub(crate) fn csv(pieces: Pieces<'_>, out: &mut impl Write) -> PolarsResult<()> {
    for (nth, piece) in pieces.enumerate() {
        CsvWriter::new(&mut *out)
            .include_header(nth == 0)
            .finish(&mut without_formulas(piece?)?)?;
    }
    Ok(())
}

/// A spreadsheet takes a text for a formula that begins as one. Names come from whoever wrote the matrix file.
fn without_formulas(mut frame: DataFrame) -> PolarsResult<DataFrame> {
    const BEGIN: [char; 4] = ['=', '+', '-', '@'];
    let names: Vec<String> = frame.get_column_names().iter().map(ToString::to_string).collect();
    for name in names {
        let Ok(texts) = frame.column(&name)?.str() else {
            continue;
        };
        if !texts.iter().flatten().any(|text| text.starts_with(BEGIN)) {
            continue;
        }
        let shown = |text: &str| match text.starts_with(BEGIN) {
            true => format!("'{text}"),
            false => text.to_owned(),
        };
        let shown: Vec<Option<String>> = texts.iter().map(|text| text.map(shown)).collect();
        frame.with_column(Series::new(name.as_str().into(), shown).into_column())?;
    }
    Ok(frame)
}

pub(crate) fn parquet(pieces: Pieces<'_>, out: &mut impl Write) -> PolarsResult<()> {
    let mut pieces = pieces.peekable();
    let schema = match pieces.peek() {
        Some(Ok(first)) => first.schema().clone(),
        // A piece that cannot be made says so below.
        Some(Err(_)) | None => Default::default(),
    };
    // What every reader can read matters more than the size.
    let mut writer = ParquetWriter::new(out)
        .with_compression(ParquetCompression::Uncompressed)
        .batched(&schema)?;
    for piece in pieces {
        writer.write_batch(&piece?)?;
    }
    writer.finish()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use polars::prelude::{ParquetReader, SerReader};

    use super::*;

    fn pieces() -> Pieces<'static> {
        let piece = |from: u32| df!["window" => [from, from + 1], "unlike" => [None, Some("rate")]];
        Box::new([1, 3, 5].into_iter().map(piece))
    }

    #[test]
    fn no_text_is_a_formula_of_a_spreadsheet() {
        let texts = ["=HYPERLINK(\"http://evil\")", "+1", "-1+1", "@SUM(1)", "x86_64"];
        let piece = df!["hardware" => texts, "shift" => [-1.0, 0.0, 1.0, 2.0, 3.0]];
        let mut csv_text = Vec::new();
        csv(Box::new(iter::once(piece)), &mut csv_text).unwrap();
        let csv_text = String::from_utf8(csv_text).unwrap();
        let begins: Vec<&str> = csv_text
            .lines()
            .skip(1)
            .map(|line| line.trim_start_matches('"'))
            .collect();
        assert!(
            begins[..4].iter().all(|line| line.starts_with('\'')),
            "{csv_text}"
        );
        assert!(
            csv_text.contains(",-1.0\n") && begins[4].starts_with("x86_64"),
            "{csv_text}"
        );
    }

    #[test]
    fn pieces_are_one_table() {
        let mut text = Vec::new();
        csv(pieces(), &mut text).unwrap();
        assert_eq!(
            String::from_utf8(text).unwrap(),
            "window,unlike\n1,\n2,rate\n3,\n4,rate\n5,\n6,rate\n"
        );
        let mut bytes = Vec::new();
        parquet(pieces(), &mut bytes).unwrap();
        let read = ParquetReader::new(Cursor::new(bytes)).finish().unwrap();
        let windows: Vec<u32> = read
            .column("window")
            .unwrap()
            .u32()
            .unwrap()
            .into_no_null_iter()
            .collect();
        assert_eq!(windows, [1, 2, 3, 4, 5, 6]);
    }

    #[test]
    fn a_table_without_rows_has_its_columns() {
        let empty = || -> Pieces<'static> { Box::new(iter::once(df!["window" => [0_u32; 0]])) };
        let (mut text, mut bytes) = (Vec::new(), Vec::new());
        csv(empty(), &mut text).unwrap();
        parquet(empty(), &mut bytes).unwrap();
        assert_eq!(text, b"window\n");
        let read = ParquetReader::new(Cursor::new(bytes)).finish().unwrap();
        assert_eq!(read.shape(), (0, 1));
    }
}
