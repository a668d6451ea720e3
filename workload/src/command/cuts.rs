//! A command that lasts for all windows of an environment: its metrics' files grow, and each window has the rows that were added in
//! its time. The main type is [`Cuts`].

use std::{
    fs::File,
    io::{self, BufRead as _, BufReader, Read, Seek as _, SeekFrom, Write as _},
    path::{Path, PathBuf},
};

use record::experiment::CommandExperiment;

use super::collection::open_below;

/// How far each of the metrics' files was cut.
#[derive(Debug)]
pub struct Cuts {
    output: PathBuf,
    files: Vec<Growing>,
}

/// A file that a command adds rows to.
#[derive(Debug)]
struct Growing {
    name: String,
    /// Whether its first line names columns; each window's file then begins with it.
    has_header: bool,
    header: Vec<u8>,
    /// Up to where it has been taken.
    taken: u64,
}

/// Up to where a file is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UpTo {
    /// The end of its last whole line: the command may be in the middle of the next.
    LastLine,
    /// Its end: the command has ended.
    End,
}

impl Cuts {
    /// None of the files has been cut yet.
    #[must_use]
    pub fn begin(experiment: &CommandExperiment, output: &Path) -> Self {
        let growing = |name: &str| Growing {
            name: name.to_owned(),
            has_header: experiment
                .metrics
                .iter()
                .any(|it| it.from == name && it.column.is_some()),
            header: Vec::new(),
            taken: 0,
        };
        Self {
            output: output.to_owned(),
            files: experiment.measured_files().into_iter().map(growing).collect(),
        }
    }

    /// Moves what was added to the files since the last cut into files of the same names in `window`; what is wrong with those that
    /// it cannot be done of.
    ///
    /// # Errors
    /// If the window's files cannot be written.
    pub fn cut(&mut self, window: &Path, up_to: UpTo) -> io::Result<Vec<String>> {
        let mut wrong = Vec::new();
        for file in &mut self.files {
            wrong.extend(file.cut(&self.output, window, up_to)?);
        }
        Ok(wrong)
    }
}

impl Growing {
    fn cut(&mut self, output: &Path, window: &Path, up_to: UpTo) -> io::Result<Option<String>> {
        let mut file = match open_below(output, &self.name)? {
            Ok(file) => file,
            Err(why) => return Ok(Some(why)),
        };
        let length = file.metadata()?.len();
        if length < self.taken {
            let (name, taken) = (&self.name, self.taken);
            return Ok(Some(format!(
                "`{name}` became shorter: it had {taken} bytes, and has {length}"
            )));
        }
        if self.has_header && self.header.is_empty() {
            let mut line = Vec::new();
            BufReader::new((&mut file).take(CommandExperiment::LONGEST_LINE)).read_until(b'\n', &mut line)?;
            if line.last() != Some(&b'\n') {
                return Ok(Some(format!(
                    "`{}` has no first line that names columns",
                    self.name
                )));
            }
            self.taken = line.len() as u64;
            self.header = line;
        }
        if length - self.taken > CommandExperiment::LONGEST_FILE {
            let added = length - self.taken;
            self.taken = length;
            return Ok(Some(format!(
                "{added} bytes were added to `{}`, more than {}",
                self.name,
                CommandExperiment::LONGEST_FILE
            )));
        }
        let added = match up_to {
            UpTo::End => length - self.taken,
            UpTo::LastLine => whole_lines(&mut file, self.taken, length)?,
        };
        let mut to = File::create_new(window.join(&self.name))?;
        to.write_all(&self.header)?;
        file.seek(SeekFrom::Start(self.taken))?;
        io::copy(&mut file.take(added), &mut to)?;
        self.taken += added;
        Ok(None)
    }
}

