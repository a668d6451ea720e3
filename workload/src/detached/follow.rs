//! `follow`: passes the workload's lines on as they come, woken by the kernel (inotify(7)). The function is [`follow`].

use std::{
    fs::File,
    io::{self, Read as _, Seek as _, SeekFrom, Write as _},
    os::fd::OwnedFd,
};

use rustix::{
    event::{PollFd, PollFlags},
    fs::inotify::{self, CreateFlags, WatchFlags},
    io::Errno,
};

use super::{
    DetachedError, EnvironmentFolder, descriptor, folder,
    process::{self, Process},
};

const WATCH: &str = "watch the workload's lines";

/// Copies the lines from that byte on to standard output. Returns once the workload has ended, its supervisor too, and
/// all was passed on.
///
/// # Errors
/// When there are no lines, or fewer, or when their reader goes away.
pub fn follow(folder: &EnvironmentFolder, from: u64) -> Result<(), DetachedError> {
    folder.look()?;
    let path = folder.lines();
    // Watched before it is read for the first time: no change can fall between.
    let changes =
        inotify::init(CreateFlags::NONBLOCK | CreateFlags::CLOEXEC).map_err(DetachedError::system(WATCH))?;
    inotify::add_watch(&changes, &path, WatchFlags::MODIFY | WatchFlags::DONT_FOLLOW)
        .map_err(DetachedError::file("watch", &path))?;
    let mut file = folder::open(&path).map_err(DetachedError::file("read", &path))?;
    let length = file.metadata().map_err(DetachedError::file("read", &path))?.len();
    if from > length {
        return Err(DetachedError::Beyond {
            path,
            length,
            there: from,
        });
    }
    file.seek(SeekFrom::Start(from))
        .map_err(DetachedError::file("read", &path))?;
    loop {
        // Looked for before the file is read: what was written until the end is read after it.
        let living = process::find(folder)?;
        pass_on(&mut file)?;
        if living.is_empty() {
            return Ok(());
        }
        while !wait(&changes, &living)? {
            pass_on(&mut file)?;
        }
    }
}

/// All that is there by now.
fn pass_on(file: &mut File) -> Result<(), DetachedError> {
    let mut piece = vec![0_u8; 64 << 10];
    let mut out = io::stdout().lock();
    loop {
        let read = file
            .read(&mut piece)
            .map_err(DetachedError::system("read the workload's lines"))?;
        let Some(piece) = piece.get(..read).filter(|piece| !piece.is_empty()) else {
            return Ok(());
        };
        out.write_all(piece)
            .and_then(|()| out.flush())
            .map_err(DetachedError::system("pass the workload's lines on"))?;
    }
}

/// Waits until there may be more to read. Whether one of the processes has ended.
fn wait(changes: &OwnedFd, living: &[Process]) -> Result<bool, DetachedError> {
    let out = io::stdout();
    // Of its reader's going away the kernel tells without being asked.
    let mut descriptors = vec![
        PollFd::new(&out, PollFlags::empty()),
        PollFd::new(changes, PollFlags::IN),
    ];
    descriptors.extend(living.iter().map(|process| PollFd::new(process, PollFlags::IN)));
    descriptor::wait(&mut descriptors, None).map_err(DetachedError::system(WATCH))?;
    let is_ready = |at: usize| descriptors.get(at).is_some_and(|it| !it.revents().is_empty());
    if is_ready(0) {
        let gone = io::Error::from(io::ErrorKind::BrokenPipe);
        return Err(DetachedError::system("pass the workload's lines on")(gone));
    }
    if is_ready(1) {
        forget(changes).map_err(DetachedError::system(WATCH))?;
    }
    Ok((2..descriptors.len()).any(is_ready))
}

/// Reads the changes that were told of: that there were some is all they say.
fn forget(changes: &OwnedFd) -> Result<(), Errno> {
    let mut events = [0_u8; 4096];
    loop {
        match rustix::io::read(changes, &mut events) {
            Ok(_) | Err(Errno::INTR) => {}
            Err(Errno::AGAIN) => return Ok(()),
            Err(error) => return Err(error),
        }
    }
}
