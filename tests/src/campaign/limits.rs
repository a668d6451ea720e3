//! Limits of the kernel, a workload that stands still, and a resume with another state folder.

use std::time::{Duration, Instant};

use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};

use super::{
    Point,
    judge::Fault,
    scene::{Platform, Scene},
    windows::Windows,
};

/// The nodes wait a minute for their master before they say so.
const LIMITED: Duration = Duration::from_secs(150);
/// In this time a workload that stands still has been spoken of.
const SILENCE: Duration = Duration::from_secs(45);

/// `matrix` and what it starts below a limit, as prlimit(1) has it; then `resume` without.
pub fn below_limits(platform: Platform) -> Vec<Point> {
    const FILES: [u32; 9] = [8, 12, 16, 20, 24, 28, 32, 40, 64];
    const FILE_KIB: [u32; 8] = [0, 1, 4, 16, 64, 256, 1024, 4096];
    // With less than the program's own size the kernel does not load it.
    const MEMORY_MIB: [u32; 6] = [256, 384, 512, 1024, 1536, 3072];
    let files = FILES.map(|files| format!("--nofile={files}"));
    let lengths = FILE_KIB.map(|kib| format!("--fsize={}", u64::from(kib) << 10));
    let memory = MEMORY_MIB.map(|mib| format!("--as={}", u64::from(mib) << 20));
    let point = |limit: String| {
        Point::new(limit.clone(), move |verdict| {
            let mut scene = Scene::on(platform);
            let below = ["prlimit".to_owned(), limit.clone()];
            let ran = scene.start(&below, &["run", "m.yaml"]).end_within(LIMITED);
            if let Some(ran) = verdict.ended("run", ran)
                && ran.code == Some(1)
            {
                verdict.note(
                    Fault::WrongWord,
                    format!("the limit is told as the experiment's failure: {}", ran.err),
                );
            }
            let before = Windows::anywhere(&scene);
            verdict.go_on_whole(&mut scene, &before);
        })
    };
    files
        .into_iter()
        .chain(lengths)
        .chain(memory)
        .map(point)
        .collect()
}

/// The workload is stopped, once while it connects and once in a window.
pub fn workload_stands_still(platform: Platform) -> Vec<Point> {
    let point = |event: &'static str| {
        Point::new(format!("stopped after {event}"), move |verdict| {
            let mut scene = Scene::on(platform);
            let mut started = scene.start(&[], &["run", "m.yaml"]);
            scene.wait_for_event(&mut started, event);
            let workloads = || {
                scene
                    .processes()
                    .into_iter()
                    .filter(|(_, words)| words.contains(" run --environment"))
            };
            let stopped: Vec<i32> = workloads().map(|(pid, _)| pid).collect();
            let signal = |signal| {
                stopped
                    .iter()
                    .for_each(|pid| _ = kill(Pid::from_raw(*pid), signal))
            };
            signal(Signal::SIGSTOP);
            let said = scene.said();
            let begun = Instant::now();
            while scene.said() == said && begun.elapsed() < SILENCE && !started.has_ended() {
                std::thread::sleep(Duration::from_millis(100));
            }
            if begun.elapsed() >= SILENCE {
                verdict.note(
                    Fault::Hang,
                    format!("no word in {SILENCE:?} of a workload that stands still"),
                );
            }
            signal(Signal::SIGCONT);
            verdict.ended("run", started.end());
            let before = Windows::anywhere(&scene);
            verdict.go_on_whole(&mut scene, &before);
        })
    };
    ["started", "measuring"].map(point).into_iter().collect()
}

/// A run is killed after its first window, and gone on with by somebody who has another state folder.
pub fn another_state_folder(platform: Platform) -> Vec<Point> {
    let point = Point::new("after window 1", move |verdict| {
        let mut scene = Scene::on(platform);
        let mut started = scene.start(&[], &["run", "m.yaml"]);
        scene.wait_for_event(&mut started, "window-complete");
        started.kill();
        let before = Windows::anywhere(&scene);
        let elsewhere = scene
            .workplace
            .path()
            .join("elsewhere")
            .to_string_lossy()
            .into_owned();
        let path = scene
            .run_directory()
            .map(|run| run.to_string_lossy().into_owned())
            .unwrap_or_default();
        let below = ["env".to_owned(), format!("MATRIX_STATE_DIR={elsewhere}")];
        let ran = scene.start(&below, &["resume", &path]).end();
        verdict.ended("resume", ran);
        verdict.go_on_whole(&mut scene, &before);
    });
    vec![point]
}
