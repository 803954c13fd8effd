//! Refusals of graphs: the error that says why a file is no graph of a policy.

/// Error: a file is no graph that a policy may consist of; the text says why.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct StructureError(String);

pub(crate) fn refuse<T>(why: impl Into<String>) -> Result<T, StructureError> {
    Err(StructureError(why.into()))
}

/// Returns a name from a file as an error shows it: without control characters, and not too long.
pub(crate) fn shown(name: &str) -> &str {
    let plain = name.len() <= 60 && name.chars().all(|c| c.is_ascii_graphic() || c == ' ');
    if plain { name } else { "(an unusual name)" }
}
