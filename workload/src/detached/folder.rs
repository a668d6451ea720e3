//! The folder of an environment that has no platform to keep its things. The main type is [`EnvironmentFolder`].
//!
//! ```text
//! <root>/<environment>/
//!   owner.json    what it belongs to: Owner
//!   settings.json what a job's workload is to do
//!   container.json the container that a job's workload runs in: JobContainer
//!   engine.json   the engine that has it: EngineRecord
//!   job.json      the job that its workload runs in: JobRecord
//!   job.txt       what the batch system writes of that job
//!   lines.jsonl   the workload's standard output
//!   errors.txt    its standard error
//!   ended.json    how it ended: Ended
//!   data/         its data folder
//!   work/         where the commands of a user's experiment run, with their files
//! ```

use std::{
    fs::{self, File},
    io::{self, Read as _},
    path::{Path, PathBuf},
    process,
};

use record::{
    call::Folders,
    detached::{Ended, EngineRecord, JobContainer, JobRecord, Owner, UNFINISHED},
    layout,
    name::is_name,
    settings::Settings,
};
use rustix::fs::{Mode, OFlags};
use serde::{Serialize, de::DeserializeOwned};

use super::DetachedError;
use crate::removal::remove_all;

/// The folder. It only knows names; whether it is there is another question.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EnvironmentFolder {
    root: PathBuf,
    environment: String,
}

/// Our own records are a few hundred bytes.
const LONGEST_RECORD: u64 = 1 << 20;

impl EnvironmentFolder {
    /// That of the environment of that name.
    ///
    /// # Errors
    /// When that is not a safe name, or the root is not absolute.
    pub fn of(root: &Path, environment: &str) -> Result<Self, DetachedError> {
        look_absolute(root)?;
        if !is_name(environment) {
            return Err(DetachedError::Name {
                name: environment.to_owned(),
            });
        }
        Ok(Self {
            // One spelling, since processes are found by it.
            root: fs::canonicalize(root).unwrap_or_else(|_| root.to_owned()),
            environment: environment.to_owned(),
        })
    }

