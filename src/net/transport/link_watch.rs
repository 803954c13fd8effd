//! Watch for changes of network interfaces, for a thread that opens sockets again: by notices of the kernel on Linux,
//! and by looking periodically elsewhere. Control threads do not use it.

#[cfg(target_os = "linux")]
pub use super::netlink::LinkWatch;
pub use super::removed::Removed;

/// Stands for the kernel's notices, which are Linux's: interfaces are only looked at periodically.
#[cfg(not(target_os = "linux"))]
pub struct LinkWatch;

#[cfg(not(target_os = "linux"))]
impl LinkWatch {
    /// Returns the only watch there is.
    pub fn open() -> LinkWatch {
        LinkWatch
    }

    /// Whether the system tells of changes.
    pub fn is_told(&self) -> bool {
        false
    }

    /// Waits this long. What was removed is seen by looking.
    pub fn wait(&self, longest: std::time::Duration) -> Removed {
        std::thread::park_timeout(longest);
        Removed::Only(Vec::new())
    }
}
