//! Digest of the sources, for records that must not outlive the program that made them. Depends on nothing but the
//! files: the same from a clone, from a tarball, on any machine and in any folder.

use std::path::{Path, PathBuf};
use std::{env, fs, io};

/// The files that decide what a run computes.
const SOURCES: [&str; 4] = ["src", "policies", "Cargo.toml", "Cargo.lock"];

fn main() -> io::Result<()> {
    let root = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").expect("cargo sets it"));
    let mut files = Vec::new();
    for name in SOURCES {
        println!("cargo:rerun-if-changed={name}");
        collect(&root.join(name), &mut files)?;
    }
    let mut files: Vec<(String, PathBuf)> = files.into_iter().map(|path| (place(&root, &path), path)).collect();
    files.sort();
    let mut digest = Digest::new();
    for (name, path) in files {
        digest.add(name.as_bytes());
        // In a package the manifest is written anew, and the one of the clone lies beside it.
        let original = if name == "Cargo.toml" { root.join("Cargo.toml.orig") } else { path.clone() };
        digest.add(&fs::read(if original.is_file() { original } else { path })?);
    }
    println!("cargo:rustc-env=SOURCE_DIGEST={:016x}", digest.0);
    Ok(())
}

fn place(root: &Path, path: &Path) -> String {
    path.strip_prefix(root).expect("it is below").to_string_lossy().replace('\\', "/")
}

/// All files at and below a path; what is not there (a package may lack its lock file) is left out.
fn collect(path: &Path, files: &mut Vec<PathBuf>) -> io::Result<()> {
    if path.is_dir() {
        for entry in fs::read_dir(path)? {
            collect(&entry?.path(), files)?;
        }
    } else if path.is_file() {
        files.push(path.to_owned());
    }
    Ok(())
}

/// FNV-1a with 64 bits: tells versions apart, and nothing more is asked of it.
struct Digest(u64);

impl Digest {
    fn new() -> Digest {
        Digest(0xcbf2_9ce4_8422_2325)
    }

    /// Adds a piece and its length, so that no two lists of pieces are alike.
    fn add(&mut self, piece: &[u8]) {
        let length = (piece.len() as u64).to_le_bytes();
        for byte in length.iter().chain(piece) {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
}
