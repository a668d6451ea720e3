use std::{fs, os::unix::fs::symlink};

use super::*;

/// A file with so many zeros that take no room, and its folder.
fn sparse(bytes: u64) -> (tempfile::TempDir, Place) {
    let folder = tempfile::tempdir().unwrap();
    let place = Place::root(folder.path()).join("file");
    fs::write(place.path(), "begins well\n").unwrap();
    let file = fs::OpenOptions::new().write(true).open(place.path());
    file.unwrap().set_len(bytes).unwrap();
    (folder, place)
}

#[test]
fn a_folder_that_is_exchanged_for_a_link_is_neither_read_nor_written() {
    let folder = tempfile::tempdir().unwrap();
    let (history, victim) = (folder.path().join("history"), folder.path().join("victim"));
    fs::create_dir_all(history.join("run")).unwrap();
    fs::create_dir(&victim).unwrap();
    fs::write(victim.join("file"), "theirs").unwrap();
    let found = Place::root(&history).join("run").as_root();
    let (read_before, read_after) = (found.clone(), Place::root(&history).join("run").as_root());
    assert!(!read_before.join("file").exists());

    fs::rename(history.join("run"), history.join("moved")).unwrap();
    symlink(&victim, history.join("run")).unwrap();
    // What was opened before stays the folder that it was.
    found.join("file").write(b"mine").unwrap();
    found.join("report").make_folder().unwrap();
    assert_eq!(fs::read(history.join("moved/file")).unwrap(), b"mine");
    assert!(history.join("moved/report").is_dir());
    found.join("file").remove_file().unwrap();
    // What was not is refused.
    assert_eq!(
        read_after.ensure_root().unwrap_err().kind(),
        io::ErrorKind::NotADirectory
    );
    assert!(read_after.join("report").make_folder().is_err());
    assert_eq!(fs::read_dir(&victim).unwrap().count(), 1);
    assert_eq!(fs::read(victim.join("file")).unwrap(), b"theirs");
}

#[test]
fn a_folder_that_is_opened_anew_must_be_the_one_that_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let [run, other] = ["run", "other"].map(|name| folder.path().join(name));
    fs::create_dir(&run).unwrap();
    fs::create_dir(&other).unwrap();
    fs::write(other.join("file"), "theirs").unwrap();
    for place in [
        Place::root(&run),
        Place::root(folder.path()).join("run").as_root(),
    ] {
        let again = place.to_reopen().unwrap();
        again.to_reopen().unwrap().ensure_root().unwrap();
        fs::rename(&run, folder.path().join("moved")).unwrap();
        fs::rename(&other, &run).unwrap();
        let error = again.join("file").open().unwrap_err();
        assert!(error.to_string().contains("another folder"), "{error}");
        again.join("file").remove_file().unwrap_err();
        fs::rename(&run, &other).unwrap();
        fs::rename(folder.path().join("moved"), &run).unwrap();
        again.ensure_root().unwrap();
    }
    assert!(other.join("file").exists());
}

#[test]
fn a_root_that_a_person_named_may_be_a_link_and_may_be_made_later() {
    let folder = tempfile::tempdir().unwrap();
    let place = Place::root(folder.path().join("later/run"));
    assert_eq!(place.ensure_root().unwrap_err().kind(), io::ErrorKind::NotFound);
    place.join("a").make_folder().unwrap();
    symlink(folder.path().join("later"), folder.path().join("link")).unwrap();
    assert!(Place::root(folder.path().join("link/run")).join("a").is_folder());
    assert!(Place::root(folder.path().join("link")).join("run/a").is_folder());
}

/// Handles of this process that lead into a folder.
fn handles_into(folder: &Path) -> usize {
    let handles = fs::read_dir("/proc/self/fd").unwrap();
    let leads_there =
        |entry: &fs::DirEntry| fs::read_link(entry.path()).is_ok_and(|to| to.starts_with(folder));
    handles.flatten().filter(leads_there).count()
}

#[test]
fn a_folder_is_open_no_longer_than_it_is_looked_at() {
    let folder = tempfile::tempdir().unwrap();
    let real = folder.path().canonicalize().unwrap();
    let history = Place::root(&real);
    let mut later = Vec::new();
    for number in 0..100 {
        let run = history.join(number.to_string());
        run.make_folder().unwrap();
        let run = run.as_root();
        run.join("a").make_folder().unwrap();
        later.push(run.to_reopen().unwrap());
    }
    assert_eq!(handles_into(&real), 1);
    assert!(
        later
            .iter()
            .all(|run| run.to_reopen().unwrap().join("a").is_folder())
    );
    assert_eq!(handles_into(&real), 1);
}

#[test]
fn nothing_is_written_by_another_name_of_a_file() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("profile"), "theirs").unwrap();
    let place = Place::root(folder.path()).join("lock");
    fs::hard_link(folder.path().join("profile"), place.path()).unwrap();
    let mut options = OpenOptions::new();
    options.read(true).write(true);
    let error = place.open_to_write(&options).unwrap_err();
    assert!(error.to_string().contains("2 names"), "{error}");
    fs::remove_file(folder.path().join("profile")).unwrap();
    place.open_to_write(&options).unwrap();
}

#[test]
fn a_file_of_zeros_that_take_no_room_is_refused_at_once() {
    let (_folder, place) = sparse(15 << 40);
    let error = place.digest().unwrap_err();
    assert!(error.to_string().contains("holes"), "{error}");
    assert_eq!(place.open().unwrap_err().kind(), io::ErrorKind::FileTooLarge);
}

#[test]
fn a_file_without_holes_is_read_from_its_beginning() {
    let folder = tempfile::tempdir().unwrap();
    let place = Place::root(folder.path()).join("file");
    let bytes: Vec<u8> = (0..=255).cycle().take(17 << 20).collect();
    fs::write(place.path(), &bytes).unwrap();
    assert_eq!(place.read(u64::MAX).unwrap(), bytes);
    assert_eq!(
        place.open_within(bytes.len() as u64 - 1).unwrap_err().kind(),
        io::ErrorKind::FileTooLarge
    );
}
