//! Errors of an import: each is one line that names the file, and the line, field or message in it.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use murmurate::config::{ConfigError, shown};

/// Error of an import: what is wrong, in which file and where.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// The mapping cannot be used; the error names the line or the field.
    #[error("the mapping '{}': {}", shown::value(path.display()), shown::value(error))]
    Mapping {
        /// Path of the mapping.
        path: PathBuf,
        /// Error in it, with the field.
        error: ConfigError,
    },
    /// A file of the run cannot be used.
    #[error("'{}': {}", shown::value(path.display()), shown::value(why))]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Place in the file, such as `line 7: `, and what is wrong there.
        why: String,
    },
}

impl ImportError {
    /// Makes the error of a file of the run. `why` names the place in it, and says what is wrong there.
    pub fn file(path: &Path, why: impl Display) -> ImportError {
        ImportError::File { path: path.to_owned(), why: why.to_string() }
    }
}
