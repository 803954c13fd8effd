//! A key as hexadecimal digits: read, judged, and known by its fingerprint.

use std::path::Path;

use anyhow::Result;
use data_encoding::{HEXLOWER, HEXLOWER_PERMISSIVE};
use hmac_sha256::Hash;

use crate::BadInput;

/// Length of a key \[bytes\].
pub const BYTES: usize = 32;

/// Returns the error of the key file `path` for this reason.
pub fn refuse<T>(path: &Path, why: &str) -> Result<T> {
    Err(BadInput(format!("the key file '{}' {why}", path.display())).into())
}

/// Whether a key was typed and not drawn: its bytes repeat within eight, as zeros do, or count up or down. A key of
/// `key new` is so with a probability below 2^-180.
pub fn is_guessable(key: &[u8; BYTES]) -> bool {
    let repeats = (1..=8).any(|period| key.iter().zip(&key[period..]).all(|(one, other)| one == other));
    let step = key[1].wrapping_sub(key[0]);
    repeats || key.windows(2).all(|pair| pair[1].wrapping_sub(pair[0]) == step)
}

/// Returns the key of these hexadecimal digits; `None` if they are none of a key.
pub fn parse(digits: &[u8]) -> Option<[u8; BYTES]> {
    HEXLOWER_PERMISSIVE.decode(digits).ok()?.try_into().ok()
}

/// Returns the fingerprint of a key: 8 hexadecimal digits of a hash, which reveal nothing else about the key.
pub fn fingerprint(key: &[u8; BYTES]) -> String {
    let mut digest = Hash::new();
    digest.update(b"murmurate team key\0");
    digest.update(key);
    HEXLOWER.encode(&digest.finalize()[..4])
}

#[cfg(test)]
mod tests {
    use super::*;

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
