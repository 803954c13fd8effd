//! Key files: who may have them, and what they hold.

use std::fs::OpenOptions;
use std::io::{ErrorKind, Read};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use anyhow::Result;
use murmurate::live::links::ProcessIdentity;
use murmurate::messages::ids::HostId;
use murmurate::net::protocol::key::Key;
use murmurate::net::protocol::member::Member;
use murmurate::net::protocol::roster::RosterError;
use nix::unistd::geteuid;

use super::digits::{BYTES, fingerprint, is_guessable, parse, refuse};
use super::kept::Kept;
use super::member::OwnFile;
use crate::own_name;

/// Largest key file \[bytes\]: that of a member of the largest team has some 3000.
const MOST: u64 = 16_384;

/// Key file that was read, with the newest roster of this machine beside it.
pub struct KeyFile {
    path: PathBuf,
    content: Content,
}

/// Content of a key file.
enum Content {
    /// Key of all members of the team.
    Team([u8; BYTES]),
    /// File of one member, and its keys by the newest roster that this machine has.
    Member(Box<OwnFile>, Box<Member>),
}

impl KeyFile {
    /// Returns the key with which a process authenticates datagrams.
    pub fn key(&self) -> Key {
        match &self.content {
            Content::Team(shared) => Key::new(*shared),
            Content::Member(_, newest) => Key::of(Member::clone(newest)),
        }
    }

    /// Returns the key by the roster in the file itself, which later ones in a record follow.
    pub fn own_key(&self) -> Key {
        match &self.content {
            Content::Team(shared) => Key::new(*shared),
            Content::Member(own, _) => Key::of(own.member.clone()),
        }
    }

    /// Returns the key for records, by the roster in the file itself.
    pub fn key_of_records(&self) -> Key {
        self.own_key().for_records()
    }

    /// Returns the bytes that all members of the team have.
    pub fn shared(&self) -> [u8; BYTES] {
        match &self.content {
            Content::Team(shared) => *shared,
            Content::Member(_, newest) => newest.shared(),
        }
    }

    /// Returns the fingerprint of the team's key: 8 hexadecimal digits of a hash, equal for all members of one roster,
    /// which reveal nothing else about it.
    pub fn fingerprint(&self) -> String {
        fingerprint(&self.shared())
    }

    /// Returns the number of the newest roster that this machine has; `None` for the key of a whole team.
    pub fn roster(&self) -> Option<u32> {
        match &self.content {
            Content::Team(_) => None,
            Content::Member(_, newest) => Some(newest.roster().number),
        }
    }

    /// Returns the place of the newest roster on this machine; `None` for the key of a whole team.
    pub fn kept(&self) -> Option<Kept> {
        self.own().map(|own| Kept::of(&self.path, &own.root))
    }

    /// Returns the number and the name of the member whose file this is; `None` for the key of a whole team.
    pub fn member(&self) -> Option<(HostId, &str)> {
        self.own().map(|own| (own.number, &*own.name))
    }

    fn own(&self) -> Option<&OwnFile> {
        match &self.content {
            Content::Team(_) => None,
            Content::Member(own, _) => Some(own),
        }
    }

    /// Checks that the host `host` of the team with the number `team` may use the file: it is the host's own, or that
    /// of a whole team.
    ///
    /// # Errors
    /// If it is another member's, or of another team.
    pub fn check_host(&self, team: u16, (host, name): (HostId, &str)) -> Result<()> {
        let Some(member) = self.own() else { return Ok(()) };
        self.check_team(member, team)?;
        if member.number != host {
            let why = format!("is that of '{}' and this is host '{name}': name the host's own file", member.name);
            return refuse(&self.path, &why);
        }
        Ok(())
    }

    /// Returns the key of this process as an operator of the team with the number `team`. The process takes the number
    /// of an operator's own file; with the key of a whole team it keeps the one that it has drawn.
    ///
    /// # Errors
    /// If the file is a host's, or of another team.
    pub fn operator_key(&self, team: u16, process: &mut ProcessIdentity) -> Result<Key> {
        if let Some(member) = self.own() {
            self.check_team(member, team)?;
            if !member.number.is_operator() {
                let why = format!(
                    "is that of host '{}': name an operator's with --key-file, from 'key new TEAM.toml'",
                    member.name
                );
                return refuse(&self.path, &why);
            }
            process.operator = member.number;
        }
        Ok(self.key())
    }

    fn check_team(&self, own: &OwnFile, team: u16) -> Result<()> {
        if own.team == team {
            return Ok(());
        }
        refuse(&self.path, &format!("is of team {}, and this is team {team}: name that of this team", own.team))
    }
}

