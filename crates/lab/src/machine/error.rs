//! Why a laboratory cannot be had, and how an error of the machine becomes such a reason.

use std::fmt::Display;

/// Why something about a laboratory cannot be done.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum LabError {
    /// What was asked for is wrong: the text says what to ask for instead.
    #[error("{0}")]
    Wrong(String),
    /// The machine lacks something, or something on it has failed; the text says what.
    #[error("{0}")]
    Failed(String),
}

/// Result of work on a laboratory.
pub type Result<T, E = LabError> = std::result::Result<T, E>;

/// Returns an error that something on this machine has failed.
pub(super) fn failed<T>(why: String) -> Result<T> {
    Err(LabError::Failed(why))
}

/// Puts what was tried before the reason of an error.
pub(super) trait Context<T> {
    /// Returns the value, or an error that begins with `tried`.
    fn context(self, tried: &str) -> Result<T>;

    /// Like [`Context::context`], with a text that is made only for an error.
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
