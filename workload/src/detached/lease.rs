//! `lease`: one user at a time on a host, as long as its connection lives. The function is [`lease`].
//!
//! A lease is an advisory lock (`flock(2)`) on a file that says who holds it. The kernel releases it when its holder dies,
//! and its holder dies when its standard input ends or stays silent, so that no lease is left behind by a cut cable.
//!
//! One who comes back with the same token ends its older self and takes over, though others may have queued meanwhile:
//! while it does, it holds a record lock (`fcntl(2)`) on the same file, and whoever gets the lease then gives it back and
//! waits for the end of that.

use std::{
    fs::File,
    io::{self, Write as _},
    os::unix::fs::FileExt as _,
    path::Path,
    sync::mpsc::{self, Sender},
    thread,
    time::Duration,
};

use record::detached::{LeaseAnswer, LeaseRequest};
use rustix::{
    event::{PollFd, PollFlags},
    fs::{FlockOperation, Mode, OFlags, fchmod, fcntl_lock, flock},
    io::Errno,
};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{DetachedError, descriptor, process, stream};

/// What the file of a lease says, and the line of who asks for one.
const MOST: usize = 16 << 10;
/// How long the older holder may take to end when it is asked to.
const TIMEOUT: Duration = Duration::from_secs(5);
const LOCK: &str = "lock the lease";
const LISTEN: &str = "read standard input";

/// The file's content. The holder's own words come first, as others have always written and read them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Held {
    #[serde(flatten)]
    holder: Map<String, Value>,
    /// None of one that was not taken by this program.
    #[serde(default, rename = "lease-token", skip_serializing_if = "Option::is_none")]
    token: Option<String>,
    #[serde(default, rename = "lease-process", skip_serializing_if = "Option::is_none")]
    process: Option<u32>,
}

/// What happens to one who asks.
pub enum Event {
    Held(Option<Map<String, Value>>),
    Granted(File),
    Failed(DetachedError),
    Over(Result<(), DetachedError>),
}

/// Asks for the lease of that file and holds it until standard input ends.
///
/// # Errors
/// When the file cannot be opened or locked, or nothing comes on standard input for `beat`.
pub fn lease(path: &Path, beat: Duration) -> Result<(), DetachedError> {
    let request = request(beat)?;
    let (tell, told) = mpsc::channel();
    let taker = {
        let (tell, path) = (tell.clone(), path.to_owned());
        move || {
            let event = take(&path, &request, &tell).map_or_else(Event::Failed, Event::Granted);
            let _ = tell.send(event);
        }
    };
    let listener = move || {
        let _ = tell.send(Event::Over(listen(beat)));
    };
    // Both may wait in the kernel for ever: they end with this process.
    spawn("lease", taker)?;
    spawn("beat", listener)?;
    let mut held = None;
    for event in told {
        match event {
            Event::Held(holder) => answer(&LeaseAnswer::Held { held: holder })?,
            Event::Granted(file) => {
                held = Some(file);
                answer(&LeaseAnswer::Granted { granted: true })?;
            }
            Event::Failed(error) => return Err(error),
            Event::Over(how) => {
                drop(held);
                return how;
            }
        }
    }
    Ok(())
}

fn spawn(name: &str, work: impl FnOnce() + Send + 'static) -> Result<(), DetachedError> {
    let thread = thread::Builder::new().name(name.to_owned()).spawn(work);
    thread.map(drop).map_err(DetachedError::system("start a thread"))
}

fn answer(answer: &LeaseAnswer) -> Result<(), DetachedError> {
    stream::write_line(&mut io::stdout(), answer).map_err(DetachedError::system("answer"))
}

/// Standard input's first line. What comes after it is only there to come.
fn request(beat: Duration) -> Result<LeaseRequest, DetachedError> {
    let mut text = Vec::new();
    while !text.contains(&b'\n') && text.len() <= MOST {
        let piece = heard(beat)?;
        if piece.is_empty() {
            break;
        }
        text.extend(piece);
    }
    let line = text.split(|byte| *byte == b'\n').next().unwrap_or_default();
    if line.len() > MOST {
        return Err(DetachedError::TooLong { most: MOST as u64 });
    }
    serde_json::from_slice(line).map_err(|source| DetachedError::Input {
        what: "a token and a holder",
        source,
    })
}

/// Returns when standard input has ended.
fn listen(beat: Duration) -> Result<(), DetachedError> {
    while !heard(beat)?.is_empty() {}
    Ok(())
}

/// What comes next; empty at the end.
fn heard(beat: Duration) -> Result<Vec<u8>, DetachedError> {
    let input = io::stdin();
    let mut descriptors = [PollFd::new(&input, PollFlags::IN)];
    match descriptor::wait(&mut descriptors, Some(beat)) {
        Ok(true) => {}
        Ok(false) => return Err(DetachedError::Silent { after: beat }),
        Err(error) => return Err(DetachedError::system(LISTEN)(error)),
    }
    let mut piece = [0_u8; 4096];
    // Not through the standard library's buffer, in which what has come would be hidden from the kernel.
    let read = rustix::io::read(&input, &mut piece).map_err(DetachedError::system(LISTEN))?;
    Ok(piece.get(..read).unwrap_or_default().to_vec())
}

