//! Recognition of kinds of files by their first bytes, for errors that say what a file is and what to do with it.

/// Kind of a file that people give in place of another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A file without any byte.
    Empty,
    /// A policy file, or other tensors in the safetensors format.
    Safetensors,
    /// A zip archive, as `torch.save` writes checkpoints of PyTorch.
    Zip,
    /// A Python pickle, as `torch.save` wrote checkpoints before PyTorch 1.6.
    Pickle,
    /// A file of HDF5, as Keras writes weights.
    Hdf5,
    /// A record of a run (MCAP).
    Record,
    /// The state of a training of this program, `checkpoint.bin`.
    Checkpoint,
    /// A text in UTF-8.
    Text,
}

impl FileKind {
    /// Returns the kind of a file, of which `bytes` is the whole content; `None` if it is none of these.
    pub(crate) fn of(bytes: &[u8]) -> Option<FileKind> {
        // A map of MessagePack with up to 15 fields, or with their number in two bytes, and its first name.
        let begins_with_format = |at: usize| bytes.get(at..).is_some_and(|rest| rest.starts_with(b"\xa6format"));
        match bytes {
            [] => Some(FileKind::Empty),
            [b'P', b'K', 3, 4, ..] => Some(FileKind::Zip),
            [0x80, 2..=5, ..] => Some(FileKind::Pickle),
            [0x89, b'H', b'D', b'F', ..] => Some(FileKind::Hdf5),
            [0x89, b'M', b'C', b'A', b'P', ..] => Some(FileKind::Record),
            [0x80..=0x8f, ..] if begins_with_format(1) => Some(FileKind::Checkpoint),
            [0xde, ..] if begins_with_format(3) => Some(FileKind::Checkpoint),
            // Eight bytes with the length of a JSON object, which is short of 4 GB.
            [_, _, _, _, 0, 0, 0, 0, b'{', ..] => Some(FileKind::Safetensors),
            _ if std::str::from_utf8(bytes).is_ok_and(|text| !text.contains('\0')) => Some(FileKind::Text),
            _ => None,
        }
    }

    /// Returns what a file is that was given in place of a training's checkpoint, and what to give; `None` if it may be
    /// one, whole or damaged.
    pub fn no_checkpoint(bytes: &[u8]) -> Option<&'static str> {
        match FileKind::of(bytes)? {
            FileKind::Empty | FileKind::Checkpoint => None,
            FileKind::Safetensors => {
                Some("a policy file, which has no optimiser state: give the 'checkpoint.bin' of its training instead")
            }
            FileKind::Zip | FileKind::Pickle => Some("a PyTorch checkpoint, which this trainer cannot continue"),
            FileKind::Hdf5 => Some("a file of HDF5, which this trainer cannot continue"),
            FileKind::Record => Some("a record of a run, and no checkpoint of a training"),
            FileKind::Text => Some("a text, and no checkpoint of a training, which is called 'checkpoint.bin'"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_are_told_by_their_first_bytes() {
        assert_eq!(FileKind::of(b""), Some(FileKind::Empty));
        assert_eq!(FileKind::of(b"PK\x03\x04..."), Some(FileKind::Zip));
        assert_eq!(FileKind::of(b"\x80\x02}q\0."), Some(FileKind::Pickle));
        assert_eq!(FileKind::of(b"\x8c\xa6format\x01"), Some(FileKind::Checkpoint));
        assert_eq!(FileKind::of(b"\x02\0\0\0\0\0\0\0{}"), Some(FileKind::Safetensors));
        assert_eq!(FileKind::of(b"robots = 5\n"), Some(FileKind::Text));
        assert_eq!(FileKind::of(&[0xff; 64]), None);
    }
}
