//! Which network interfaces were removed, for a thread that opens sockets again: from notices of the kernel on Linux, and
//! by looking periodically elsewhere. Control threads do not use it.

#[cfg(target_os = "linux")]
pub use super::netlink::LinkWatch;

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

/// Stands for the kernel's notices, which are Linux's: interfaces are only looked at periodically.
#[cfg(not(target_os = "linux"))]
pub struct LinkWatch;

#[cfg(not(target_os = "linux"))]
impl LinkWatch {
    /// Returns the only watch there is.
    pub fn open() -> LinkWatch {
        LinkWatch
    }

    /// Waits this long. What was removed is seen by looking.
    pub fn wait(&self, longest: std::time::Duration) -> Removed {
        std::thread::park_timeout(longest);
        Removed::Only(Vec::new())
    }
}
