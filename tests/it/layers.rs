//! Which crate may know which: docs/adr/0001-layers.md, held against `cargo metadata`.

use cargo_metadata::{DependencyKind, Metadata, MetadataCommand, PackageId, Target};
use std::collections::{BTreeMap, BTreeSet};

/// Every crate of the workspace and the crates of the workspace that it may depend on, tests and benches included.
const ALLOWED: &[(&str, &[&str])] = &[
    ("uw-geom", &[]),
    ("uw-stripe", &[]),
    ("uw-hw", &[]),
    ("uw-report", &[]),
    ("uw-calib", &["uw-geom"]),
    ("uw-cloud", &["uw-geom"]),
    ("uw-sim", &["uw-geom", "uw-hw"]),
    ("uw-io", &["uw-calib", "uw-cloud", "uw-geom", "uw-hw"]),
    ("uw-live", &["uw-calib", "uw-cloud", "uw-hw", "uw-io"]),
    (
        "uwscan",
        &["uw-calib", "uw-cloud", "uw-geom", "uw-hw", "uw-io", "uw-live", "uw-report", "uw-sim", "uw-stripe"],
    ),
    ("uw-cli", &["uwscan"]),
];

const FILES: &[&str] = &["csv", "image", "tempfile", "toml"];
const CLOCKS_AND_CHANCE: &[&str] = &["chrono", "getrandom", "rand", "time"];
const LOGS: &[&str] = &["log", "tracing"];
const TERMINAL: &[&str] =
    &["anyhow", "clap", "console", "crossterm", "eyre", "indicatif", "miette", "tracing-subscriber"];

/// What no crate of a layer may reach, directly or through others.
const NEVER: &[(&str, &[&[&str]])] = &[
    ("uw-geom", &[FILES, CLOCKS_AND_CHANCE, LOGS, TERMINAL, &["serde"]]),
    ("uw-stripe", &[FILES, CLOCKS_AND_CHANCE, LOGS, TERMINAL, &["serde"]]),
    ("uw-hw", &[&["csv", "image", "toml"], LOGS, TERMINAL]),
    ("uw-report", &[FILES, CLOCKS_AND_CHANCE, LOGS, TERMINAL, &["serde"]]),
    ("uw-calib", &[FILES, CLOCKS_AND_CHANCE, LOGS, TERMINAL]),
    ("uw-cloud", &[FILES, CLOCKS_AND_CHANCE, LOGS, TERMINAL, &["serde"]]),
    // Its noise is drawn from seeds; the time of an exposure is given to it.
    ("uw-sim", &[FILES, LOGS, TERMINAL, &["serde"]]),
    ("uw-io", &[TERMINAL]),
    ("uw-live", &[TERMINAL]),
    ("uwscan", &[TERMINAL]),
];

fn metadata() -> Metadata {
    MetadataCommand::new()
        .manifest_path(concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml"))
        .other_options(vec!["--locked".to_owned()])
        .exec()
        .expect("cargo metadata describes the workspace")
}

/// Edges between crates of the workspace, every kind of dependency.
fn workspace_edges(metadata: &Metadata) -> BTreeMap<String, BTreeSet<String>> {
    let packages = metadata.workspace_packages();
    let names: BTreeSet<&str> = packages.iter().map(|p| p.name.as_str()).collect();
    let inside = |name: &String| names.contains(name.as_str());
    packages
        .iter()
        .map(|p| (p.name.to_string(), p.dependencies.iter().map(|d| d.name.clone()).filter(inside).collect()))
        .collect()
}

/// Edges that `allowed` does not have, as `from -> to`, and crates that it does not know.
fn violations(edges: &BTreeMap<String, BTreeSet<String>>, allowed: &[(&str, &[&str])]) -> Vec<String> {
    let allowed: BTreeMap<&str, &[&str]> = allowed.iter().copied().collect();
    edges
        .iter()
        .flat_map(|(from, to)| match allowed.get(from.as_str()) {
            None => vec![from.clone()],
            Some(may) => {
                let more = to.iter().filter(|to| !may.contains(&to.as_str()));
                more.map(|to| format!("{from} -> {to}")).collect()
            }
        })
        .collect()
}

/// Every package that `root` is built with, by name, and the names on the way to it.
fn reached(metadata: &Metadata, root: &str) -> BTreeMap<String, Vec<String>> {
    let resolve = metadata.resolve.as_ref().expect("cargo metadata resolves dependencies");
    let package = metadata.workspace_packages().into_iter().find(|p| p.name == root);
    let root = package.unwrap_or_else(|| panic!("{root} is in the workspace")).id.clone();
    let mut ways: BTreeMap<&PackageId, Vec<String>> =
        BTreeMap::from([(&root, vec![metadata[&root].name.to_string()])]);
    let mut open = vec![&root];
    while let Some(id) = open.pop() {
        let node = resolve.nodes.iter().find(|n| n.id == *id).expect("every package has a node");
        let normal =
            node.deps.iter().filter(|d| d.dep_kinds.iter().any(|k| k.kind == DependencyKind::Normal));
        for dependency in normal {
            if !ways.contains_key(&dependency.pkg) {
                let mut way = ways[id].clone();
                way.push(metadata[&dependency.pkg].name.to_string());
                ways.insert(&dependency.pkg, way);
                // What a procedural macro is made with runs in the compiler, and is not in what is built.
                if !metadata[&dependency.pkg].targets.iter().any(Target::is_proc_macro) {
                    open.push(&dependency.pkg);
                }
            }
        }
    }
    ways.into_iter().map(|(id, way)| (metadata[id].name.to_string(), way)).collect()
}

#[test]
fn crates_know_only_the_layers_below() {
    let found = violations(&workspace_edges(&metadata()), ALLOWED);
    assert!(
        found.is_empty(),
        "new crates or edges: {found:?}; they are a design change: write an ADR, then extend the table here"
    );
}

#[test]
fn lower_layers_do_without_files_clocks_chance_logs_and_terminals() {
    let metadata = metadata();
    for (name, never) in NEVER {
        let reached = reached(&metadata, name);
        for package in never.iter().copied().flatten() {
            if let Some(way) = reached.get(*package) {
                panic!("{name} must do without {package}, but is built with it: {}", way.join(" -> "));
            }
        }
    }
}

#[test]
fn an_edge_that_is_not_allowed_is_found() {
    let edges = |from: &str, to: &str| BTreeMap::from([(from.to_owned(), BTreeSet::from([to.to_owned()]))]);
    assert_eq!(violations(&edges("uw-geom", "uw-calib"), ALLOWED), ["uw-geom -> uw-calib"]);
    assert_eq!(violations(&edges("uw-cli", "uw-calib"), ALLOWED), ["uw-cli -> uw-calib"]);
    assert_eq!(violations(&edges("uw-new", "uw-geom"), ALLOWED), ["uw-new"]);
    assert!(violations(&edges("uw-calib", "uw-geom"), ALLOWED).is_empty());
}

#[test]
fn what_a_crate_is_built_with_is_found_through_others() {
    // The pipeline reaches the PNG decoder only through uw-io and image: were it not found, the test above could not fail.
    let metadata = metadata();
    let way = reached(&metadata, "uwscan").remove("png").expect("uwscan decodes PNG");
    assert_eq!(way.first().map(String::as_str), Some("uwscan"));
    assert!(way.contains(&"image".to_owned()), "{way:?}");
}
