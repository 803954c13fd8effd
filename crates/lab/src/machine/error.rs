//! Errors of laboratories, and the context that is put before errors of the machine.

use std::fmt::Display;

/// Error of an operation on a laboratory.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum LabError {
    /// The request is invalid; the text says how to correct it.
    #[error("{0}")]
    Invalid(String),
    /// The machine lacks something, or an operation on it has failed; the text says which.
    #[error("{0}")]
    Failed(String),
}

/// Result of an operation on a laboratory.
pub type Result<T, E = LabError> = std::result::Result<T, E>;

/// Returns a [`LabError::Failed`] with this text.
pub(super) fn failed<T>(why: String) -> Result<T> {
    Err(LabError::Failed(why))
}

/// Adds the attempted operation to an error.
pub(super) trait Context<T> {
    /// Returns the value, or an error that begins with `tried`.
    fn context(self, tried: &str) -> Result<T>;

    /// Like [`Context::context`], with a text that is only made in case of an error.
    fn with_context<S: Display>(self, tried: impl FnOnce() -> S) -> Result<T>;
}

impl<T, E: Display> Context<T> for std::result::Result<T, E> {
    fn context(self, tried: &str) -> Result<T> {
        self.with_context(|| tried)
    }

    fn with_context<S: Display>(self, tried: impl FnOnce() -> S) -> Result<T> {
        self.map_err(|error| LabError::Failed(format!("{}: {error}", tried())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_says_what_was_tried_and_why_it_failed() {
        let error = "x".parse::<u8>().context("cannot read a number").unwrap_err();
        assert_eq!(error.to_string(), "cannot read a number: invalid digit found in string");
        let outer = Err::<(), _>(error).with_context(|| "station 3");
        let why = "station 3: cannot read a number: invalid digit found in string";
        assert_eq!(outer, failed(why.to_owned()));
    }
}
