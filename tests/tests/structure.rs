//! The modules of a crate import each other in one direction: no circle has more than two files.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

use rstest::rstest;
use syn::{Item, ItemUse, UseTree, Visibility};

/// Names of modules from the crate's root on; the root itself has none.
type Module = Vec<String>;

/// A crate's source files, by module, each with what it imports.
struct Crate {
    uses: BTreeMap<Module, Vec<Import>>,
}

/// One imported name.
struct Import {
    /// From the crate's root on.
    path: Vec<String>,
    /// Its name in the module.
    name: String,
    /// Whether others may import it from there.
    is_public: bool,
}

impl Crate {
    fn read(source: &Path) -> Self {
        let mut uses = BTreeMap::new();
        let mut folders = vec![source.to_owned()];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                } else if path.extension().is_some_and(|it| it == "rs") {
                    let module = module_of(path.strip_prefix(source).unwrap());
                    if !module.iter().any(|name| name == "tests" || name == "main") {
                        uses.insert(module, fs::read_to_string(&path).unwrap());
                    }
                }
            }
        }
        let modules: BTreeSet<Module> = uses.keys().cloned().collect();
        let uses = uses
            .into_iter()
            .map(|(module, text)| {
                let imports = imports(&module, &text, &modules);
                (module, imports)
            })
            .collect();
        Self { uses }
    }

    /// The file that defines what a path names; a public import leads on to the file that it imports from.
    fn file_of(&self, path: &[String]) -> Module {
        let mut path = path.to_vec();
        // A name that is passed on through more files than that is passed around in a circle.
        for _ in 0..16 {
            let depth = (0..=path.len())
                .rev()
                .find(|depth| self.uses.contains_key(&path[..*depth]))
                .unwrap_or(0);
            let (module, rest) = path.split_at(depth);
            let passed_on = rest.first().and_then(|name| {
                let imports = self.uses.get(module)?;
                imports
                    .iter()
                    .find(|import| import.is_public && import.name == *name)
            });
            match passed_on {
                Some(import) => path = [import.path.as_slice(), &rest[1..]].concat(),
                None => return module.to_vec(),
            }
        }
        panic!("{path:?} leads nowhere");
    }

    /// Which files each file imports from. A public import is not a dependency of the file that passes it on.
    fn graph(&self) -> BTreeMap<&Module, BTreeSet<Module>> {
        self.uses
            .iter()
            .map(|(module, imports)| {
                let files = imports.iter().filter(|import| !import.is_public);
                let mut files: BTreeSet<Module> = files.map(|import| self.file_of(&import.path)).collect();
                files.remove(module);
                (module, files)
            })
            .collect()
    }

    /// Files that import each other, directly or through others.
    fn circles(&self) -> Vec<Vec<Module>> {
        let graph = self.graph();
        let reached = |from: &Module| {
            let mut reached = BTreeSet::new();
            let mut next: Vec<&Module> = graph[from].iter().collect();
            while let Some(module) = next.pop() {
                if reached.insert(module) {
                    next.extend(graph.get(module).into_iter().flatten());
                }
            }
            reached
        };
        let reached: BTreeMap<&Module, BTreeSet<&Module>> =
            graph.keys().map(|module| (*module, reached(module))).collect();
        let circle = |module: &Module| {
            let others = reached[module]
                .iter()
                .filter(|other| reached[*other].contains(module));
            others.map(|other| (*other).clone()).collect::<Vec<_>>()
        };
        let circles: BTreeSet<_> = graph.keys().map(|module| circle(module)).collect();
        circles.into_iter().filter(|circle| circle.len() > 1).collect()
    }
}

fn module_of(file: &Path) -> Module {
    let file = file.with_extension("");
    let names = file.iter().map(|name| name.to_str().unwrap().to_owned());
    names.filter(|name| name != "lib").collect()
}

