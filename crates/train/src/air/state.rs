//! State of the air of many teams as bytes, from which another one continues to the bit.

use serde::{Deserialize, Serialize};

use super::row::Row;
use super::{Air, Options};

/// Error: bytes are not a state of the air of such teams.
#[derive(Debug, thiserror::Error)]
pub enum StateError {
    /// The bytes are not what `Air::state` returns, or were changed since.
    #[error("these bytes are no whole state of a channel: {0}")]
    Damaged(String),
    /// The state is of another version of the program, whose next step may have other bits.
    #[error("the state is of {theirs}, and this is {ours}; states are for the version that took them")]
    Version {
        /// What took the state.
        theirs: String,
        /// What was to continue from it.
        ours: String,
    },
    /// The environments have other options.
    #[error("the state is of a channel with other options; make one like it with Channel.from_state")]
    Other,
}

#[derive(Serialize, Deserialize)]
struct Stored {
    version: String,
    options: Options,
    rows: Vec<Row>,
}

fn version() -> String {
    format!("murmurate {} ({})", env!("CARGO_PKG_VERSION"), &crate::DIGEST[..12.min(crate::DIGEST.len())])
}

/// Returns the options of the air of which `bytes` is a state.
///
/// # Errors
/// If the bytes are no whole state of this version.
pub fn options_of(bytes: &[u8]) -> Result<Options, StateError> {
    read(bytes).map(|stored| stored.options)
}

fn read(bytes: &[u8]) -> Result<Stored, StateError> {
    let damaged = |why: &str| StateError::Damaged(why.to_owned());
    let (sum, body) = bytes.split_first_chunk::<32>().ok_or_else(|| damaged("they are too few"))?;
    if *sum != *blake3::hash(body).as_bytes() {
        return Err(damaged("their digest is another"));
    }
    let stored: Stored = rmp_serde::from_slice(body).map_err(|error| StateError::Damaged(error.to_string()))?;
    if stored.version != version() {
        return Err(StateError::Version { theirs: stored.version, ours: version() });
    }
    Ok(stored)
}

impl Air {
    /// Returns the whole state as bytes.
    pub fn state(&self) -> Vec<u8> {
        let stored = Stored { version: version(), options: self.options.clone(), rows: self.rows.clone() };
        let body = rmp_serde::to_vec_named(&stored).expect("a state is plain data");
        [blake3::hash(&body).as_bytes().as_slice(), &body].concat()
    }

    /// Continues from a state of an air with these options; seed and number of threads may differ.
    ///
    /// # Errors
    /// If the bytes are no such state; nothing has changed then.
    pub fn set_state(&mut self, bytes: &[u8]) -> Result<(), StateError> {
        let stored = read(bytes)?;
        let Options { threads, seed, .. } = self.options;
        if (Options { threads, seed, ..stored.options.clone() }) != self.options {
            return Err(StateError::Other);
        }
        (self.options.seed, self.rows) = (stored.options.seed, stored.rows);
        Ok(())
    }
}
