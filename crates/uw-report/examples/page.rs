//! A page with one of everything, on standard output: `cargo run -p uw-report --example page > page.html`.

use std::io::Write;

#[path = "../tests/it/sample.rs"]
mod sample;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    std::io::stdout().write_all(sample::page().html()?.as_bytes())?;
    Ok(())
}