/// What the file imports from its own crate, outside of its tests.
fn imports(module: &Module, text: &str, modules: &BTreeSet<Module>) -> Vec<Import> {
    let file = syn::parse_file(text).unwrap_or_else(|error| panic!("{module:?}: {error}"));
    let mut imports = Vec::new();
    for item in &file.items {
        if let Item::Use(item) = item {
            let is_public = !matches!(item.vis, Visibility::Inherited);
            for (path, name) in paths(item) {
                if let Some(path) = from_root(module, path, modules) {
                    imports.push(Import {
                        path,
                        name,
                        is_public,
                    });
                }
            }
        }
    }
    imports
}

fn paths(item: &ItemUse) -> Vec<(Vec<String>, String)> {
    fn walk(tree: &UseTree, before: &[String], found: &mut Vec<(Vec<String>, String)>) {
        let with = |name: &syn::Ident| [before, &[name.to_string()]].concat();
        match tree {
            UseTree::Path(path) => walk(&path.tree, &with(&path.ident), found),
            UseTree::Name(name) if name.ident == "self" => {
                found.push((before.to_vec(), before.last().cloned().unwrap_or_default()));
            }
            UseTree::Name(name) => found.push((with(&name.ident), name.ident.to_string())),
            UseTree::Rename(rename) if rename.ident == "self" => {
                found.push((before.to_vec(), rename.rename.to_string()));
            }
            UseTree::Rename(rename) => found.push((with(&rename.ident), rename.rename.to_string())),
            UseTree::Glob(_) => found.push((before.to_vec(), String::new())),
            UseTree::Group(group) => group.items.iter().for_each(|tree| walk(tree, before, found)),
        }
    }
    let mut found = Vec::new();
    walk(&item.tree, &[], &mut found);
    found
}

/// A path from the crate's root on; none if it is of another crate.
fn from_root(module: &Module, path: Vec<String>, modules: &BTreeSet<Module>) -> Option<Vec<String>> {
    let first = path.first()?.as_str();
    let child = [module.as_slice(), &path[..1]].concat();
    match first {
        "crate" => Some(path[1..].to_vec()),
        "self" => Some([module.as_slice(), &path[1..]].concat()),
        "super" => {
            let up = path.iter().take_while(|name| *name == "super").count();
            let parent = &module[..module.len().checked_sub(up)?];
            Some([parent, &path[up..]].concat())
        }
        _ if modules.contains(&child) => Some([module.as_slice(), &path].concat()),
        _ => None,
    }
}

#[rstest]
#[case("workload/record/src")]
#[case("workload/simulation/src")]
#[case("workload/src")]
#[case("reports/src")]
#[case("orchestrator/src")]
fn no_circle_of_imports_has_more_than_two_files(#[case] source: &str) {
    let source: PathBuf = [env!("CARGO_MANIFEST_DIR"), "..", source].iter().collect();
    let of_the_crate = Crate::read(&source);
    assert!(of_the_crate.uses.len() > 10, "{}", source.display());
    let graph = of_the_crate.graph();
    let large: Vec<String> = of_the_crate
        .circles()
        .iter()
        .filter(|circle| circle.len() > 2)
        .flatten()
        .map(|module| {
            let within = graph[module].iter().map(|other| other.join("::"));
            format!(
                "{} imports {}",
                module.join("::"),
                within.collect::<Vec<_>>().join(", ")
            )
        })
        .collect();
    assert!(large.is_empty(), "{large:#?}");
}

#[test]
fn a_circle_through_a_name_that_is_passed_on_is_found() {
    let folder = tempfile::tempdir().unwrap();
    for (file, text) in [
        ("lib.rs", "pub use a::Type;"),
        ("a.rs", "use crate::b::Other;"),
        ("b.rs", "use crate::c;"),
        (
            "c.rs",
            "use crate::Type;\n#[cfg(test)]\nmod tests { use crate::d::Unseen; }",
        ),
        ("d.rs", "use crate::a::Type;"),
    ] {
        fs::write(folder.path().join(file), text).unwrap();
    }
    let circles = Crate::read(folder.path()).circles();
    assert_eq!(circles, [["a", "b", "c"].map(|name| vec![name.to_owned()])]);
}
