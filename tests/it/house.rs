//! What README, CHANGELOG and fixtures promise.

use sha2::{Digest, Sha256};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// What a clone is asked to carry in fixtures.
const FIXTURES_BYTES_MAX: u64 = 12_000_000;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn text(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|e| panic!("{path}: {e}"))
}

fn files_under(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    entries
        .flat_map(|entry| {
            let path = entry.expect("a folder's entries can be read").path();
            if path.is_dir() { files_under(&path) } else { vec![path] }
        })
        .collect()
}

#[test]
fn the_commands_of_the_readme_are_there_and_run_in_ci() {
    let (readme, ci) = (text("README.md"), text(".ci/run"));
    for command in ["./demo.sh", "./test.sh"] {
        assert!(
            readme.lines().any(|line| line == command),
            "README.md does not say {command} on a line of its own"
        );
        assert!(ci.lines().any(|line| line.trim() == command), ".ci/run does not run {command}");
    }
    for script in ["demo.sh", "test.sh", ".ci/run", "fixtures/check.sh"] {
        assert!(text(script).starts_with("#!/usr/bin/env bash\n"), "{script} does not name its shell");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            let mode = fs::metadata(root().join(script)).expect("it was just read").permissions().mode();
            assert_eq!(mode & 0o111, 0o111, "{script} is not executable");
        }
    }
}

#[test]
fn the_python_module_is_tested_with_our_crates_optimised() {
    let (manifest, lock) = (text("python/Cargo.toml"), text("python/Cargo.lock"));
    let crates = fs::read_dir(root().join("crates")).expect("the crates' folder can be read");
    let names = crates.map(|entry| entry.expect("its entries can be read").file_name());
    let ours = names.map(|name| name.into_string().expect("names of crates are plain"));
    for name in ours.chain(["uwscan".into()]).filter(|name| lock.contains(&format!("name = \"{name}\"\n"))) {
        let line = format!("{name} = {{ opt-level = 2 }}");
        assert!(
            manifest.lines().any(|l| l == line),
            "python/Cargo.toml lacks {line:?} in [profile.dev.package]"
        );
    }
}

#[test]
fn the_changelog_tells_of_this_version() {
    let version = env!("CARGO_PKG_VERSION");
    let heading = format!("## {version}");
    let told = text("CHANGELOG.md").lines().any(|l| l == heading || l.starts_with(&format!("{heading} ")));
    assert!(told, "CHANGELOG.md has no section {heading:?}");
}

#[test]
fn links_in_the_documents_lead_somewhere() {
    let mut documents: Vec<PathBuf> =
        ["README.md", "ARCHITECTURE.md", "CONVENTIONS.md", "CHANGELOG.md", "fixtures/README.md"]
            .iter()
            .map(|name| root().join(name))
            .collect();
    documents.extend(
        files_under(&root().join("docs")).into_iter().filter(|p| p.extension().is_some_and(|e| e == "md")),
    );
    for document in documents {
        let content = fs::read_to_string(&document).unwrap_or_else(|e| panic!("{}: {e}", document.display()));
        let targets =
            content.split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(target, _)| target);
        for target in targets.filter(|t| !t.contains("://")) {
            // Figures of the site are made when it is.
            if let Some(figure) = target.strip_prefix("figures/") {
                let maker = fs::read_to_string(document.with_file_name("figures.py")).unwrap_or_default();
                let name = figure.trim_end_matches(".svg");
                assert!(maker.contains(name), "{}: figures.py makes no {name}", document.display());
                continue;
            }
            let (path, anchor) = target.split_once('#').unwrap_or((target, ""));
            let file =
                if path.is_empty() { document.clone() } else { document.with_file_name("").join(path) };
            // A page of the site that is made of a notebook.
            let made = file.parent().is_some_and(|folder| folder.ends_with("notebooks"))
                && file.with_extension("ipynb").exists();
            if made {
                continue;
            }
            assert!(file.exists(), "{}: {target} leads nowhere", document.display());
            if !anchor.is_empty() {
                let headings = fs::read_to_string(&file).expect("a link with an anchor leads to a text");
                let found = headings.lines().filter(|l| l.starts_with('#')).any(|l| slug(l) == anchor);
                assert!(found, "{}: {target}: no such heading", document.display());
            }
        }
    }
}

/// A heading's anchor: lower case, spaces to hyphens, punctuation dropped.
fn slug(heading: &str) -> String {
    let kept = |c: char| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_');
    heading
        .trim_start_matches('#')
        .trim()
        .to_lowercase()
        .chars()
        .filter(|&c| kept(c))
        .map(|c| if c == ' ' { '-' } else { c })
        .collect()
}

#[test]
fn fixtures_are_as_recorded_and_small() {
    let folder = root().join("fixtures");
    let sums = text("fixtures/SHA256SUMS");
    let mut recorded = BTreeSet::new();
    for line in sums.lines() {
        let (hash, name) = line.split_once("  ").unwrap_or_else(|| panic!("{line:?} is no hash and name"));
        let content = fs::read(folder.join(name)).unwrap_or_else(|e| panic!("fixtures/{name}: {e}"));
        let found: String = Sha256::digest(content).iter().map(|b| format!("{b:02x}")).collect();
        assert_eq!(found, hash, "fixtures/{name} is not what was recorded; see fixtures/README.md");
        recorded.insert(folder.join(name));
    }
    let about = ["README.md", "SHA256SUMS", "check.sh"].map(|name| folder.join(name));
    let files = files_under(&folder);
    let more: Vec<_> = files.iter().filter(|f| !recorded.contains(*f) && !about.contains(f)).collect();
    assert!(more.is_empty(), "not recorded in fixtures/SHA256SUMS: {more:?}");
    let bytes: u64 = files.iter().map(|f| fs::metadata(f).expect("it was just listed").len()).sum();
    assert!(
        bytes <= FIXTURES_BYTES_MAX,
        "fixtures are {bytes} bytes, at most {FIXTURES_BYTES_MAX} are wanted"
    );
}
