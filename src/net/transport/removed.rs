//! Network interfaces that were removed.

/// Interfaces that were removed since the last look, also if another of the same number has taken their place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Removed {
    /// The interfaces with these numbers.
    Only(Vec<u32>),
    /// The kernel has dropped notices, so it may be any.
    Unknown,
}

impl Removed {
    /// Whether the interface with the number `index` was or may have been removed.
    pub fn has(&self, index: u32) -> bool {
        match self {
            Removed::Only(all) => all.contains(&index),
            Removed::Unknown => true,
        }
    }
}
