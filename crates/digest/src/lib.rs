//! Digest of a package's sources, for its build script: records must not outlive the program that made them. It depends
//! on nothing but the files: the same from a clone, from a tarball, on any machine and in any folder.
//!
//! Each package has a digest of its own, so that an edit of one does not build those below it again. A program combines
//! the digests of its packages.

use std::path::{Path, PathBuf};
use std::{env, fs, io};

/// Sets the variable `SOURCE_DIGEST` of the package whose build script calls this: the digest of the files at and below
/// the paths in `sources`, relative to the package, as 16 hexadecimal digits.
///
/// # Errors
/// If a file cannot be read.
pub fn emit(sources: &[&str]) -> io::Result<()> {
    let root = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").expect("cargo sets it"));
    let mut files = Vec::new();
    for name in sources {
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

/// Combines digests of packages into one of a program, as 16 hexadecimal digits.
pub fn combine(digests: &[&str]) -> String {
    let mut all = Digest::new();
    digests.iter().for_each(|digest| all.add(digest.as_bytes()));
    format!("{:016x}", all.0)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_combined_digest_depends_on_each_and_on_their_order() {
        assert_eq!(combine(&["a", "b"]).len(), 16);
        let others: [&[&str]; 3] = [&["b", "a"], &["ab", ""], &["a"]];
        assert!(others.iter().all(|other| combine(other) != combine(&["a", "b"])));
    }
}
