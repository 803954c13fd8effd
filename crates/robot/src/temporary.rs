//! Temporary files beside their final place, which get their name once they are complete.

use std::fs::OpenOptions;
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use tempfile::{Builder, NamedTempFile};

/// Creates an empty file with a random name in the folder `folder`. `mode` are its permissions, which the umask may
/// reduce.
///
/// It is written by its inner file: errors of its own `Write` name the random path, and those of users the final one.
pub fn file_in(folder: &Path, mode: u32) -> io::Result<NamedTempFile> {
    let create = |path: &Path| OpenOptions::new().read(true).write(true).create_new(true).mode(mode).open(path);
    Builder::new().prefix(".murmurate-").suffix(".tmp").rand_bytes(16).make_in(folder, create)
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn a_file_has_its_permissions_from_the_start_and_is_removed_without_a_name() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("whole");
        let file = file_in(folder.path(), 0o600).unwrap();
        assert_eq!(file.as_file().metadata().unwrap().permissions().mode() & 0o777, 0o600);
        drop(file);
        file_in(folder.path(), 0o600).unwrap().persist(&path).unwrap();
        assert_eq!(path.metadata().unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        let missing = file_in(&folder.path().join("missing"), 0o600).unwrap_err();
        assert!(!missing.to_string().contains("missing"), "{missing}");
    }
}
