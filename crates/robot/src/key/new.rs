//! The command `key new`: keys of a team, in files that only their owner may read. It makes either one key
//! of all members (32 bytes as 64 hexadecimal digits), or a file for each host and each operator, none of which can
//! impersonate another, and one for the root, which signs the lists of members.
//!
//! Keys are never printed. Fingerprints show whether two hosts are of one team.

use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use data_encoding::HEXLOWER;
use murmurate::config::shown;
use murmurate::messages::ids::HostId;
use murmurate::net::protocol::codec::MAX_MEMBERS;
use murmurate::registry::Registry;

use super::digits::{BYTES, fingerprint};
use super::root::Root;
use crate::BadInput;
use crate::Ended;
use crate::output;
use crate::own_name;
use crate::team::TeamArgs;
use crate::temporary;

/// Flags of `murmurate key new`.
#[derive(clap::Args)]
pub struct New {
    /// Team file: makes a file for each host and operator, none of which can impersonate another. Without it, one
    /// key for all is made, with which each can
    #[arg(value_name = "TEAM")]
    team: Option<PathBuf>,
    /// Key file to write, or with TEAM the folder of the files [default: team.key, or keys]
    #[arg(long, value_name = "PATH")]
    out: Option<PathBuf>,
    /// Number of operators with a file of their own
    #[arg(long, value_name = "N", default_value_t = 1, requires = "team")]
    operators: u16,
    /// Replaces existing keys; every robot of the team then needs the new ones
    #[arg(long)]
    force: bool,
}

/// Runs `key new`: creates the key files. Fails if one exists and `--force` is missing, or if it cannot be written.
pub fn run(args: &New, registry: &Registry) -> Result<Ended> {
    match &args.team {
        Some(team) => of_members(args, team, registry),
        None => of_team(args),
    }
}

fn of_team(args: &New) -> Result<Ended> {
    let out = args.out.as_deref().unwrap_or(Path::new("team.key"));
    let key = draw()?;
    write(out, &format!("{}\n", HEXLOWER.encode(&key)), args.force)?;
    let shown = shown::value(out.display());
    output::print(&format!("{shown}: a new team key, fingerprint {}", fingerprint(&key)))?;
    output::talk("Copy it to every robot of the team, readable by its owner only (mode 0600).");
    output::talk(&format!(
        "Each holder of it can impersonate any robot, the state server and an operator. With '{} key new TEAM.toml' \
         none can.",
        own_name()
    ));
    Ok(Ended::Done)
}

fn of_members(args: &New, team: &Path, registry: &Registry) -> Result<Ended> {
    let team_args = TeamArgs::of(team.to_owned(), Vec::new());
    let file = team_args.read(registry)?;
    let number = file.operator_access().map_err(|error| team_args.wrong(&error))?.number;
    let hosts = file.hosts().zip(&file.deployment().hosts).map(|(host, about)| (host, about.name.clone()));
    let operators = (1..=args.operators).map(|nth| (HostId::operator(nth), format!("operator-{nth}")));
    let members: Vec<(HostId, String)> = hosts.chain(operators).collect();
    if members.len() > MAX_MEMBERS {
        let why = format!(
            "{} hosts and {} operators: {MAX_MEMBERS} members are the most, since what one sends to all has a tag for \
             each. Make one key for all with 'key new'",
            file.deployment().hosts.len(),
            args.operators
        );
        return Err(BadInput(why).into());
    }
    let folder = args.out.as_deref().unwrap_or(Path::new("keys"));
    let path_of = |name: &str| folder.join(format!("{name}.key"));
    if let Some((_, name)) = members.iter().find(|(_, name)| name.contains('/')) {
        return Err(BadInput(format!("host '{name}' has a name that no file can have")).into());
    }
    if members.iter().any(|(_, name)| name == ROOT) {
        return Err(BadInput(format!("host '{ROOT}' has the name of the root's key file: give it another")).into());
    }
    let all = || members.iter().map(|(_, name)| &**name).chain([ROOT]);
    if !args.force
        && let Some(name) = all().find(|name| path_of(name).symlink_metadata().is_ok())
    {
        return Err(exists(&path_of(name)));
    }
    let no_folder = |error| BadInput(format!("cannot make the folder '{}': {error}", shown::value(folder.display())));
    std::fs::create_dir_all(folder).map_err(no_folder)?;
    let (root, files) = Root::new(number, &members, &mut draw)?;
    let path = path_of(ROOT);
    write(&path, &root.text(), args.force)?;
    output::print(&format!("{}: the root key, for no machine of the team", shown::value(path.display())))?;
    for ((number, name), (_, text)) in members.iter().zip(files) {
        let path = path_of(name);
        write(&path, &text, args.force)?;
        let what = if number.is_operator() { "for who gives orders".to_owned() } else { format!("for host '{name}'") };
        output::print(&format!("{}: {what}", shown::value(path.display())))?;
    }
    output::talk(
        "Copy each to its own machine alone, readable by its owner only (mode 0600), and name it in the team file:",
    );
    output::talk(&format!(
        "Keep {ROOT}.key off the robots, where no visitor gets at it: its owner decides on the members of the team."
    ));
    for (number, name) in &members {
        let file = path_of(name);
        let place =
            if number.is_operator() { "at the top, for operators".to_owned() } else { format!("in [host.{name}]") };
        output::talk(&format!("  key_file = {:?}  {place}", file.to_string_lossy()));
    }
    Ok(Ended::Done)
}

/// Name of the root's key file, without its ending.
pub const ROOT: &str = "root";

/// Draws a key at random.
pub fn draw() -> Result<[u8; BYTES]> {
    let mut key = [0; BYTES];
    getrandom::fill(&mut key).map_err(|e| anyhow::anyhow!("the operating system gives no random bytes: {e}"))?;
    Ok(key)
}

fn cannot(out: &Path, why: &str) -> anyhow::Error {
    BadInput(format!("cannot write the key file '{}': {why}", shown::value(out.display()))).into()
}

fn exists(out: &Path) -> anyhow::Error {
    cannot(out, "it exists already; --force replaces it, and every robot then needs the new one")
}

/// Writes a key file with mode 0600, which gets its name once it is complete.
pub fn write(out: &Path, text: &str, force: bool) -> Result<()> {
    if !force && out.symlink_metadata().is_ok() {
        return Err(exists(out));
    }
    if out.is_dir() {
        return Err(cannot(out, "it is a folder; name a file in it"));
    }
    let folder = match out.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let mut file = temporary::file_in(folder, 0o600)
        .map_err(|e| cannot(out, &format!("{e}; choose a folder that can be written")))?;
    let open = file.as_file_mut();
    open.write_all(text.as_bytes()).and_then(|()| open.sync_all()).context("cannot write the key file")?;
    let kept = if force { file.persist(out) } else { file.persist_noclobber(out) };
    kept.map_err(|e| match e.error.kind() {
        ErrorKind::AlreadyExists => exists(out),
        _ => cannot(out, &e.error.to_string()),
    })?;
    Ok(())
}
