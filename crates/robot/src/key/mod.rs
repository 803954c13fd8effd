//! Keys of a team, in files that only their owner may read: `file` reads them, `member` has those of one host or
//! operator, `root` that which signs the lists of members, `kept` the newest roster on disk, and `digits` one key.
//! `new`, `change` and `spread` are the commands that make keys, change rosters and send them. Keys are never printed.

mod change;
pub mod command;
mod digits;
mod file;
pub mod kept;
mod member;
mod new;
mod root;
mod spread;

#[cfg(feature = "watch")]
use std::path::Path;

#[cfg(feature = "watch")]
use anyhow::Result;

pub use digits::fingerprint;
pub use file::{KeyFile, read};

/// Returns the access token of a page or of metrics: read from its file, or drawn at random without a file.
#[cfg(feature = "watch")]
pub fn token(file: Option<&Path>) -> Result<murmurate_view::access::Token> {
    if let Some(file) = file {
        return Ok(murmurate_view::access::Token::new(&file::read_plain(file)?));
    }
    let mut bytes = [0; murmurate_view::access::TOKEN_BYTES];
    getrandom::fill(&mut bytes)
        .map_err(|error| anyhow::anyhow!("the operating system gives no random bytes: {error}"))?;
    Ok(murmurate_view::access::Token::new(&bytes))
}
