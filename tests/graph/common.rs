//! Shared by several tests: access to the reference data, the end of workers, and the interface of a policy.

use std::path::{Path, PathBuf};
use std::time::Duration;

use murmurate::edge::Running;
use murmurate::policy::Interface;
use murmurate::time::Span;
use safetensors::SafeTensors;

use crate::skip::skip;

/// Returns a file of the reference data; `None`, and the test is skipped, if it is absent.
pub fn reference(name: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("MURMURATE_REFERENCE").map(PathBuf::from);
    let folder = folder.unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/reference"));
    let path = folder.join(name);
    if path.exists() {
        return Some(path);
    }
    skip("reference", "the folder MURMURATE_REFERENCE has no reference data");
    None
}

/// Longest wait for what a worker does at once. No machine is as slow: only a worker that hangs takes it.
pub const HANGS: Duration = Duration::from_secs(60);

/// Waits for the end of a worker whose host has ended.
pub fn ends(worker: Running, name: &str) {
    assert!(worker.join(HANGS), "{name}: it does not end with its host");
}

/// A tensor of 32-bit floats, row-major.
pub fn floats(tensors: &SafeTensors, name: &str) -> Vec<f32> {
    let data = tensors.tensor(name).expect(name);
    data.data().as_chunks::<4>().0.iter().map(|four| f32::from_le_bytes(*four)).collect()
}

/// A tensor of 32-bit integers.
pub fn integers(tensors: &SafeTensors, name: &str) -> Vec<i32> {
    let data = tensors.tensor(name).expect(name);
    data.data().as_chunks::<4>().0.iter().map(|four| i32::from_le_bytes(*four)).collect()
}

/// A tensor of bytes.
pub fn bytes(tensors: &SafeTensors, name: &str) -> Vec<u8> {
    tensors.tensor(name).expect(name).data().to_vec()
}

/// Interface of a policy that broadcasts nothing and steps 20 times a second.
pub const INTERFACE: Interface = Interface {
    features: 0,
    radius_m: 2.0,
    period: Span::from_millis(50),
    limit_m_s: 1.0,
    hold: Span::from_millis(200),
};
