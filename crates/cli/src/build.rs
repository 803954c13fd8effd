//! Identity of this program: the digest of the sources of all its packages.

use std::sync::OnceLock;

/// Returns the digest of the sources that this program was built from, as 16 hexadecimal digits. Programs with equal
/// digests behave equally.
pub fn digest() -> &'static str {
    static DIGEST: OnceLock<String> = OnceLock::new();
    DIGEST.get_or_init(|| {
        murmurate_digest::combine(&[
            murmurate::DIGEST,
            #[cfg(feature = "report")]
            murmurate_figures::DIGEST,
            #[cfg(feature = "lab")]
            murmurate_lab::DIGEST,
            #[cfg(feature = "record")]
            murmurate_record::DIGEST,
            murmurate_ros2::DIGEST,
            #[cfg(feature = "study")]
            murmurate_study::DIGEST,
            #[cfg(feature = "train")]
            murmurate_train::DIGEST,
            #[cfg(feature = "watch")]
            murmurate_view::DIGEST,
            murmurate_zenoh::DIGEST,
            env!("SOURCE_DIGEST"),
        ])
    })
}
