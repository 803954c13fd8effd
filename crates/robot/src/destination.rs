//! Destinations of output files. A link in a folder that others can write may have been planted there, so that this
//! program, running as root, would overwrite what it leads to: such a link is not followed.

use std::fs::{self, File};
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use nix::unistd::geteuid;

/// Largest number of links that are followed one after the other, as in Linux.
const MOST_LINKS: usize = 40;
/// Permissions of a folder by which its group or all others can write in it.
const WRITABLE_BY_OTHERS: u32 = 0o022;

/// Where an output goes: a file that is written beside its place and renamed, or something that is open already.
pub enum Destination {
    /// A file, which may not be there yet. What is at this path is replaced and not followed. The text is a note for
    /// the user if that is a link.
    File(PathBuf, Option<String>),
    /// An existing pipe, device or open file descriptor, such as `/dev/stdout`, that is written to directly.
    Stream(PathBuf),
}

impl Destination {
    /// Returns where output to `path` goes. Links are followed while this user or root has made them, in folders in
    /// which nobody else can write. Any other link is replaced by the file.
    ///
    /// # Errors
    /// If the path is a folder, or another user's pipe or device in a folder that others can write. The text says so.
    pub fn of(path: &Path) -> Result<Destination, String> {
        let mut place = path.to_owned();
        for _ in 0..MOST_LINKS {
            let Ok(about) = place.symlink_metadata() else { return Ok(Destination::File(place, None)) };
            let kind = about.file_type();
            if kind.is_dir() {
                return Err("it is a folder; name a file in it".to_owned());
            }
            if kind.is_file() {
                return Ok(Destination::File(place, None));
            }
            let planted = is_shared(folder(&place)) || !is_ours(about.uid());
            if !kind.is_symlink() {
                return match planted && !is_ours(about.uid()) {
                    true => Err(format!("it is no file, and user {} has put it there; name a file", about.uid())),
                    false => Ok(Destination::Stream(place)),
                };
            }
            if planted {
                let note = format!(
                    "'{}' was a link in a folder that others can write: it is replaced by a file, and what it led to \
                     is not changed",
                    place.display()
                );
                return Ok(Destination::File(place, Some(note)));
            }
            let target = fs::read_link(&place).map_err(|error| error.to_string())?;
            let next = folder(&place).join(target);
            // A link of /proc to a pipe, or to a file without a name, has no path.
            if place.metadata().is_ok() && next.symlink_metadata().is_err() {
                return Ok(Destination::Stream(place));
            }
            place = next;
        }
        Err("its links lead nowhere".to_owned())
    }

    /// Opens a pipe or a device for writing, as [`Destination::Stream`] names it. `flags` are further flags of `open`.
    pub fn open_stream(path: &Path, flags: i32) -> std::io::Result<File> {
        fs::OpenOptions::new().write(true).custom_flags(flags).open(path)
    }

    /// Whether `path` is a named pipe.
    pub fn is_pipe(path: &Path) -> bool {
        path.metadata().is_ok_and(|about| about.file_type().is_fifo())
    }
}

/// Checks a folder for output: a link to it, in a folder that others can write, may have been planted there. The error
/// says so.
pub fn check_folder(path: &Path) -> Result<(), String> {
    match path.symlink_metadata() {
        Ok(about) if about.is_symlink() && (is_shared(folder(path)) || !is_ours(about.uid())) => {
            Err("it is a link in a folder that others can write; name the folder itself".to_owned())
        }
        _ => Ok(()),
    }
}

/// Returns the folder of a file.
pub fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// Whether somebody else than this user and root can make links in a folder.
fn is_shared(folder: &Path) -> bool {
    // The kernel's own: their owners are others in containers, and nobody makes links there.
    if folder == Path::new("/dev") || folder.starts_with("/proc") {
        return false;
    }
    folder.metadata().map_or(true, |about| about.mode() & WRITABLE_BY_OTHERS != 0 || !is_ours(about.uid()))
}

fn is_ours(owner: u32) -> bool {
    owner == geteuid().as_raw() || owner == 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::{PermissionsExt, symlink};

    #[test]
    fn a_link_is_followed_only_where_nobody_else_can_have_made_it() {
        let place = tempfile::TempDir::new().unwrap();
        let (target, link) = (place.path().join("target"), place.path().join("link"));
        fs::write(&target, "kept").unwrap();
        symlink("target", &link).unwrap();
        let leads_to = || match Destination::of(&link).unwrap() {
            Destination::File(path, _) => path,
            Destination::Stream(path) => panic!("{} is a file", path.display()),
        };
        assert_eq!(leads_to(), target, "the folder is mine alone");
        fs::set_permissions(place.path(), fs::Permissions::from_mode(0o1777)).unwrap();
        assert_eq!(leads_to(), link, "anybody can have made it");
        let below = place.path().join("below");
        symlink("/", &below).unwrap();
        assert!(check_folder(&below).is_err() && check_folder(place.path()).is_ok());
        fs::set_permissions(place.path(), fs::Permissions::from_mode(0o700)).unwrap();
        assert!(check_folder(&below).is_ok());
    }

    #[test]
    fn what_is_open_already_is_written_to_directly() {
        assert!(matches!(Destination::of(Path::new("/dev/null")), Ok(Destination::Stream(_))));
        let pipe = std::io::pipe().unwrap();
        let path = format!("/dev/fd/{}", std::os::fd::AsRawFd::as_raw_fd(&pipe.1));
        assert!(matches!(Destination::of(Path::new(&path)), Ok(Destination::Stream(_))));
        assert!(Destination::of(Path::new("/tmp")).is_err(), "a folder is no file");
    }
}
