//! Wi-Fi cards as the kernel tells them (nl80211), and what the links of a team need of them.
//!
//! `card` has the data, `ask` asks the kernel for it, and `advice` says what is wrong and which command mends it.
//! Nothing is changed: reading needs no rights.

mod advice;
#[cfg(target_os = "linux")]
mod ask;
mod card;

pub use advice::findings;
#[cfg(target_os = "linux")]
pub use ask::look;
pub use card::{Card, Combination, Load, Mode, Peer};

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");

/// Returns that no interface is a Wi-Fi card: only Linux is asked.
#[cfg(not(target_os = "linux"))]
pub fn look(_: &str) -> std::io::Result<Option<Card>> {
    Ok(None)
}