    /// Every one below the root, by name. Others' things are left out; a root that is not there has none.
    ///
    /// # Errors
    /// When the root is not absolute or cannot be read.
    pub fn all(root: &Path) -> Result<Vec<Self>, DetachedError> {
        let mut all = Vec::new();
        look_absolute(root)?;
        let entries = match fs::read_dir(root) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(all),
            entries => entries.map_err(DetachedError::file("read", root))?,
        };
        for entry in entries {
            let entry = entry.map_err(DetachedError::file("read", root))?;
            let name = entry.file_name();
            let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
            if let Some(name) = name.to_str().filter(|name| is_folder && is_name(name)) {
                all.push(Self::of(root, name)?);
            }
        }
        all.sort_by(|a, b| a.environment.cmp(&b.environment));
        Ok(all)
    }

    /// The folder that has it.
    #[must_use]
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The environment's name.
    #[must_use]
    pub fn environment(&self) -> &str {
        &self.environment
    }

    /// The folder itself.
    #[must_use]
    pub fn path(&self) -> PathBuf {
        self.root.join(&self.environment)
    }

    /// The workload's standard output.
    #[must_use]
    pub fn lines(&self) -> PathBuf {
        self.path().join(layout::LINES)
    }

    /// Its standard error.
    #[must_use]
    pub fn errors(&self) -> PathBuf {
        self.path().join("errors.txt")
    }

    /// Its data folder.
    #[must_use]
    pub fn data(&self) -> PathBuf {
        self.path().join("data")
    }

    /// The folders that its workload is given.
    #[must_use]
    pub fn folders(&self) -> Folders {
        Folders {
            data: self.data(),
            work: self.path().join("work"),
        }
    }

    /// What the batch system writes of the job that its workload runs in.
    #[must_use]
    pub fn job_output(&self) -> PathBuf {
        self.path().join(layout::JOB_OUTPUT)
    }

    fn settings_file(&self) -> PathBuf {
        self.path().join("settings.json")
    }

    fn job_file(&self) -> PathBuf {
        self.path().join("job.json")
    }

    /// Keeps what a job's workload is to do.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write_settings(&self, settings: &Settings) -> Result<(), DetachedError> {
        write_record(&self.settings_file(), settings)
    }

    /// What a job's workload is to do, if the folder was prepared for a job.
    #[must_use]
    pub fn settings(&self) -> Option<Settings> {
        read_record(&self.settings_file())
    }

    fn container_file(&self) -> PathBuf {
        self.path().join("container.json")
    }

    fn engine_file(&self) -> PathBuf {
        self.path().join("engine.json")
    }

    /// Keeps what a job's workload is to run in.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write_container(&self, container: &JobContainer) -> Result<(), DetachedError> {
        write_record(&self.container_file(), container)
    }

    /// The container that a job's workload is to run in, if it is to run in one. Where there is a file that cannot be read, the
    /// workload must not run beside it.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn container(&self) -> Result<Option<JobContainer>, DetachedError> {
        let path = self.container_file();
        match fs::symlink_metadata(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(DetachedError::file("read", &path)(error)),
            Ok(_) => match read_record(&path) {
                Some(container) => Ok(Some(container)),
                None => Err(DetachedError::file("read", &path)(io::Error::other(
                    "it is no container of a job",
                ))),
            },
        }
    }

    /// Keeps what the container ran on.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write_engine(&self, engine: &EngineRecord) -> Result<(), DetachedError> {
        write_record(&self.engine_file(), engine)
    }

    /// What the container runs on, or ran on.
    #[must_use]
    pub fn engine(&self) -> Option<EngineRecord> {
        read_record(&self.engine_file())
    }

    /// The job that its workload runs in, or ran in.
    #[must_use]
    pub fn job(&self) -> Option<JobRecord> {
        read_record(&self.job_file())
    }

    /// Makes the folder that job's, for ever: of two jobs that try, one fails, wherever they run.
    ///
    /// # Errors
    /// When it is another job's, or the same job's that began before, or cannot be written.
    pub fn claim(&self, job: &JobRecord) -> Result<(), DetachedError> {
        let path = self.job_file();
        let unfinished = path.with_extension(format!("json.{}.{}", job.job, process::id()));
        write_record(&unfinished, job)?;
        // A link is made once, also on NFS, where a file that is to be made exclusively was not always.
        let linked = fs::hard_link(&unfinished, &path);
        fs::remove_file(&unfinished).map_err(DetachedError::file("remove", &unfinished))?;
        linked.map_err(|error| match (error.kind(), self.job()) {
            (io::ErrorKind::AlreadyExists, Some(first)) => DetachedError::Claimed {
                environment: self.environment.clone(),
                job: first.job,
                node: first.node,
            },
            _ => DetachedError::file("create", &path)(error),
        })
    }

    fn ended_file(&self) -> PathBuf {
        self.path().join("ended.json")
    }

    /// What it belongs to, if that can be read.
    #[must_use]
    pub fn owner(&self) -> Option<Owner> {
        read_record(&self.path().join(layout::OWNER))
    }

    /// How its workload ended, if that was seen.
    #[must_use]
    pub fn ended(&self) -> Option<Ended> {
        read_record(&self.ended_file())
    }

    /// Writes down how its workload ended, whole or not at all.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write_ended(&self, ended: Ended) -> Result<(), DetachedError> {
        let path = self.ended_file();
        let unfinished = path.with_extension("json.new");
        write_record(&unfinished, &ended)?;
        fs::rename(&unfinished, &path).map_err(DetachedError::file("write", &path))
    }

    /// Fails if it is not there, and does not follow a link that has its name.
    ///
    /// # Errors
    /// So, or when it cannot be looked at.
    pub fn look(&self) -> Result<(), DetachedError> {
        match fs::symlink_metadata(self.path()) {
            Ok(found) if found.is_dir() => Ok(()),
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                Err(DetachedError::file("read", &self.path())(error))
            }
            _ => Err(DetachedError::Missing {
                name: self.environment.clone(),
                root: self.root.clone(),
            }),
        }
    }

    /// Makes the folder, with its owner in it, and never in place of another.
    ///
    /// # Errors
    /// When there is one of that name already, or it cannot be made.
    pub fn create(&self, owner: &Owner) -> Result<Self, DetachedError> {
        let Self { root, environment } = self;
        fs::create_dir_all(root).map_err(DetachedError::file("create", root))?;
        // Its root has its one spelling only now that it is there.
        let folder = Self::of(root, environment)?;
        // Made beside its place and moved there, so that a folder without its owner is never seen by others. Each process
        // has its own, so that of two with one name the later does not break the earlier.
        let unfinished = Self::of(root, &format!("{environment}.{}{UNFINISHED}", process::id()))?;
        let made = unfinished
            .fill(owner)
            .and_then(|()| folder.replace_nothing(&unfinished));
        if made.is_err() {
            unfinished.remove()?;
        }
        made.map(|()| folder)
    }

    fn fill(&self, owner: &Owner) -> Result<(), DetachedError> {
        let create = |path: PathBuf| fs::create_dir(&path).map_err(DetachedError::file("create", &path));
        create(self.path())?;
        write_record(&self.path().join(layout::OWNER), owner)?;
        create(self.data())
    }

    /// Moves a folder to this one's place.
    fn replace_nothing(&self, other: &Self) -> Result<(), DetachedError> {
        // A folder that is not empty is not replaced: ours have their owners.
        fs::rename(other.path(), self.path()).map_err(|error| match error.kind() {
            io::ErrorKind::DirectoryNotEmpty
            | io::ErrorKind::NotADirectory
            | io::ErrorKind::AlreadyExists => DetachedError::Exists {
                name: self.environment.clone(),
                root: self.root.clone(),
            },
            _ => DetachedError::file("create", &self.path())(error),
        })
    }

    /// Removes the folder with all that is in it. Whether it was there.
    ///
    /// # Errors
    /// When it cannot be removed.
    pub fn remove(&self) -> Result<bool, DetachedError> {
        // Of a link that has its name, the link alone.
        match remove_all(&self.path()) {
            Ok(()) => Ok(true),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
            Err(error) => Err(DetachedError::file("remove", &self.path())(error)),
        }
    }
}

