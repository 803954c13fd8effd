//! Background writer: a bounded queue of output to one destination (stderr, stdout, a file), written by a thread of its
//! own. So the control thread never waits for a disk, a terminal or a pipe. A record that does not fit is dropped whole
//! and counted.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, ErrorKind, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::thread;
use std::time::Duration;

use nix::libc::{ENXIO, O_NONBLOCK};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

use crate::destination::{Destination, folder};
use crate::temporary;

/// Capacity of the queue \[bytes\]: twenty seconds of the trajectories of five robots (12 kB/s), or more than a
/// thousand log lines. A worn SD card stalls for a second or two.
const QUEUE_BYTES: usize = 1 << 18;
/// Capacity of the queue \[records\], which bounds empty records, too.
const QUEUE_RECORDS: usize = 16_384;

/// Destination of a background writer, a thread that writes queued output: a file, a terminal, a device or a pipe.
pub enum Target {
    /// An open file descriptor.
    Open(File),
    /// A named pipe, by its path, that may have no reader yet: the writer's thread opens it and waits for a reader. The
    /// open descriptor is there if the pipe already has a reader, and `None` otherwise. It is held until the thread has
    /// opened the pipe, so that the reader does not see an end of file before the first record.
    Pipe(PathBuf, Option<File>),
}

impl Target {
    /// Makes a destination from an open file descriptor, such as stdout. It writes to a duplicate of the descriptor.
    pub fn copy_of(open: impl AsFd) -> io::Result<Target> {
        open.as_fd().try_clone_to_owned().map(|fd| Target::Open(File::from(fd)))
    }

    /// Makes a destination from a path: an empty file, which replaces an existing one, or an existing pipe or device.
    /// Does not wait for a pipe's reader. Links are followed as [`Destination::of`] says.
    pub fn create(path: &Path) -> io::Result<Target> {
        let path = match Destination::of(path).map_err(io::Error::other)? {
            Destination::File(path, note) => {
                note.iter().for_each(|note| tracing::warn!("{note}"));
                return Ok(Target::Open(temporary::file_in(folder(&path), 0o666)?.persist(&path)?));
            }
            Destination::Stream(path) if !Destination::is_pipe(&path) => {
                return Destination::open_stream(&path, 0).map(Target::Open);
            }
            Destination::Stream(path) => path,
        };
        match Destination::open_stream(&path, O_NONBLOCK) {
            Ok(probe) => Ok(Target::Pipe(path, Some(probe))),
            Err(error) if error.raw_os_error() == Some(ENXIO) => Ok(Target::Pipe(path, None)),
            Err(error) => Err(error),
        }
    }

    /// Returns true if this destination and the open file `other` are the same file, such as `/dev/stdout` and stdout.
    /// A pipe that has no reader yet counts as different from every file.
    pub fn is_same(&self, other: impl AsFd) -> bool {
        let place = |file: &File| file.metadata().map(|about| (about.dev(), about.ino()));
        let (Target::Open(file) | Target::Pipe(_, Some(file))) = self else { return false };
        let other = other.as_fd().try_clone_to_owned().map(File::from);
        matches!((place(file), other.and_then(|other| place(&other))), (Ok(here), Ok(there)) if here == there)
    }

    fn open(self) -> io::Result<File> {
        match self {
            Target::Open(file) => Ok(file),
            Target::Pipe(path, _probe) => Destination::open_stream(&path, 0),
        }
    }
}

/// Handle of a background writer: a bounded queue of records (pieces of output, such as a line) to one destination, and
/// the thread that writes them there. So its users never wait for a disk or a terminal. Clones share the queue.
#[derive(Clone)]
pub struct BackgroundWriter(Arc<Shared>);

struct Shared {
    state: Mutex<State>,
    /// Notified when a record is put into the queue.
    not_empty: Condvar,
    /// Notified when all records are written, or when writing has failed.
    idle: Condvar,
    /// Formats the line that reports dropped records within the output; `None` if nothing may be inserted between
    /// records.
    notice: Option<fn(u64) -> String>,
}

#[derive(Default)]
struct State {
    queue: VecDeque<Vec<u8>>,
    bytes: usize,
    writing: bool,
    dropped: u64,
    /// Number of dropped records that were already reported in the output.
    reported: u64,
    failure: Option<io::Error>,
    failed: bool,
}

