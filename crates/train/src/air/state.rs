//! State of the air of many teams as bytes, from which another one continues to the bit: a digest of all that follows,
//! and the state (MessagePack with names).

use serde::{Deserialize, Serialize};

use super::row::Row;
use super::{Air, Options};
use crate::vector::{StateError, check_version, same_settings};

#[derive(Serialize, Deserialize)]
struct Stored {
    version: String,
    options: Options,
    rows: Vec<Row>,
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
    let (digest, body) = bytes.split_first_chunk::<32>().ok_or_else(|| damaged("it ends too early"))?;
    if blake3::hash(body) != blake3::Hash::from_bytes(*digest) {
        return Err(damaged("its digest does not match its content"));
    }
    let stored: Stored = rmp_serde::from_slice(body).map_err(|error| StateError::Damaged(error.to_string()))?;
    check_version(&stored.version)?;
    stored.options.check().map_err(|error| StateError::Damaged(error.to_string()))?;
    let fits = stored.rows.iter().all(|row| row.fits(&stored.options));
    if stored.rows.len() != stored.options.environments || !fits {
        return Err(damaged("its messages do not fit its settings"));
    }
    Ok(stored)
}

impl Air {
    /// Returns the whole state as bytes.
    pub fn state(&self) -> Vec<u8> {
        let version = env!("CARGO_PKG_VERSION").to_owned();
        let stored = Stored { version, options: self.options.clone(), rows: self.rows.clone() };
        let body = rmp_serde::to_vec_named(&stored).expect("a state is plain data");
        [blake3::hash(&body).as_bytes().as_slice(), &body].concat()
    }

    /// Continues from a state of an air with these options; seed and number of threads may differ.
    ///
    /// # Errors
    /// If the bytes are no such state; nothing has changed then.
    pub fn set_state(&mut self, bytes: &[u8]) -> Result<(), StateError> {
        let stored = read(bytes)?;
        same_settings(&stored.options, &self.options)?;
        (self.options.seed, self.rows) = (stored.options.seed, stored.rows);
        Ok(())
    }
}
