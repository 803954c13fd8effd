//! Shared by several tests: access to the reference data.

use std::io::Write;
use std::path::{Path, PathBuf};

use safetensors::SafeTensors;

/// Returns a file of the reference data; `None`, with a notice, if it is absent.
pub fn reference(name: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("MURMURATE_REFERENCE").map(PathBuf::from);
    let folder = folder.unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/reference"));
    let path = folder.join(name);
    if path.exists() {
        return Some(path);
    }
    // Directly to stderr, because the output of a passing test is captured.
    let where_from = "set MURMURATE_REFERENCE to the folder of the reference data";
    let line = format!("skipped: there is no '{}'; {where_from}\n", path.display());
    let _ = std::io::stderr().write_all(line.as_bytes());
    None
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