/// A relative root would mean something else to the supervisor, which works in `/`.
fn look_absolute(root: &Path) -> Result<(), DetachedError> {
    match root.is_absolute() {
        true => Ok(()),
        false => Err(DetachedError::Root {
            root: root.to_owned(),
        }),
    }
}

/// Opens a regular file for reading, not through a link: that could have been put there since.
///
/// # Errors
/// When there is none.
pub fn open(path: &Path) -> io::Result<File> {
    let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let file = File::from(rustix::fs::open(path, flags, Mode::empty())?);
    match file.metadata()?.is_file() {
        true => Ok(file),
        false => Err(io::Error::other("it is not a regular file")),
    }
}

fn read_record<T: DeserializeOwned>(path: &Path) -> Option<T> {
    let mut text = Vec::new();
    open(path)
        .ok()?
        .take(LONGEST_RECORD)
        .read_to_end(&mut text)
        .ok()?;
    serde_json::from_slice(&text).ok()
}

fn write_record(path: &Path, record: &impl Serialize) -> Result<(), DetachedError> {
    let write = || {
        let file = File::create(path)?;
        serde_json::to_writer_pretty(&file, record)?;
        file.sync_all()
    };
    write().map_err(DetachedError::file("write", path))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn owner() -> Owner {
        Owner {
            provider: "native".to_owned(),
            run: "run".to_owned(),
            run_directory: "/runs/run".into(),
            scenario: "x86_64-debian-native".to_owned(),
            host: "here".to_owned(),
            windows: vec![1, 2],
        }
    }

    fn create(root: &Path, environment: &str) -> Result<EnvironmentFolder, DetachedError> {
        EnvironmentFolder::of(root, environment)?.create(&owner())
    }

    #[rstest::rstest]
    #[case("matrix-20260101-1-x86_64-debian-native-1", true)]
    #[case("a.b_c", true)]
    #[case("", false)]
    #[case(".", false)]
    #[case("..", false)]
    #[case(".hidden", false)]
    #[case("-option", false)]
    #[case("a/b", false)]
    #[case("a b", false)]
    #[case("a\nb", false)]
    #[case("a\0b", false)]
    #[case("ä", false)]
    fn a_name_is_one_safe_component_of_a_path(#[case] name: &str, #[case] safe: bool) {
        assert_eq!(EnvironmentFolder::of(Path::new("/s"), name).is_ok(), safe);
    }

    #[test]
    fn a_name_leaves_room_for_what_is_added_to_it() {
        let root = tempfile::tempdir().unwrap();
        assert!(create(root.path(), &"a".repeat(200)).is_ok());
        let longer = create(root.path(), &"a".repeat(230));
        assert!(matches!(longer, Err(DetachedError::Name { .. })));
        assert_eq!(EnvironmentFolder::all(root.path()).unwrap().len(), 1);
    }

    #[test]
    fn a_root_must_not_depend_on_the_working_directory() {
        let wrong = EnvironmentFolder::of(Path::new("environments"), "e").unwrap_err();
        assert!(wrong.is_of_call() && wrong.hint().is_some(), "{wrong}");
    }

    #[test]
    fn a_folder_is_made_whole_and_never_in_place_of_another() {
        let root = tempfile::tempdir().unwrap();
        let folder = create(root.path(), "e-1").unwrap();
        assert_eq!(folder.owner(), Some(owner()));
        assert!(folder.data().is_dir());
        let again = create(root.path(), "e-1").unwrap_err();
        assert!(matches!(again, DetachedError::Exists { .. }), "{again}");
        assert_eq!(
            EnvironmentFolder::all(root.path()).unwrap(),
            std::slice::from_ref(&folder)
        );
        assert!(folder.remove().unwrap());
        assert!(!folder.remove().unwrap());
    }

    #[test]
    fn an_end_is_written_and_read() {
        let root = tempfile::tempdir().unwrap();
        let folder = create(root.path(), "e-1").unwrap();
        assert_eq!(folder.ended(), None);
        folder.write_ended(Ended::Signal(9)).unwrap();
        assert_eq!(folder.ended(), Some(Ended::Signal(9)));
        let text = fs::read_to_string(folder.ended_file()).unwrap();
        assert_eq!(text.split_whitespace().collect::<String>(), r#"{"signal":9}"#);
    }

    #[test]
    fn a_folder_is_one_jobs_for_ever() {
        let root = tempfile::tempdir().unwrap();
        let folder = create(root.path(), "e-1").unwrap();
        let job = |job: &str, node: &str| JobRecord {
            job: job.to_owned(),
            node: node.to_owned(),
        };
        assert_eq!(folder.job(), None);
        folder.claim(&job("17", "n1")).unwrap();
        // The batch system began it anew, with the same number, while the first may go on.
        for second in [job("17", "n2"), job("18", "n1")] {
            let error = folder.claim(&second).unwrap_err();
            assert!(
                matches!(&error, DetachedError::Claimed { job, node, .. } if job == "17" && node == "n1"),
                "{error}"
            );
        }
        assert_eq!(folder.job(), Some(job("17", "n1")));
        let files = fs::read_dir(folder.path()).unwrap().count();
        assert_eq!(
            files, 3,
            "the owner, the data and the job, and nothing unfinished"
        );
    }

    #[test]
    fn a_link_is_no_environment_and_removing_it_leaves_what_it_leads_to() {
        let (root, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        fs::write(elsewhere.path().join("owner.json"), "{}").unwrap();
        std::os::unix::fs::symlink(elsewhere.path(), root.path().join("e-1")).unwrap();
        let folder = EnvironmentFolder::of(root.path(), "e-1").unwrap();
        assert!(matches!(folder.look(), Err(DetachedError::Missing { .. })));
        assert_eq!(EnvironmentFolder::all(root.path()).unwrap(), []);
        assert!(folder.remove().unwrap());
        assert!(elsewhere.path().join("owner.json").exists());
    }
}
