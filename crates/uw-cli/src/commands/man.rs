//! `uwscan man`: one page with every command.

use std::io;

use clap::CommandFactory;
use clap_mangen::Man;

use crate::{args::Cli, exit::Outcome, output};

/// Arguments of `man`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Prints the page.
///
/// # Errors
/// Standard output can't be written.
pub fn run(_: &Args) -> anyhow::Result<Outcome> {
    output::print(page()?)?;
    Ok(Outcome::Done)
}

fn page() -> io::Result<String> {
    let command = Cli::command();
    let man = Man::new(command.clone());
    let mut page = Vec::new();
    man.render_title(&mut page)?;
    man.render_name_section(&mut page)?;
    man.render_synopsis_section(&mut page)?;
    man.render_description_section(&mut page)?;
    man.render_options_section(&mut page)?;
    let mut page = text(&page);
    sections(&command, command.get_name(), &mut page)?;
    let mut end = Vec::new();
    man.render_extra_section(&mut end)?;
    man.render_version_section(&mut end)?;
    Ok(page + &text(&end))
}

/// A section for every command below `parent` that does something itself.
fn sections(parent: &clap::Command, parent_name: &str, page: &mut String) -> io::Result<()> {
    for command in parent.get_subcommands() {
        let name = format!("{parent_name} {}", command.get_name());
        if command.has_subcommands() {
            sections(command, &name, page)?;
            continue;
        }
        let man = Man::new(command.clone().bin_name(&name).display_name(&name));
        let mut section = Vec::new();
        man.render_synopsis_section(&mut section)?;
        man.render_description_section(&mut section)?;
        man.render_options_section(&mut section)?;
        *page += &format!(".SH \"{}\"\n", name.to_uppercase());
        *page += &text(&section).replace(".SH ", ".SS ");
    }
    Ok(())
}

fn text(roff: &[u8]) -> String {
    String::from_utf8_lossy(roff).into_owned()
}
