//! The newest roster of a member on disk, beside its key file or in the folder of the service's state. A roster is in
//! force once it is there, so that a restart does not go back to an older one.

use std::fs;
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;

use anyhow::Result;
use murmurate::net::protocol::codec::Frame;

use super::digits::{BYTES, fingerprint};
use crate::destination::folder;
use crate::whole_file::WholeFile;

/// Number of rosters that wait to be written; further ones arrive again.
const WAITING: usize = 4;

/// Place of the newest roster of a member.
#[derive(Clone, Debug)]
pub struct Kept(PathBuf);

impl Kept {
    /// Returns the place for the member whose key file is `key_file`, in a team with the public root key `root`: in the
    /// service's state folder if there is one, or else beside the key file. New keys of a team have another place.
    pub fn of(key_file: &Path, root: &[u8; BYTES]) -> Kept {
        let state = std::env::var_os("STATE_DIRECTORY").map(PathBuf::from);
        let state = state.filter(|folder| !folder.as_os_str().is_empty());
        let folder = state.as_deref().or(key_file.parent()).unwrap_or(Path::new(""));
        let stem = key_file.file_stem().unwrap_or_default().to_string_lossy();
        Kept(folder.join(format!("{stem}-{}.roster", fingerprint(root))))
    }

    /// Returns the path.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Returns the roster; `None` if there is none yet.
    pub fn read(&self) -> io::Result<Option<Vec<u8>>> {
        match fs::read(&self.0) {
            Ok(sealed) => Ok(Some(sealed)),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Writes the roster, whole or not at all, and waits until it is on disk.
    pub fn write(&self, sealed: &[u8]) -> Result<()> {
        let mut file = WholeFile::create(&self.0)?;
        file.write_all(sealed)?;
        file.keep()?;
        // The name, too.
        Ok(fs::File::open(folder(&self.0))?.sync_all()?)
    }

    /// Writes the roster, and returns whether it is on disk. If not, an error is logged.
    pub fn keep(&self, sealed: &[u8]) -> bool {
        let written = self.write(sealed);
        if let Err(error) = &written {
            let path = self.0.display();
            tracing::error!(
                "a new roster cannot be written to '{path}': {error:#}; until it can, a host keeps its former keys, \
                 and hears no other"
            );
        }
        written.is_ok()
    }
}

/// Thread that writes the rosters of a host, whose control thread waits for no disk.
pub struct Keeper {
    wanted: SyncSender<(u32, Frame)>,
    kept: Receiver<u32>,
}

impl Keeper {
    /// Starts the thread.
    pub fn open(place: Kept) -> io::Result<Keeper> {
        let (wanted, rosters) = sync_channel::<(u32, Frame)>(WAITING);
        let (written, kept) = sync_channel(WAITING);
        thread::Builder::new().name("rosters".to_owned()).spawn(move || {
            for (number, sealed) in rosters {
                // The host is asked for what it has kept after every turn, so there is room.
                if place.keep(&sealed) && written.send(number).is_err() {
                    return;
                }
            }
        })?;
        Ok(Keeper { wanted, kept })
    }

    /// Has the roster with this number written. One that does not fit arrives again.
    pub fn keep(&self, number: u32, sealed: &Frame) {
        let _ = self.wanted.try_send((number, Frame::clone(sealed)));
    }

    /// Returns the number of a roster that is on disk now, once; `None` if there is none.
    pub fn kept(&self) -> Option<u32> {
        self.kept.try_recv().ok()
    }
}
