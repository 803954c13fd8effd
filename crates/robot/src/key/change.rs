//! The commands `key revoke`, `key add` and `key rotate`: make the next roster of a team by its root key. They need no
//! network; `key spread` sends the roster.

use std::io::Write;
use std::path::PathBuf;

use anyhow::{Context, Result};
use murmurate::config::shown;
use murmurate::messages::ids::HostId;

use super::digits::{BYTES, refuse};
use super::file::read_text;
use super::new::{ROOT, draw, write};
use super::root::Root;
use crate::destination::folder;
use crate::output::{print, talk};
use crate::whole_file::WholeFile;
use crate::{Ended, own_name};

/// Flags of `key revoke`.
#[derive(clap::Args)]
pub struct Change {
    /// Host or operator that is a member no longer
    #[arg(value_name = "NAME", required = true)]
    names: Vec<String>,
    #[command(flatten)]
    root: RootFlag,
}

/// Flags of `key add`.
#[derive(clap::Args)]
pub struct Add {
    /// New operator, such as operator-2, or a member of the team that gets a new key; the key that it had ends
    #[arg(value_name = "NAME")]
    name: String,
    #[command(flatten)]
    root: RootFlag,
}

/// Flags of `key rotate`.
#[derive(clap::Args)]
pub struct Rotate {
    #[command(flatten)]
    root: RootFlag,
}

#[derive(clap::Args)]
struct RootFlag {
    /// File with the root key, as `key new TEAM.toml` has made it; the roster is written beside it
    #[arg(long, value_name = "FILE", default_value = "keys/root.key")]
    root: PathBuf,
}

impl Change {
    /// Runs `key revoke`.
    pub fn run(&self) -> Result<Ended> {
        let mut root = self.root.read()?;
        for name in &self.names {
            self.root.check(root.revoke(name))?;
        }
        self.root.write(root, (false, None))?;
        talk(&format!("{} is heard by no host that has the roster, and may go on as it likes.", self.names.join(", ")));
        Ok(Ended::Done)
    }
}

impl Add {
    /// Runs `key add`.
    pub fn run(&self) -> Result<Ended> {
        let mut root = self.root.read()?;
        let had_one = root.members().any(|(name, revoked)| name == self.name && !revoked);
        let added = self.root.check(root.add(&self.name, &mut draw))?;
        // A key that is replaced may be in the wrong hands.
        self.root.write(root, (!had_one, Some((&self.name, added))))?;
        Ok(Ended::Done)
    }
}

impl Rotate {
    /// Runs `key rotate`.
    pub fn run(&self) -> Result<Ended> {
        let root = self.root.read()?;
        self.root.write(root, (true, None))?;
        Ok(Ended::Done)
    }
}

/// Member that is added: its name, its number and its secret.
type Added<'a> = (&'a str, (HostId, [u8; BYTES]));

impl RootFlag {
    fn read(&self) -> Result<Root> {
        let text = read_text(&self.root)?;
        let text = std::str::from_utf8(&text).map_err(|_| "is no text".to_owned());
        self.check(text.and_then(Root::parse))
    }

    fn check<T>(&self, found: Result<T, String>) -> Result<T> {
        found.or_else(|why| refuse(&self.root, &why))
    }

    /// Makes the next roster, and writes the root's file, the key file of the added member, and the roster. The root's
    /// is first, so that two rosters never have one number: after an interruption one number is left out.
    fn write(&self, mut root: Root, (planned, added): (bool, Option<Added>)) -> Result<()> {
        let changed = self.check(root.next(planned, added.map(|(_, added)| added), &mut draw))?;
        write(&self.root, &root.text(), true)?;
        let folder = folder(&self.root);
        if let (Some((name, _)), Some(text)) = (added, &changed.file) {
            let file = folder.join(format!("{name}.key"));
            write(&file, text, true)?;
            print(&format!("{}: for '{name}' alone", shown::value(file.display())))?;
        }
        let path = folder.join(format!("{}.roster", changed.number));
        let mut file = WholeFile::create(&path)?;
        file.write_all(&changed.sealed).with_context(|| format!("cannot write '{}'", path.display()))?;
        file.keep()?;
        let shown = shown::value(path.display());
        print(&format!("{shown}: roster {}, which is no secret", changed.number))?;
        talk(&format!(
            "Nothing was sent yet. '{} key spread TEAM.toml {shown}' gives it to the running team; hosts that are off \
             get it from the others later. Keep {ROOT}.key as it is now: an older copy makes rosters that none takes.",
            own_name()
        ));
        Ok(())
    }
}