/// Returns the member with the key file `own` at `path`, by the newest roster that this machine has.
fn newest(path: &Path, own: &OwnFile) -> Result<Member> {
    let kept = Kept::of(path, &own.root);
    let shown = kept.path().display();
    let sealed = match kept.read() {
        Ok(None) => return Ok(own.member.clone()),
        Ok(Some(sealed)) => sealed,
        Err(error) => return refuse(path, &format!("has a newer roster '{shown}' that cannot be read: {error}")),
    };
    match own.member.take(&sealed) {
        Ok(member) => Ok(member),
        Err(RosterError::Known) => Ok(own.member.clone()),
        Err(error) => {
            let why = format!(
                "has a newer roster '{shown}' that is not its own: {error}; get a new key file, made by '{} key add \
                 {}', and remove that roster",
                own_name(),
                own.name
            );
            refuse(path, &why)
        }
    }
}

/// Reads a key file. Fails unless it belongs to this process's user or to root, has mode 0600 or less, and contains a
/// key. Symbolic links are followed; owner and mode are checked on the opened file.
pub fn read(path: &Path) -> Result<KeyFile> {
    let text = read_text(path)?;
    let file = |content| KeyFile { path: path.to_owned(), content };
    if text.len() <= 4 * BYTES {
        return Ok(file(Content::Team(plain(path, &text)?)));
    }
    match std::str::from_utf8(&text).map_err(|_| "is no text".to_owned()).and_then(OwnFile::parse) {
        Ok(own) => {
            let newest = newest(path, &own)?;
            Ok(file(Content::Member(Box::new(own), Box::new(newest))))
        }
        Err(why) => refuse(path, &format!("{why}: copy it again, or make new ones with '{} key new'", own_name())),
    }
}

/// Reads a file that holds nothing but a key, such as the access token of a page. Fails as [`read`] does.
#[cfg(feature = "watch")]
pub fn read_plain(path: &Path) -> Result<[u8; BYTES]> {
    plain(path, &read_text(path)?)
}

fn plain(path: &Path, text: &[u8]) -> Result<[u8; BYTES]> {
    let Some(key) = parse(text.trim_ascii()) else {
        let why = format!("does not hold {} hexadecimal digits ({BYTES} bytes): copy the team's key again", 2 * BYTES);
        return refuse(path, &why);
    };
    if is_guessable(&key) { refuse(path, GUESSABLE) } else { Ok(key) }
}

/// Why a key that was typed is refused.
const GUESSABLE: &str = "holds a key that anybody can guess, such as zeros or a repeated pattern: make one with 'key \
                         new', and copy it to every host";

/// Reads the bytes of a secret file. Fails as [`read`] does.
pub fn read_text(path: &Path) -> Result<Vec<u8>> {
    // Non-blocking, since opening a pipe would wait for its writer.
    let opened = OpenOptions::new().read(true).custom_flags(nix::libc::O_NONBLOCK | nix::libc::O_NOCTTY).open(path);
    let file = match opened {
        Ok(file) => file,
        Err(error) if error.kind() == ErrorKind::NotFound => {
            let why = format!("is not there: copy the team's key to it, or make one with '{} key new'", own_name());
            return refuse(path, &why);
        }
        Err(error) => return refuse(path, &format!("cannot be read: {error}")),
    };
    let unreadable = |error| refuse::<()>(path, &format!("cannot be read: {error}")).expect_err("it is an error");
    let about = file.metadata().map_err(unreadable)?;
    if !about.is_file() {
        return refuse(path, "is not a regular file: name a file that holds the key");
    }
    let (owner, user) = (about.uid(), geteuid().as_raw());
    if !may_own(owner, user) {
        let why = format!(
            "belongs to user {owner}, who can change it, and this program runs as user {user}: chown {user} it, or run \
             as its owner"
        );
        return refuse(path, &why);
    }
    let mode = about.mode() & 0o777;
    if mode & 0o177 != 0 {
        return refuse(path, &format!("has mode {mode:04o}, so others than its owner may use it: chmod 600 it"));
    }
    let mut text = Vec::new();
    // Bounded: a longer file is not a key file.
    file.take(MOST).read_to_end(&mut text).map_err(unreadable)?;
    Ok(text)
}

/// Whether a process of the user id `user` may use a key file that the user id `owner` owns: only if the owner is that
/// user or root. So a process of root uses no key that another user could replace.
fn may_own(owner: u32, user: u32) -> bool {
    owner == user || owner == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_accepted_from_its_user_and_from_root_only() {
        assert!(may_own(1000, 1000) && may_own(0, 1000) && may_own(0, 0));
        assert!(!may_own(1000, 0), "an ordinary user could replace root's key");
        assert!(!may_own(1001, 1000));
    }
}