impl BackgroundWriter {
    /// Starts the thread that writes queued records to `target`; it ends with the process, or when writing fails. Fails
    /// if the thread cannot be started.
    ///
    /// `notice` formats the line that reports a number of dropped records; it is put before the next record that is
    /// written. With `None`, nothing is put between records.
    pub fn open(target: Target, notice: Option<fn(u64) -> String>) -> io::Result<BackgroundWriter> {
        let shared =
            Arc::new(Shared { state: Mutex::default(), not_empty: Condvar::new(), idle: Condvar::new(), notice });
        let writer = BackgroundWriter(Arc::clone(&shared));
        thread::Builder::new().name("writer".to_owned()).spawn(move || shared.serve(target))?;
        Ok(writer)
    }

    /// Appends a record to the queue, to be written whole, and returns true. Returns false, without waiting, if the
    /// record was dropped, because the queue is full or writing has failed.
    pub fn push(&self, record: Vec<u8>) -> bool {
        let mut state = self.0.lock();
        let full = state.bytes + record.len() > QUEUE_BYTES || state.queue.len() >= QUEUE_RECORDS;
        if full || state.failed {
            state.dropped += 1;
            return false;
        }
        state.bytes += record.len();
        state.queue.push_back(record);
        drop(state);
        self.0.not_empty.notify_one();
        true
    }

    /// Returns the number of records dropped so far.
    pub fn dropped(&self) -> u64 {
        self.0.lock().dropped
    }

    /// Returns the error that has ended the writing, once; `None` before an error, and after it was returned. A pipe
    /// that its reader closed is no error.
    pub fn failure(&self) -> Option<io::Error> {
        self.0.lock().failure.take()
    }

