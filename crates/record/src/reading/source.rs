//! Bytes of a file that are read at any place, by a buffer of fixed size.

use std::io::{self, BufReader, Read, Seek, SeekFrom};

/// Size of the buffer \[bytes\].
const BUFFER: usize = 1 << 16;

/// Source from which a record can be read: a file, or bytes in memory.
pub trait Seekable: Read + Seek {}

impl<T: Read + Seek> Seekable for T {}

/// File, or bytes in memory, whose length is known.
pub struct Source {
    inner: BufReader<Box<dyn Seekable>>,
    at: u64,
    length: u64,
}

impl Source {
    /// Returns the bytes of `inner`, from its beginning to its present end.
    pub fn new(mut inner: impl Seekable + 'static) -> io::Result<Source> {
        let length = inner.seek(SeekFrom::End(0))?;
        inner.seek(SeekFrom::Start(0))?;
        Ok(Source { inner: BufReader::with_capacity(BUFFER, Box::new(inner)), at: 0, length })
    }

    /// Returns the length of the file when it was opened \[bytes\].
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Reads the bytes at the place `at` into all of `into`.
    pub fn read(&mut self, at: u64, into: &mut [u8]) -> io::Result<()> {
        // A place is below the length of a file, which has 63 bits.
        self.inner.seek_relative(at.wrapping_sub(self.at) as i64)?;
        self.at = at;
        self.inner.read_exact(into)?;
        self.at += into.len() as u64;
        Ok(())
    }

    /// Returns the `length` bytes at the place `at`, which the caller knows to be in the file.
    pub fn bytes(&mut self, at: u64, length: u64) -> io::Result<Vec<u8>> {
        let mut bytes = vec![0; length.min(self.length.saturating_sub(at)) as usize];
        self.read(at, &mut bytes)?;
        Ok(bytes)
    }

    /// Calls `each` with the bytes from `from` to `to`, a piece at a time.
    pub fn pieces(&mut self, mut from: u64, to: u64, mut each: impl FnMut(&[u8])) -> io::Result<()> {
        let mut piece = vec![0; BUFFER];
        while from < to {
            let length = (to - from).min(BUFFER as u64) as usize;
            self.read(from, &mut piece[..length])?;
            each(&piece[..length]);
            from += length as u64;
        }
        Ok(())
    }
}
