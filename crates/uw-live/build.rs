//! Lists the page's files, so that the binary carries them.
#![allow(clippy::print_stdout, reason = "it is how cargo is told")]

use std::fmt::Write;
use std::path::Path;

fn main() {
    println!("cargo::rerun-if-changed=assets");
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets");
    let mut names: Vec<String> = std::fs::read_dir(&folder)
        .expect("the folder assets is there")
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|name| !name.starts_with('.'))
        .collect();
    names.sort();
    let mut table = String::from("&[\n");
    for name in names {
        let path = folder.join(&name);
        writeln!(
            table,
            "    ({:?}, include_bytes!({:?}).as_slice()),",
            format!("/{name}"),
            path.display().to_string()
        )
        .expect("text can be written to");
    }
    table.push(']');
    let out = std::env::var("OUT_DIR").expect("cargo says where to");
    std::fs::write(Path::new(&out).join("assets.rs"), table).expect("the table can be written");
}