/// Waits for the lease; says who holds it, if it is held. Nobody else may open the file in this process: closing it once
/// would release the record lock.
///
/// # Errors
/// When the file cannot be opened or locked.
pub fn take(path: &Path, request: &LeaseRequest, tell: &Sender<Event>) -> Result<File, DetachedError> {
    let mut file = open(path).map_err(DetachedError::file("open", path))?;
    let mut told = false;
    loop {
        if !try_lock(&file)? {
            let held = read(&file);
            if is_of(held.as_ref(), request) && take_over(&file, path, request)? {
                break;
            }
            if !told {
                let _ = tell.send(Event::Held(held.map(|held| held.holder)));
                told = true;
            }
            lock(&file)?;
        }
        // Held only to see whether another does.
        if let Some(seen) = claim(&file, FlockOperation::NonBlockingLockExclusive)? {
            drop(seen);
            break;
        }
        flock(&file, FlockOperation::Unlock).map_err(DetachedError::system(LOCK))?;
        drop(claim(&file, FlockOperation::LockExclusive)?);
    }
    write(&mut file, request).map_err(DetachedError::file("write", path))?;
    Ok(file)
}

/// Ends the older holder with the same token and gets the lease before any other. Whether it did: no, if that holder is
/// not a process of ours, or no longer the one.
fn take_over(file: &File, path: &Path, request: &LeaseRequest) -> Result<bool, DetachedError> {
    let _claim = claim(file, FlockOperation::LockExclusive)?;
    let held = read(file).filter(|held| is_of(Some(held), request));
    let Some(pid) = held.and_then(|held| held.process) else {
        return Ok(false);
    };
    if let Some(holder) = process::leaseholder(pid, path)? {
        holder.ask_to_end()?;
        if !holder.wait(TIMEOUT)? {
            holder.kill()?;
        }
        lock(file)?;
        return Ok(true);
    }
    // It has ended since, or says that it is another.
    try_lock(file)
}

fn is_of(held: Option<&Held>, request: &LeaseRequest) -> bool {
    held.is_some_and(|held| held.token.as_ref() == Some(&request.token))
}

fn lock(file: &File) -> Result<(), DetachedError> {
    retry(|| flock(file, FlockOperation::LockExclusive)).map_err(DetachedError::system(LOCK))
}

fn try_lock(file: &File) -> Result<bool, DetachedError> {
    match flock(file, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => Ok(true),
        Err(Errno::WOULDBLOCK) => Ok(false),
        Err(error) => Err(DetachedError::system(LOCK)(error)),
    }
}

/// The record lock of one who comes back, until it is dropped.
struct Claim<'a>(&'a File);

impl Drop for Claim<'_> {
    fn drop(&mut self) {
        // Of a lock that is held it does not fail; and it ends with the process at the latest.
        let _ = fcntl_lock(self.0, FlockOperation::Unlock);
    }
}

/// None if another has it, and it was not to be waited for.
fn claim(file: &File, how: FlockOperation) -> Result<Option<Claim<'_>>, DetachedError> {
    match retry(|| fcntl_lock(file, how)) {
        Ok(()) => Ok(Some(Claim(file))),
        Err(Errno::AGAIN | Errno::ACCESS) => Ok(None),
        Err(error) => Err(DetachedError::system(LOCK)(error)),
    }
}

fn retry(call: impl Fn() -> Result<(), Errno>) -> Result<(), Errno> {
    loop {
        match call() {
            Err(Errno::INTR) => {}
            done => return done,
        }
    }
}

/// Opens without creating first: in a sticky folder the kernel refuses to "create" a file that another user made
/// (`fs.protected_regular`), even if it is open to all.
fn open(path: &Path) -> io::Result<File> {
    let flags = OFlags::RDWR | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let all = Mode::from_raw_mode(0o666);
    let opened = loop {
        match rustix::fs::open(path, flags, Mode::empty()) {
            Err(Errno::NOENT) => match rustix::fs::open(path, flags | OFlags::CREATE | OFlags::EXCL, all) {
                // Another has made it in between.
                Err(Errno::EXIST) => {}
                made => {
                    let made = made?;
                    // Whatever our mask is.
                    fchmod(&made, all)?;
                    break made;
                }
            },
            opened => break opened?,
        }
    };
    let file = File::from(opened);
    match file.metadata()?.is_file() {
        true => Ok(file),
        false => Err(io::Error::other("it is not a regular file")),
    }
}

/// None where nobody has written, or something else. Anybody may write there.
fn read(file: &File) -> Option<Held> {
    let mut text = vec![0; MOST + 4096];
    let length = file.read_at(&mut text, 0).ok()?;
    serde_json::from_slice(text.get(..length)?).ok()
}

fn write(file: &mut File, request: &LeaseRequest) -> io::Result<()> {
    let held = Held {
        holder: request.holder.clone(),
        token: Some(request.token.clone()),
        process: Some(std::process::id()),
    };
    let text = serde_json::to_vec(&held)?;
    file.set_len(0)?;
    file.write_all_at(&text, 0)?;
    file.flush()
}