/// How many bytes of a file from there on are whole lines.
fn whole_lines(file: &mut File, from: u64, length: u64) -> io::Result<u64> {
    const PART: u64 = 64 << 10;
    let mut end = length;
    let mut buffer = Vec::new();
    while end > from {
        let begin = end.saturating_sub(PART).max(from);
        file.seek(SeekFrom::Start(begin))?;
        buffer.clear();
        Read::take(&mut *file, end - begin).read_to_end(&mut buffer)?;
        if let Some(at) = buffer.iter().rposition(|byte| *byte == b'\n') {
            return Ok(begin + at as u64 + 1 - from);
        }
        end = begin;
    }
    Ok(0)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use serde_json::json;
    use tempfile::TempDir;

    use super::*;

    struct Place {
        output: TempDir,
        windows: TempDir,
        cuts: Cuts,
        count: u32,
    }

    impl Place {
        fn new(column: Option<&str>) -> Self {
            let experiment = serde_json::from_value(json!({
                "name": "e", "run": ["true"], "metrics": [{"name": "m", "from": "m.csv", "column": column}],
            }))
            .unwrap();
            let output = tempfile::tempdir().unwrap();
            Self {
                cuts: Cuts::begin(&experiment, output.path()),
                output,
                windows: tempfile::tempdir().unwrap(),
                count: 0,
            }
        }

        fn add(&self, text: &str) {
            let path = self.output.path().join("m.csv");
            let mut file = fs::OpenOptions::new()
                .create(true)
                .append(true)
                .open(path)
                .unwrap();
            file.write_all(text.as_bytes()).unwrap();
        }

        fn cut(&mut self, up_to: UpTo) -> Result<String, Vec<String>> {
            self.count += 1;
            let window = self.windows.path().join(self.count.to_string());
            fs::create_dir(&window).unwrap();
            let wrong = self.cuts.cut(&window, up_to).unwrap();
            match wrong.is_empty() {
                true => Ok(fs::read_to_string(window.join("m.csv")).unwrap()),
                false => Err(wrong),
            }
        }
    }

    #[test]
    fn each_window_has_the_lines_that_were_whole_by_its_end_below_the_names_of_the_columns() {
        let mut place = Place::new(Some("x"));
        place.add("x,y\n1,2\n3,");
        assert_eq!(place.cut(UpTo::LastLine).unwrap(), "x,y\n1,2\n");
        assert_eq!(place.cut(UpTo::LastLine).unwrap(), "x,y\n");
        place.add("4\n5,6\n7,8");
        assert_eq!(place.cut(UpTo::LastLine).unwrap(), "x,y\n3,4\n5,6\n");
        assert_eq!(place.cut(UpTo::End).unwrap(), "x,y\n7,8");
    }

    #[test]
    fn without_columns_there_is_no_first_line_to_repeat() {
        let mut place = Place::new(None);
        place.add("1\n2\n");
        assert_eq!(place.cut(UpTo::LastLine).unwrap(), "1\n2\n");
        // Longer than what is read at once, without an end of a line.
        place.add(&"3".repeat(200_000));
        assert_eq!(place.cut(UpTo::LastLine).unwrap(), "");
        place.add("\n4");
        assert_eq!(place.cut(UpTo::LastLine).unwrap().len(), 200_001);
    }

    #[test]
    fn what_cannot_be_cut_is_told() {
        let mut place = Place::new(Some("x"));
        assert_eq!(
            place.cut(UpTo::LastLine).unwrap_err(),
            ["the command wrote no `m.csv`"]
        );
        place.add("x");
        assert_eq!(
            place.cut(UpTo::LastLine).unwrap_err(),
            ["`m.csv` has no first line that names columns"]
        );
        place.add("\n1\n");
        assert_eq!(place.cut(UpTo::LastLine).unwrap(), "x\n1\n");
        fs::write(place.output.path().join("m.csv"), "x\n").unwrap();
        assert_eq!(
            place.cut(UpTo::LastLine).unwrap_err(),
            ["`m.csv` became shorter: it had 4 bytes, and has 2"]
        );
    }
}