    /// Waits for at most `most` until everything is written. Records that are still queued then are dropped and
    /// counted.
    pub fn flush(&self, most: Duration) {
        let busy = |state: &mut State| (state.writing || !state.queue.is_empty()) && !state.failed;
        let guard = self.0.lock();
        let (mut state, _) =
            self.0.idle.wait_timeout_while(guard, most, busy).unwrap_or_else(|poisoned| poisoned.into_inner());
        state.dropped += state.queue.len() as u64 + u64::from(state.writing);
        state.queue.clear();
        state.bytes = 0;
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        // A panic in another thread leaves the state valid, and logging that panic needs this lock.
        self.state.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    /// Runs the writer thread: opens `target` and writes records to it until that fails. Then it drops and counts the
    /// queued records and keeps the error, except of a pipe that its reader closed.
    fn serve(&self, target: Target) {
        let written = target.open().and_then(|file| {
            loop {
                let record = self.next();
                write_whole(&file, &record)?;
            }
        });
        let Err(error): io::Result<()> = written else { return };
        let mut state = self.lock();
        state.dropped += state.queue.len() as u64 + u64::from(state.writing);
        (state.failed, state.writing, state.bytes) = (true, false, 0);
        state.queue.clear();
        state.failure = Some(error).filter(|error| error.kind() != ErrorKind::BrokenPipe);
        self.idle.notify_all();
    }

    fn next(&self) -> Vec<u8> {
        let mut state = self.lock();
        state.writing = false;
        if state.queue.is_empty() {
            self.idle.notify_all();
        }
        let mut state = self
            .not_empty
            .wait_while(state, |state| state.queue.is_empty())
            .unwrap_or_else(|poison| poison.into_inner());
        state.writing = true;
        let mut record = state.queue.pop_front().expect("it is not empty");
        state.bytes -= record.len();
        if let (Some(notice), true) = (self.notice, state.dropped > state.reported) {
            let missing = notice(state.dropped - state.reported);
            state.reported = state.dropped;
            record.splice(..0, missing.into_bytes());
        }
        record
    }
}

/// Writes all of `bytes` to `file`, and waits as long as needed, even if another program has made the descriptor
/// non-blocking.
fn write_whole(mut file: &File, mut bytes: &[u8]) -> io::Result<()> {
    while !bytes.is_empty() {
        match file.write(bytes) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(written) => bytes = &bytes[written..],
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                poll(&mut [PollFd::new(file.as_fd(), PollFlags::POLLOUT)], PollTimeout::NONE)?;
            }
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::io::{PipeReader, Read, pipe};
    use std::os::fd::OwnedFd;
    use std::sync::mpsc::channel;
    use std::time::Instant;

    use super::*;

    const LIMIT: Duration = Duration::from_millis(50);
    const PATIENCE: Duration = Duration::from_secs(30);

    fn piped(notice: Option<fn(u64) -> String>) -> (PipeReader, BackgroundWriter) {
        let (reader, writer) = pipe().expect("a pipe");
        (reader, BackgroundWriter::open(Target::Open(File::from(OwnedFd::from(writer))), notice).expect("a thread"))
    }

    #[test]
    fn records_are_written_in_order() {
        let (mut reader, writer) = piped(None);
        assert!(["one\n", "two\n"].into_iter().all(|line| writer.push(line.into())));
        writer.flush(PATIENCE);
        let mut read = [0; 8];
        reader.read_exact(&mut read).expect("it is there");
        assert_eq!((&read, writer.dropped()), (b"one\ntwo\n", 0));
    }

    #[test]
    fn a_pipe_without_reading_never_blocks_and_its_reader_gets_the_number_of_dropped_records() {
        let (mut reader, writer) = piped(Some(|missing| format!("{missing} missing\n")));
        let taken = (0..64).filter(|_| writer.push(vec![b'x'; 1 << 16])).count();
        // Of four megabytes, 256 KiB are queued, a pipe's capacity is in the pipe, and one record is being written.
        assert!((4..8).contains(&taken), "{taken} of 64 pieces");
        let reading = thread::spawn(move || {
            let (mut all, mut some) = (Vec::new(), [0; 1 << 16]);
            while !all.ends_with(b"last\n") {
                let read = reader.read(&mut some).expect("the writer is there");
                all.extend_from_slice(&some[..read]);
            }
            String::from_utf8(all).expect("it is text")
        });
        writer.flush(PATIENCE);
        assert!(writer.push(b"last\n".to_vec()), "there is room again");
        let all = reading.join().expect("it reads");
        assert_eq!(writer.dropped(), 64 - taken as u64);
        let reported = all.split(" missing\n").map(|part| part.trim_start_matches(['x', '\n']));
        let reported: u64 = reported.filter_map(|number| number.parse::<u64>().ok()).sum();
        assert_eq!(reported, writer.dropped(), "all of them, in one report or several");
        assert_eq!(all.matches('x').count(), taken << 16);
    }

    #[test]
    fn a_pipe_without_a_reader_is_opened_once_a_reader_opens_it() {
        let folder = tempfile::TempDir::new().expect("a temporary folder");
        let path = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&path).status().expect("it is there").success());
        let writer = BackgroundWriter::open(Target::create(&path).expect("it does not wait"), None).expect("a thread");
        assert!(writer.push(b"a line\n".to_vec()));
        let mut read = [0; 7];
        File::open(&path).expect("it is there").read_exact(&mut read).expect("it is written");
        assert_eq!(&read, b"a line\n");
    }

    #[test]
    fn two_descriptors_of_one_pipe_are_the_same_target() {
        let (_reader, writer) = pipe().expect("a pipe");
        let (_other_reader, other) = pipe().expect("a pipe");
        let target = Target::copy_of(&writer).expect("a copy");
        assert!(target.is_same(&writer) && !target.is_same(&other));
    }

    #[test]
    fn flushing_a_stuck_pipe_stops_at_its_time_limit_and_counts_the_dropped_records() {
        let (_reader, writer) = piped(None);
        for _ in 0..2 {
            assert!(writer.push(vec![b'x'; 1 << 17]));
        }
        let (tell, flushed) = channel();
        thread::spawn(move || {
            let before = Instant::now();
            writer.flush(LIMIT);
            tell.send((before.elapsed(), writer.dropped()))
        });
        let (took, dropped) = flushed.recv_timeout(PATIENCE).expect("it waits for a reader that never reads");
        assert!(took >= LIMIT, "{took:?}");
        assert_eq!(dropped, 2, "one in part, one whole");
    }

    #[test]
    fn a_full_disk_is_a_failure_and_a_closed_pipe_is_not() {
        let full = BackgroundWriter::open(Target::create(Path::new("/dev/full")).expect("it is there"), None)
            .expect("a thread");
        assert!(full.push(b"a line\n".to_vec()));
        full.flush(PATIENCE);
        assert_eq!(full.failure().map(|error| error.kind()), Some(ErrorKind::StorageFull));
        let (reader, gone) = piped(None);
        drop(reader);
        // A process that another test starts has the reader, too, until it runs its own program.
        let refused = (0..1000).any(|_| {
            let accepted = gone.push(b"a line\n".to_vec());
            gone.flush(PATIENCE);
            !accepted
        });
        assert!(refused, "records for a closed pipe are refused");
        assert_eq!((gone.failure().map(|error| error.kind()), gone.dropped()), (None, 2));
    }
}
