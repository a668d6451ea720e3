//! Archives as hosts and engines send them.

use std::io::Write as _;

use serde_json::json;

fn tar_of(root: &str) -> Vec<u8> {
    let mut archive = tar::Builder::new(Vec::new());
    let record = json!({"format": 1, "window": 1}).to_string();
    for (name, content) in [
        ("environment.json", "{}"),
        ("progress.jsonl", "{\"event\":\"finished\"}\n"),
        ("window-1/window.json", &record),
        ("window-1/control.csv", "step,actual_ns\n0,1\n"),
    ] {
        let mut header = tar::Header::new_ustar();
        header.set_size(content.len() as u64);
        header.set_mode(0o644);
        header.set_entry_type(tar::EntryType::Regular);
        archive
            .append_data(&mut header, format!("{root}{name}"), content.as_bytes())
            .expect("memory can be written");
    }
    archive.into_inner().expect("memory can be written")
}

/// As a host's `workload detached collect` does.
pub fn of_hosts() -> Vec<Vec<u8>> {
    let mut packed = lz4_flex::frame::FrameEncoder::new(Vec::new());
    packed.write_all(&tar_of("")).expect("memory can be written");
    vec![packed.finish().expect("memory can be written")]
}

/// As an engine does.
pub fn of_engines() -> Vec<Vec<u8>> {
    vec![tar_of("data/")]
}
