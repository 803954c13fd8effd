//! The command `murmurate key`: the team key, 32 bytes as 64 hexadecimal digits in a file that only its owner may read.
//!
//! Keys are never printed. Their fingerprints show whether two hosts have the same key.

use std::fs::OpenOptions;
use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Subcommand;
use data_encoding::{HEXLOWER, HEXLOWER_PERMISSIVE};
use hmac_sha256::Hash;
use nix::unistd::geteuid;

use crate::BadInput;
use crate::Ended;
use crate::output;
use crate::own_name;
use crate::temporary;
use murmurate::config::shown;
use murmurate::registry::Registry;

/// Length of a key \[bytes\].
const BYTES: usize = 32;

/// Makes the key that a team's messages are authenticated with.
#[derive(Subcommand)]
pub enum Args {
    /// Makes a new key file that only you can read
    New(New),
}

/// Flags of `murmurate key new`.
#[derive(clap::Args)]
pub struct New {
    /// Key file to write
    #[arg(long, value_name = "FILE", default_value = "team.key")]
    out: PathBuf,
    /// Replaces an existing key; every robot of the team then needs the new one
    #[arg(long)]
    force: bool,
}

/// Runs `key new`: creates a key file. Fails if the file exists and `--force` is missing, or if it cannot be written.
pub fn run(args: &Args, _: &Registry) -> Result<Ended> {
    let Args::New(New { out, force }) = args;
    let shown = shown::value(out.display());
    let refuse = |why: String| BadInput(format!("cannot write the key file '{shown}': {why}"));
    let there = || refuse("it exists already; --force replaces it, and every robot then needs the new one".into());
    if !force && out.symlink_metadata().is_ok() {
        return Err(there().into());
    }
    if out.is_dir() {
        return Err(refuse("it is a folder; name a file in it".to_owned()).into());
    }
    let mut key = [0; BYTES];
    getrandom::fill(&mut key).map_err(|e| anyhow::anyhow!("the operating system gives no random bytes: {e}"))?;
    let folder = match out.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    // The file has mode 0600 from the start, and gets its name once it is complete.
    let mut file =
        temporary::file_in(folder, 0o600).map_err(|e| refuse(format!("{e}; choose a folder that can be written")))?;
    let digits = HEXLOWER.encode(&key);
    let open = file.as_file_mut();
    writeln!(open, "{digits}").and_then(|()| open.sync_all()).context("cannot write the key file")?;
    let kept = if *force { file.persist(out) } else { file.persist_noclobber(out) };
    kept.map_err(|e| match e.error.kind() {
        ErrorKind::AlreadyExists => there(),
        _ => refuse(e.error.to_string()),
    })?;
    output::print(&format!("{shown}: a new team key, fingerprint {}", fingerprint(&key)))?;
    output::talk("Copy it to every robot of the team, readable by its owner only (mode 0600).");
    Ok(Ended::Done)
}

