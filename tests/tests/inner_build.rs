//! `orchestrator/build.rs` builds the workload offline: a build of `matrix` alone has fetched all that the workload is built of.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

/// The packages of Cargo.lock with those that each depends on, by name and, where a name is there twice, version. Those of our
/// own crates include what only their tests need.
fn locked(text: &str) -> BTreeMap<String, Vec<String>> {
    let value = |line: &str, key: &str| {
        let quoted = line.strip_prefix(key)?.strip_prefix(" = ")?;
        Some(quoted.trim_matches('"').to_owned())
    };
    let mut packages = BTreeMap::new();
    for block in text.split("[[package]]").skip(1) {
        let name = block.lines().find_map(|line| value(line, "name")).unwrap();
        let version = block.lines().find_map(|line| value(line, "version")).unwrap();
        let listed = block.lines().map(str::trim).filter(|line| line.starts_with('"'));
        let dependencies: Vec<String> = listed
            .map(|line| line.trim_matches(['"', ',']).to_owned())
            .collect();
        packages.insert(format!("{name} {version}"), dependencies.clone());
        // The name alone stands where there is one version of it.
        packages.insert(name, dependencies);
    }
    packages
}

/// The names below `[dependencies]` of a crate of ours.
fn dependencies(manifest: &str) -> Vec<String> {
    let lines = manifest
        .lines()
        .skip_while(|line| *line != "[dependencies]")
        .skip(1);
    let section = lines.take_while(|line| !line.starts_with('['));
    section
        .filter_map(|line| line.split_once(" = "))
        .map(|(name, _)| name.to_owned())
        .collect()
}

/// All that a crate of ours is built of, itself included.
fn built_of(root: &Path, folders: &BTreeMap<&str, &str>, name: &str) -> BTreeSet<String> {
    let packages = locked(&fs::read_to_string(root.join("Cargo.lock")).unwrap());
    let mut found = BTreeSet::new();
    let mut next = vec![name.to_owned()];
    while let Some(package) = next.pop() {
        if !found.insert(package.clone()) {
            continue;
        }
        next.extend(match folders.get(package.as_str()) {
            Some(folder) => dependencies(&fs::read_to_string(root.join(folder).join("Cargo.toml")).unwrap()),
            None => packages.get(&package).cloned().unwrap_or_default(),
        });
    }
    found
}

#[test]
fn all_that_the_workload_is_built_of_is_fetched_with_matrix() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let folders = BTreeMap::from([
        ("captures", "reports/captures"),
        ("orchestrator", "orchestrator"),
        ("record", "workload/record"),
        ("reports", "reports"),
        ("simulation", "workload/simulation"),
        ("statistics", "reports/statistics"),
        ("workload", "workload"),
    ]);
    let (workload, matrix) = (
        built_of(root, &folders, "workload"),
        built_of(root, &folders, "orchestrator"),
    );
    assert!(workload.len() > 50 && workload.contains("rtrb"), "{workload:?}");
    let missing: Vec<&String> = workload
        .difference(&matrix)
        .filter(|name| *name != "workload")
        .collect();
    assert!(
        missing.is_empty(),
        "name them below [dependencies] of orchestrator/Cargo.toml, as quick-xml is: {missing:?}"
    );
}
