//! Identity of the running program: the digest of the sources of all its packages.

use std::sync::OnceLock;

/// Digest of the program.
static DIGEST: OnceLock<String> = OnceLock::new();

/// Sets the digests of the packages of which this program consists. A second call must have the same ones.
pub fn set(packages: &[&str]) {
    DIGEST.get_or_init(|| murmurate_digest::combine(packages));
}

/// Returns the digest of the sources that this program was built from, as 16 hexadecimal digits. Programs with equal
/// digests behave equally.
pub fn digest() -> &'static str {
    // The program of a robot consists of these alone.
    set(&[
        murmurate::DIGEST,
        crate::DIGEST,
        murmurate_crazyflie::DIGEST,
        murmurate_devices::DIGEST,
        murmurate_mavlink::DIGEST,
        murmurate_onnx::DIGEST,
        murmurate_ros2::DIGEST,
        murmurate_tasks::DIGEST,
        murmurate_zenoh::DIGEST,
        #[cfg(feature = "record")]
        murmurate_record::DIGEST,
        #[cfg(feature = "watch")]
        murmurate_view::DIGEST,
    ]);
    DIGEST.get().expect("it is set")
}
