//! Errors of replays.

use std::cell::RefCell;
use std::rc::Rc;

use murmurate::live::OpenError;
use murmurate::trial::TrialError;
use murmurate_record::compare::{Compared, Comparison};
use murmurate_record::reader::ReadError;

/// Error of a replay, or of its comparison with the record.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The record has a value that cannot be used; the text names the record.
    #[error("{0}")]
    Unusable(String),
    /// The settings in the record are no valid run.
    #[error(transparent)]
    Trial(#[from] TrialError),
    /// The host of the record cannot be built.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// The record cannot be read to its end.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The comparison is still in use by a run that has ended: a bug.
    #[error("a run that has ended is still observed: a bug")]
    Observed,
}

/// Ends a comparison that was shared with the run, and returns its result.
pub(crate) fn finish(comparison: Rc<RefCell<Comparison>>) -> Result<Compared, ReplayError> {
    let comparison = Rc::try_unwrap(comparison).ok().ok_or(ReplayError::Observed)?;
    Ok(comparison.into_inner().finish()?)
}
