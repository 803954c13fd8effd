//! The commands `murmurate completions` and `murmurate man`: shell completions and man pages, generated from the flags.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Command;
use clap_complete::Shell;
use clap_mangen::Man;

use murmurate::config::shown::counted;
use murmurate::registry::Registry;
use murmurate_robot::destination::check_folder;
use murmurate_robot::output::{print, talk};
use murmurate_robot::whole_file::WholeFile;
use murmurate_robot::{BadInput, Ended};

/// Prints what a shell needs to complete commands and flags.
#[derive(clap::Args)]
#[command(
    after_help = "For example: murmurate completions bash > ~/.local/share/bash-completion/completions/murmurate"
)]
pub struct Completions {
    /// Shell that the completions are for
    shell: Shell,
}

/// Prints the program's man page, or writes one for every command.
#[derive(clap::Args)]
#[command(after_help = "For example: murmurate man --out ~/.local/share/man/man1")]
pub struct Manual {
    /// Writes the page of every command into this folder, which is created if it does not exist
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
}

/// Runs `completions`: prints the completion script of a shell.
pub fn complete(args: &Completions, registry: &Registry) -> Result<Ended> {
    let (mut command, mut script) = (crate::program().definition(registry), Vec::new());
    let name = command.get_name().to_owned();
    clap_complete::generate(args.shell, &mut command, name, &mut script);
    print(String::from_utf8_lossy(&script).trim_end())?;
    Ok(Ended::Done)
}

/// Runs `man`: prints the program's man page, or writes the pages of all its commands into a folder.
pub fn manual(args: &Manual, registry: &Registry) -> Result<Ended> {
    let mut command = crate::program().definition(registry).disable_help_subcommand(true);
    command.build();
    let Some(folder) = &args.out else {
        print(String::from_utf8_lossy(&page(&command)?).trim_end())?;
        return Ok(Ended::Done);
    };
    let why = |e| BadInput(format!("--out: '{}': cannot make this folder: {e}", folder.display()));
    check_folder(folder).map_err(why)?;
    std::fs::create_dir_all(folder).map_err(|e| why(e.to_string()))?;
    let pages = write(&command, folder)?;
    talk(&format!("{} in '{}'", counted(pages, "page"), folder.display()));
    Ok(Ended::Done)
}

/// Writes the man pages of a command and its subcommands into a folder. Returns the number of pages.
fn write(command: &Command, folder: &Path) -> Result<usize> {
    let name = command.get_display_name().unwrap_or(command.get_name());
    let mut file = WholeFile::create(&folder.join(format!("{name}.1")))?;
    file.writer().write_all(&page(command)?).with_context(|| format!("cannot write the page of '{name}'"))?;
    file.keep()?;
    let below = command.get_subcommands().filter(|below| !below.is_hide_set());
    below.map(|below| write(below, folder)).sum::<Result<usize>>().map(|pages| pages + 1)
}

fn page(command: &Command) -> Result<Vec<u8>> {
    let mut page = Vec::new();
    Man::new(command.clone()).render(&mut page).context("memory takes everything")?;
    Ok(page)
}
