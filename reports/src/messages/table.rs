//! The rows of the table of messages, written as they come: CSV and Parquet, by polars, a piece at a time, so that the
//! memory is that of a piece. The main type is [`MessageTable`].

use std::{
    fs::File,
    io::{self, BufWriter},
    path::PathBuf,
};

use captures::packets::Topic;
use polars::{
    df,
    error::{PolarsError, PolarsResult},
    frame::DataFrame,
    io::{csv::write::BatchedWriter as CsvPieces, parquet::write::BatchedWriter as ParquetPieces},
    prelude::{CsvWriter, ParquetCompression, ParquetWriter, SerWriter},
};
use record::run_directory::{Place, Unfinished};

use super::{exchange::Ports, frames::Label};

/// Rows that are gathered before they are written; also a row group of the Parquet file.
const PIECE: usize = 1 << 16;

/// One message's way. Times are nanoseconds on the experiment's clock.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct MessageRow {
    /// The window that it was sent in.
    pub window: u32,
    /// Its connection, and with it the topic.
    pub ports: Ports,
    /// Its number, and when its publisher's step began.
    pub label: Label,
    pub wire_out_ns: Option<i64>,
    pub wire_in_ns: Option<i64>,
    pub in_order_ns: Option<i64>,
    pub received_ns: Option<i64>,
    pub one_way_ns: Option<i64>,
    pub retransmissions: u32,
    pub duplicates: u32,
    pub reordered: bool,
    pub logged: bool,
}

/// A table could not be written.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// The operating system refused.
    #[error("{} cannot be written", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// polars could not write it.
    #[error("{} cannot be written", path.display())]
    Columns {
        /// The file.
        path: PathBuf,
        /// Polars' error.
        source: PolarsError,
    },
}

/// Two files under names that are not theirs until they are whole.
pub(super) struct MessageTable {
    csv: (Place, Unfinished),
    parquet: (Place, Unfinished),
    to_csv: CsvPieces<BufWriter<File>>,
    to_parquet: ParquetPieces<BufWriter<File>>,
    rows: Vec<MessageRow>,
}

impl MessageTable {
    /// Begins `<stem>.csv` and `<stem>.parquet` in a folder, which is made if it is not there.
    pub fn create(folder: &Place, stem: &str) -> Result<Self, TableError> {
        folder.make_folder().map_err(refused(folder))?;
        let [csv, parquet] = ["csv", "parquet"].map(|extension| folder.join(format!("{stem}.{extension}")));
        let (unfinished_csv, csv_file) = csv.begin().map_err(refused(&csv))?;
        let (unfinished_parquet, parquet_file) = parquet.begin().map_err(refused(&parquet))?;
        let schema = frame(&[]).map_err(failed(&csv))?.schema().clone();
        let to_csv = CsvWriter::new(csv_file).batched(&schema).map_err(failed(&csv))?;
        // Some 100 bytes a message: worth compressing, in a way that every reader knows.
        let to_parquet = ParquetWriter::new(parquet_file)
            .with_compression(ParquetCompression::Zstd(None))
            .batched(&schema)
            .map_err(failed(&parquet))?;
        Ok(Self {
            csv: (csv, unfinished_csv),
            parquet: (parquet, unfinished_parquet),
            to_csv,
            to_parquet,
            rows: Vec::with_capacity(PIECE),
        })
    }

    /// Adds a row.
    pub fn push(&mut self, row: MessageRow) -> Result<(), TableError> {
        self.rows.push(row);
        if self.rows.len() == PIECE {
            self.write_piece()?;
        }
        Ok(())
    }

    /// Completes both files, and says where they are.
    pub fn finish(mut self) -> Result<[PathBuf; 2], TableError> {
        self.write_piece()?;
        let Self {
            csv,
            parquet,
            mut to_csv,
            to_parquet,
            ..
        } = self;
        to_csv.finish().map_err(failed(&csv.0))?;
        to_parquet.finish().map_err(failed(&parquet.0))?;
        // What is still buffered is written when the writers go.
        drop((to_csv, to_parquet));
        let finish = |(place, unfinished): (Place, Unfinished)| unfinished.finish().map_err(refused(&place));
        Ok([finish(csv)?.path(), finish(parquet)?.path()])
    }

    fn write_piece(&mut self) -> Result<(), TableError> {
        if self.rows.is_empty() {
            return Ok(());
        }
        let frame = frame(&self.rows).map_err(failed(&self.csv.0))?;
        self.rows.clear();
        self.to_csv.write_batch(&frame).map_err(failed(&self.csv.0))?;
        self.to_parquet
            .write_batch(&frame)
            .map_err(failed(&self.parquet.0))
    }
}

fn refused(place: &Place) -> impl FnOnce(io::Error) -> TableError + use<> {
    let path = place.path();
    |source| TableError::Io { path, source }
}

fn failed(place: &Place) -> impl FnOnce(PolarsError) -> TableError + use<> {
    let path = place.path();
    |source| TableError::Columns { path, source }
}

fn frame(rows: &[MessageRow]) -> PolarsResult<DataFrame> {
    fn column<'a, T>(rows: &'a [MessageRow], of: impl Fn(&'a MessageRow) -> T) -> Vec<T> {
        rows.iter().map(of).collect()
    }
    df![
        "window" => column(rows, |row| row.window),
        "topic" => column(rows, |row| Topic::name(row.ports.topic)),
        "sender_port" => column(rows, |row| u32::from(row.ports.from)),
        "receiver_port" => column(rows, |row| u32::from(row.ports.to)),
        "seq" => column(rows, |row| row.label.seq),
        "sent_ns" => column(rows, |row| row.label.stamp_ns),
        "wire_out_ns" => column(rows, |row| row.wire_out_ns),
        "wire_in_ns" => column(rows, |row| row.wire_in_ns),
        "in_order_ns" => column(rows, |row| row.in_order_ns),
        "received_ns" => column(rows, |row| row.received_ns),
        "one_way_ns" => column(rows, |row| row.one_way_ns),
        "retransmissions" => column(rows, |row| row.retransmissions),
        "duplicates" => column(rows, |row| row.duplicates),
        "reordered" => column(rows, |row| row.reordered),
        "logged" => column(rows, |row| row.logged),
    ]
}
