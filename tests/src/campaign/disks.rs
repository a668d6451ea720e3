//! Disks that lose power, and disks that are full.

use std::{
    fs::{self, File},
    io::{Read as _, Write as _},
    path::{Path, PathBuf},
    process::Command,
    sync::Arc,
};

use tempfile::TempDir;

use super::{
    Point,
    judge::{Fault, Verdict},
    scene::{Mounted, Platform, Scene},
    windows::Windows,
};

/// An ext4 in a file.
struct Image {
    folder: TempDir,
}

const PIECE_BYTES: usize = 1 << 20;

impl Image {
    fn new() -> Self {
        let image = Self {
            folder: TempDir::with_prefix("matrix-image-").expect("a folder"),
        };
        let file = File::create(image.path()).expect("the folder can be written");
        file.set_len(96 << 20).expect("the disk has room");
        let made = Command::new("mkfs.ext4")
            .args(["-q", "-F"])
            .arg(image.path())
            .output()
            .expect("mkfs.ext4 starts");
        assert!(made.status.success(), "{made:?}");
        image
    }

    fn path(&self) -> PathBuf {
        self.folder.path().join("disk")
    }

    fn mounted(&self, on: &Path) -> Mounted {
        Mounted::new(&["-o", "loop", &self.path().to_string_lossy()], on)
    }

    /// The image as a loss of power would leave it at one moment: what the file system has not given to its device is not in
    /// it. It is copied until a copy is as the image still is after it, and so is of the moment between the two.
    fn as_it_is(&self) -> Self {
        let copy = Self {
            folder: TempDir::with_prefix("matrix-image-").expect("a folder"),
        };
        loop {
            let copied = Command::new("cp")
                .arg("--sparse=always")
                .arg(self.path())
                .arg(copy.path())
                .status();
            assert!(
                copied.is_ok_and(|copied| copied.success()),
                "the image can be copied"
            );
            if same(&self.path(), &copy.path()) {
                return copy;
            }
        }
    }
}

fn same(one: &Path, other: &Path) -> bool {
    let mut files = [one, other].map(|path| File::open(path).expect("it is there"));
    let mut pieces = [vec![0; PIECE_BYTES], vec![0; PIECE_BYTES]];
    loop {
        let read: Vec<usize> = files
            .iter_mut()
            .zip(&mut pieces)
            .map(|(file, piece)| file.read(piece).expect("it can be read"))
            .collect();
        // Regular files give all that is asked for, up to their ends.
        if read[0] != read[1] || pieces[0][..read[0]] != pieces[1][..read[1]] {
            return false;
        }
        if read[0] == 0 {
            return true;
        }
    }
}

/// A disk that lost power, and the windows that the journal had told of by then.
struct Snapshot {
    line: usize,
    image: Image,
    promised: Windows,
}

/// A point after each line of the journal: the power goes, and comes back. All are of one run.
pub fn power_cuts(platform: Platform) -> Vec<Point> {
    let image = Image::new();
    let scene = Scene::with(platform, |folder| Some(image.mounted(folder)));
    let mut snapshots = Vec::new();
    let mut started = scene.start(&[], &["run", "m.yaml"]);
    let mut line = 0;
    while scene.wait_for_line(&mut started, line + 1) {
        // Lines that came while the last image was copied have none of their own.
        line = scene.journal_lines();
        let promised = Windows::promised(&scene);
        let image = image.as_it_is();
        snapshots.push(Snapshot {
            line,
            image,
            promised,
        });
    }
    started
        .end()
        .map(|ran| assert_eq!(ran.code, Some(0), "{ran:?}"))
        .expect("it has ended");
    let promised = Windows::promised(&scene);
    let image = image.as_it_is();
    snapshots.push(Snapshot {
        line: line + 1,
        image,
        promised,
    });
    drop(scene);
    let point = |snapshot: Snapshot| {
        Point::new(format!("line {}", snapshot.line), move |verdict| {
            // What was mounted is written to, and the same point may be done again.
            let image = Arc::new(snapshot.image.as_it_is());
            let mut scene = Scene::with(platform, |folder| Some(image.mounted(folder)));
            let mut before = snapshot.promised.clone();
            before.add(Windows::anywhere(&scene));
            verdict.go_on_whole(&mut scene, &before);
        })
    };
    snapshots.into_iter().map(point).collect()
}

/// A point after each line of the journal: from then on the disk of run and state folder is full, until the run has ended.
pub fn full_after_each_line(platform: Platform, lines: usize) -> Vec<Point> {
    let point = |line| {
        Point::new(format!("full after line {line}"), move |verdict| {
            let mut scene = on_memory(platform, "48m");
            let mut started = scene.start(&[], &["run", "m.yaml"]);
            scene.wait_for_line(&mut started, line);
            let filler = scene.workplace.path().join("filler");
            fill(&filler);
            verdict.ended("run", started.end());
            fs::remove_file(&filler).expect("the filler is ours");
            go_on(verdict, &mut scene);
        })
    };
    (1..=lines).map(point).collect()
}

/// A point for each size of the disk of run and state folder, from none to more than is needed.
pub fn too_small(platform: Platform) -> Vec<Point> {
    let point = |size: u32| {
        Point::new(format!("{size} KiB"), move |verdict| {
            let mut scene = on_memory(platform, &format!("{size}k"));
            let ran = scene.run(&["run", "m.yaml"]);
            verdict.ended("run", ran);
            let grown = Command::new("mount")
                .args(["-o", "remount,size=64m"])
                .arg(scene.workplace.path())
                .status();
            assert!(grown.is_ok_and(|grown| grown.success()), "the disk can grow");
            go_on(verdict, &mut scene);
        })
    };
    (1..=30).map(|step| point(64 + step * 320)).collect()
}

fn on_memory(platform: Platform, size: &str) -> Scene {
    Scene::with(platform, |folder| {
        Some(Mounted::new(
            &["-t", "tmpfs", "-o", &format!("size={size}"), "matrix-test"],
            folder,
        ))
    })
}

/// Writes until nothing more fits.
fn fill(filler: &Path) {
    let mut file = File::create(filler).expect("a file without content has room");
    for piece in [vec![0; PIECE_BYTES], vec![0; 4096], vec![0; 1]] {
        while file.write_all(&piece).is_ok() {}
    }
}

fn go_on(verdict: &mut Verdict, scene: &mut Scene) {
    let before = Windows::anywhere(scene);
    if !scene.processes().is_empty() {
        verdict.note(Fault::Leak, "a workload measures though its run has ended");
    }
    verdict.go_on_whole(scene, &before);
}