/// Reads a key file. Fails unless it belongs to this process's user or to root, has mode 0600 or less, and contains a
/// key. Symbolic links are followed; owner and mode are checked on the opened file.
pub fn read(path: &Path) -> Result<[u8; BYTES]> {
    let refuse = |why: String| anyhow::Error::from(BadInput(format!("the key file '{}' {why}", path.display())));
    // Non-blocking, since opening a pipe would wait for its writer.
    let opened = OpenOptions::new().read(true).custom_flags(nix::libc::O_NONBLOCK | nix::libc::O_NOCTTY).open(path);
    let file = opened.map_err(|e| match e.kind() {
        ErrorKind::NotFound => {
            refuse(format!("is not there: copy the team's key to it, or make one with '{} key new'", own_name()))
        }
        _ => refuse(format!("cannot be read: {e}")),
    })?;
    let about = file.metadata().map_err(|e| refuse(format!("cannot be read: {e}")))?;
    if !about.is_file() {
        return Err(refuse("is not a regular file: name a file that holds the key".to_owned()));
    }
    let (owner, user) = (about.uid(), geteuid().as_raw());
    if !may_own(owner, user) {
        let why = format!(
            "belongs to user {owner}, who can change it, and this program runs as user {user}: chown {user} it, or run \
             as its owner"
        );
        return Err(refuse(why));
    }
    let mode = about.mode() & 0o777;
    if mode & 0o177 != 0 {
        return Err(refuse(format!("has mode {mode:04o}, so others than its owner may use it: chmod 600 it")));
    }
    let mut digits = Vec::new();
    // Bounded: a longer file is not a key file.
    file.take(4 * BYTES as u64).read_to_end(&mut digits).map_err(|e| refuse(format!("cannot be read: {e}")))?;
    let key = parse(digits.trim_ascii()).ok_or_else(|| {
        refuse(format!("does not hold {} hexadecimal digits ({BYTES} bytes): copy the team's key again", 2 * BYTES))
    })?;
    if is_guessable(&key) {
        return Err(refuse(
            "holds a key that anybody can guess, such as zeros or a repeated pattern: make one with 'key new', and \
             copy it to every host"
                .to_owned(),
        ));
    }
    Ok(key)
}

/// Whether a key was typed and not drawn: its bytes repeat within eight, as zeros do, or count up or down. A key of
/// `key new` is so with a probability below 2^-180.
fn is_guessable(key: &[u8; BYTES]) -> bool {
    let repeats = (1..=8).any(|period| key.iter().zip(&key[period..]).all(|(one, other)| one == other));
    let step = key[1].wrapping_sub(key[0]);
    repeats || key.windows(2).all(|pair| pair[1].wrapping_sub(pair[0]) == step)
}

/// Whether a process of the user id `user` may use a key file that the user id `owner` owns: only if the owner is that
/// user or root. So a process of root uses no key that another user could replace.
fn may_own(owner: u32, user: u32) -> bool {
    owner == user || owner == 0
}

fn parse(digits: &[u8]) -> Option<[u8; BYTES]> {
    HEXLOWER_PERMISSIVE.decode(digits).ok()?.try_into().ok()
}

/// Returns the fingerprint of a key: 8 hexadecimal digits of a hash, which reveal nothing else about the key.
pub fn fingerprint(key: &[u8; BYTES]) -> String {
    let mut digest = Hash::new();
    digest.update(b"murmurate team key\0");
    digest.update(key);
    HEXLOWER.encode(&digest.finalize()[..4])
}

/// Returns the access token of a page or of metrics: read from its file, or drawn at random without a file.
#[cfg(feature = "watch")]
pub fn token(file: Option<&Path>) -> Result<murmurate_view::access::Token> {
    if let Some(file) = file {
        return Ok(murmurate_view::access::Token::new(&read(file)?));
    }
    let mut bytes = [0; murmurate_view::access::TOKEN_BYTES];
    getrandom::fill(&mut bytes)
        .map_err(|error| anyhow::anyhow!("the operating system gives no random bytes: {error}"))?;
    Ok(murmurate_view::access::Token::new(&bytes))
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

    #[test]
    fn keys_that_were_typed_are_guessable_and_those_that_were_drawn_are_not() {
        let pattern = |of: &dyn Fn(usize) -> u8| std::array::from_fn::<u8, BYTES, _>(of);
        for typed in [
            pattern(&|_| 0),
            pattern(&|_| 0x5a),
            pattern(&|at| [0xde, 0xad, 0xbe, 0xef][at % 4]),
            pattern(&|at| [0x01, 0x23, 0x45, 0x67, 0x89, 0xab, 0xcd, 0xef][at % 8]),
            pattern(&|at| at as u8),
            pattern(&|at| 255 - at as u8),
        ] {
            assert!(is_guessable(&typed), "{typed:02x?}");
        }
        assert!(!is_guessable(&pattern(&|at| (at * at) as u8)));
        assert!((0..1000u32).all(|at| !is_guessable(&Hash::hash(&at.to_le_bytes()))));
    }
}
