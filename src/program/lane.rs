//! Lane: a bounded queue to one destination (stderr, stdout, a file), written by a thread of its own. So the thread
//! that drives a robot never waits for a disk, a terminal or a pipe. What does not fit is dropped whole and counted.

use std::collections::VecDeque;
use std::fs::{File, OpenOptions};
use std::io::{self, ErrorKind, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::thread;
use std::time::Duration;

use nix::libc::{ENXIO, O_NONBLOCK};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

/// Bytes that may wait: twenty seconds of the trajectories of five robots (12 kB/s), and a thousand log lines and more.
/// A worn SD card stalls for a second or two.
const WAITING_BYTES: usize = 1 << 18;
/// Pieces that may wait, so that many empty ones are bounded as well.
const WAITING_PIECES: usize = 16_384;

/// Where a lane leads.
pub enum Target {
    /// To what is open.
    Open(File),
    /// To a pipe that may have no reader yet: it is opened by the lane's thread, which waits for one. The probe keeps a
    /// reader that is there from seeing the end before the beginning.
    Pipe(PathBuf, Option<File>),
}

impl Target {
    /// A copy of an open descriptor, such as stdout.
    pub fn copy_of(open: impl AsFd) -> io::Result<Target> {
        open.as_fd().try_clone_to_owned().map(|fd| Target::Open(File::from(fd)))
    }

    /// A file that is made or emptied, or a pipe or a device that is there; does not wait for a pipe's reader.
    pub fn create(path: &Path) -> io::Result<Target> {
        let is_pipe = path.metadata().is_ok_and(|about| about.file_type().is_fifo());
        if !is_pipe {
            return File::create(path).map(Target::Open);
        }
        match OpenOptions::new().write(true).custom_flags(O_NONBLOCK).open(path) {
            Ok(probe) => Ok(Target::Pipe(path.to_owned(), Some(probe))),
            Err(error) if error.raw_os_error() == Some(ENXIO) => Ok(Target::Pipe(path.to_owned(), None)),
            Err(error) => Err(error),
        }
    }

    /// Whether what is written there ends up where `other` does, as `/dev/stdout` and stdout.
    pub fn is_same(&self, other: impl AsFd) -> bool {
        let place = |file: &File| file.metadata().map(|about| (about.dev(), about.ino()));
        let (Target::Open(file) | Target::Pipe(_, Some(file))) = self else { return false };
        let other = other.as_fd().try_clone_to_owned().map(File::from);
        matches!((place(file), other.and_then(|other| place(&other))), (Ok(here), Ok(there)) if here == there)
    }

    fn open(self) -> io::Result<File> {
        match self {
            Target::Open(file) => Ok(file),
            Target::Pipe(path, _probe) => OpenOptions::new().write(true).open(path),
        }
    }
}

/// The way to one destination. Clones lead to the same.
#[derive(Clone)]
pub struct Lane(Arc<Shared>);

struct Shared {
    state: Mutex<State>,
    /// Rings when there is something to write.
    more: Condvar,
    /// Rings when nothing waits any more.
    idle: Condvar,
    /// Makes the line that tells a reader how much is missing before it; none where nothing may stand between data.
    notice: Option<fn(u64) -> String>,
}

#[derive(Default)]
struct State {
    waiting: VecDeque<Vec<u8>>,
    bytes: usize,
    writing: bool,
    dropped: u64,
    /// Of those dropped, how many the reader was told of.
    noticed: u64,
    failure: Option<io::Error>,
    failed: bool,
}

impl Lane {
    /// Opens a lane; its thread ends with the process.
    pub fn open(target: Target, notice: Option<fn(u64) -> String>) -> io::Result<Lane> {
        let shared = Arc::new(Shared { state: Mutex::default(), more: Condvar::new(), idle: Condvar::new(), notice });
        let lane = Lane(Arc::clone(&shared));
        thread::Builder::new().name("writer".to_owned()).spawn(move || shared.serve(target))?;
        Ok(lane)
    }

    /// Has a piece written after those before it, whole or not at all. Never waits for the destination; says whether
    /// there was room.
    pub fn push(&self, piece: Vec<u8>) -> bool {
        let mut state = self.0.lock();
        let full = state.bytes + piece.len() > WAITING_BYTES || state.waiting.len() >= WAITING_PIECES;
        if full || state.failed {
            state.dropped += 1;
            return false;
        }
        state.bytes += piece.len();
        state.waiting.push_back(piece);
        drop(state);
        self.0.more.notify_one();
        true
    }

    /// Pieces that were dropped so far.
    pub fn dropped(&self) -> u64 {
        self.0.lock().dropped
    }

    /// The error that has ended it, given once. A reader that has closed a pipe has seen enough, which is none.
    pub fn failure(&self) -> Option<io::Error> {
        self.0.lock().failure.take()
    }

    /// Waits until all is written, or for so long. What still waits then counts as dropped.
    pub fn flush(&self, most: Duration) {
        let busy = |state: &mut State| (state.writing || !state.waiting.is_empty()) && !state.failed;
        let guard = self.0.lock();
        let (mut state, _) =
            self.0.idle.wait_timeout_while(guard, most, busy).unwrap_or_else(|poisoned| poisoned.into_inner());
        state.dropped += state.waiting.len() as u64 + u64::from(state.writing);
        state.waiting.clear();
        state.bytes = 0;
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        // A panic elsewhere leaves plain data behind, and the log of that panic comes this way.
        self.state.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    /// Writes until writing fails, which ends the lane.
    fn serve(&self, target: Target) {
        let written = target.open().and_then(|file| {
            loop {
                let piece = self.next();
                write_whole(&file, &piece)?;
            }
        });
        let Err(error): io::Result<()> = written else { return };
        let mut state = self.lock();
        state.dropped += state.waiting.len() as u64 + u64::from(state.writing);
        (state.failed, state.writing, state.bytes) = (true, false, 0);
        state.waiting.clear();
        state.failure = Some(error).filter(|error| error.kind() != ErrorKind::BrokenPipe);
        self.idle.notify_all();
    }

    fn next(&self) -> Vec<u8> {
        let mut state = self.lock();
        state.writing = false;
        if state.waiting.is_empty() {
            self.idle.notify_all();
        }
        let mut state =
            self.more.wait_while(state, |state| state.waiting.is_empty()).unwrap_or_else(|poison| poison.into_inner());
        state.writing = true;
        let mut piece = state.waiting.pop_front().expect("it is not empty");
        state.bytes -= piece.len();
        if let (Some(notice), true) = (self.notice, state.dropped > state.noticed) {
            let missing = notice(state.dropped - state.noticed);
            state.noticed = state.dropped;
            piece.splice(..0, missing.into_bytes());
        }
        piece
    }
}

/// Writes all of it, also to a descriptor that another program has set not to wait.
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
    use std::time::Instant;

    use super::*;

    const LIMIT: Duration = Duration::from_millis(50);
    const PATIENCE: Duration = Duration::from_secs(30);

    fn piped(notice: Option<fn(u64) -> String>) -> (PipeReader, Lane) {
        let (reader, writer) = pipe().expect("a pipe");
        (reader, Lane::open(Target::Open(File::from(OwnedFd::from(writer))), notice).expect("a thread"))
    }

    #[test]
    fn what_is_pushed_is_written_in_order() {
        let (mut reader, lane) = piped(None);
        assert!(["one\n", "two\n"].into_iter().all(|line| lane.push(line.into())));
        lane.flush(PATIENCE);
        let mut read = [0; 8];
        reader.read_exact(&mut read).expect("it is there");
        assert_eq!((&read, lane.dropped()), (b"one\ntwo\n", 0));
    }

    #[test]
    fn a_pipe_that_nobody_reads_holds_nobody_up_and_its_reader_is_told_what_is_missing() {
        let (mut reader, lane) = piped(Some(|missing| format!("{missing} missing\n")));
        let taken = (0..64).filter(|_| lane.push(vec![b'x'; 1 << 16])).count();
        // Of four megabytes 256 KiB wait, a pipe's worth is in the pipe, and one piece is being written.
        assert!((4..8).contains(&taken), "{taken} of 64 pieces");
        let reading = thread::spawn(move || {
            let (mut all, mut some) = (Vec::new(), [0; 1 << 16]);
            while !all.ends_with(b"last\n") {
                let read = reader.read(&mut some).expect("the writer is there");
                all.extend_from_slice(&some[..read]);
            }
            String::from_utf8(all).expect("it is text")
        });
        lane.flush(PATIENCE);
        assert!(lane.push(b"last\n".to_vec()), "there is room again");
        let all = reading.join().expect("it reads");
        assert_eq!(lane.dropped(), 64 - taken as u64);
        let told = all.split(" missing\n").map(|part| part.trim_start_matches(['x', '\n']));
        let told: u64 = told.filter_map(|number| number.parse::<u64>().ok()).sum();
        assert_eq!(told, lane.dropped(), "once or in parts, all of them");
        assert_eq!(all.matches('x').count(), taken << 16);
    }

    #[test]
    fn a_pipe_without_a_reader_is_opened_when_there_is_one() {
        let folder = tempfile::TempDir::new().expect("a temporary folder");
        let path = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&path).status().expect("it is there").success());
        let lane = Lane::open(Target::create(&path).expect("it does not wait"), None).expect("a thread");
        assert!(lane.push(b"a line\n".to_vec()));
        let mut read = [0; 7];
        File::open(&path).expect("it is there").read_exact(&mut read).expect("it is written");
        assert_eq!(&read, b"a line\n");
    }

    #[test]
    fn two_ways_to_one_pipe_are_known_as_such() {
        let (_reader, writer) = pipe().expect("a pipe");
        let (_other_reader, other) = pipe().expect("a pipe");
        let target = Target::copy_of(&writer).expect("a copy");
        assert!(target.is_same(&writer) && !target.is_same(&other));
    }

    #[test]
    fn the_end_waits_for_a_stuck_pipe_no_longer_than_it_is_told_and_counts_what_it_leaves() {
        let (_reader, lane) = piped(None);
        for _ in 0..2 {
            assert!(lane.push(vec![b'x'; 1 << 17]));
        }
        let before = Instant::now();
        lane.flush(LIMIT);
        assert!(before.elapsed() >= LIMIT && before.elapsed() < PATIENCE);
        assert_eq!(lane.dropped(), 2, "one in part, one whole");
    }

    #[test]
    fn a_full_disk_is_a_failure_and_a_reader_that_has_gone_is_none() {
        let full = Lane::open(Target::create(Path::new("/dev/full")).expect("it is there"), None).expect("a thread");
        assert!(full.push(b"a line\n".to_vec()));
        full.flush(PATIENCE);
        assert_eq!(full.failure().map(|error| error.kind()), Some(ErrorKind::StorageFull));
        let (reader, gone) = piped(None);
        drop(reader);
        assert!(gone.push(b"a line\n".to_vec()));
        gone.flush(PATIENCE);
        assert!(!gone.push(b"a line\n".to_vec()));
        assert_eq!((gone.failure().map(|error| error.kind()), gone.dropped()), (None, 2));
    }
}
