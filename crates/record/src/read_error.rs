//! Errors of reading records.

use std::path::PathBuf;

use super::identity::{METADATA, WrongIdentity};

/// Most bytes of attached files that are read of a record. Ours have a team file and a policy.
pub const MAX_ATTACHED: u64 = 1 << 26;

/// Error while a record is read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file cannot be opened or read.
    #[error("cannot read the record '{}': {error}", path.display())]
    Open {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        error: std::io::Error,
    },
    /// The file has no bytes, or only zeros.
    #[error("'{}' is empty: nothing was written{}", path.display(), if *zeros { " but zeros" } else { "" })]
    Empty {
        /// Path of the file.
        path: PathBuf,
        /// Whether it has bytes, which are all zero.
        zeros: bool,
    },
    /// The file is not MCAP.
    #[error("'{}' is no record: it is no MCAP file, and no part of one", path.display())]
    Strange {
        /// Path of the file.
        path: PathBuf,
    },
    /// The identity of the record in the file cannot be used by this program.
    #[error("'{}' is no record of this program: {error}", path.display())]
    Foreign {
        /// Path of the file.
        path: PathBuf,
        /// Text that says what is wrong with the identity.
        error: WrongIdentity,
    },
    /// The file has no metadata `murmurate.run`, so it is not a record of this program.
    #[error("'{}' is no record of this program: it has no metadata '{METADATA}'", path.display())]
    Nameless {
        /// Path of the file.
        path: PathBuf,
    },
    /// The metadata `murmurate.run` are damaged, so times and host are not known.
    #[error("'{}' is damaged and has no intact '{METADATA}': its times and its host are not known", path.display())]
    Unidentified {
        /// Path of the file.
        path: PathBuf,
    },
    /// The attached files are larger than this program reads.
    #[error("'{}': its attached files have more than {} MB, which no record of this program has", path.display(),
        MAX_ATTACHED >> 20)]
    Attached {
        /// Path of the file.
        path: PathBuf,
    },
}
