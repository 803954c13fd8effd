//! Reader of the lines that a program writes to its stdout, on a thread that waits for nothing else.
//!
//! A line comes every few milliseconds. By then the code of an asynchronous runtime has left the processor's caches, so
//! that a line would arrive some 30 us later, and every tenth 100 us later.

use std::io::{self, BufRead, BufReader, PipeReader, PipeWriter, Read};
use std::os::fd::{AsFd, OwnedFd};
use std::thread;

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use tokio::sync::oneshot;

use super::panic::EndsProcess;
use super::{Packet, PacketSender};

/// Lines of a running program's stdout, which are sent as packets until the program closes it, or this is dropped.
#[derive(Debug)]
pub(super) struct Lines {
    ended: oneshot::Receiver<()>,
    /// Closed when this is dropped, upon which the thread ends: what the program has started may keep its stdout open.
    _end: PipeWriter,
}

impl Lines {
    /// Starts to read `stdout`; each line is sent by `sender`. A line of more than `longest` \[bytes\] is split, so its
    /// reader refuses the parts. `name` is that of the worker, by which logs know it.
    pub(super) fn start(stdout: OwnedFd, sender: PacketSender, (name, longest): (&str, usize)) -> io::Result<Lines> {
        let ((end, _end), (alive, ended)) = (io::pipe()?, oneshot::channel());
        thread::Builder::new().name(name.to_owned()).spawn(move || {
            let _guard = EndsProcess("the reader of a program's output");
            // Dropped at the end.
            let _alive: oneshot::Sender<()> = alive;
            pass_on(Output { stdout, end }, &sender, longest as u64);
        })?;
        Ok(Lines { ended, _end })
    }

    /// Waits until the program, and all to which it has given its stdout, have closed it.
    pub(super) async fn ended(&mut self) {
        let _ = (&mut self.ended).await;
    }
}

/// Stdout of a program, which counts as closed once the other end of `end` is closed.
struct Output {
    stdout: OwnedFd,
    end: PipeReader,
}

impl Read for Output {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let mut both = [&self.end.as_fd(), &self.stdout.as_fd()].map(|end| PollFd::new(*end, PollFlags::POLLIN));
        match poll(&mut both, PollTimeout::NONE) {
            Err(Errno::EINTR) => return Err(io::ErrorKind::Interrupted.into()),
            polled => polled?,
        };
        if both[0].any() == Some(true) { Ok(0) } else { Ok(nix::unistd::read(&self.stdout, into)?) }
    }
}

fn pass_on(output: Output, sender: &PacketSender, longest: u64) {
    let mut output = BufReader::new(output);
    loop {
        let mut line = Vec::new();
        match (&mut output).take(longest).read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => return,
            Ok(_) => sender.send(Packet::from(line)),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::time::Duration;

    use super::super::channel::channel;
    use super::*;

    #[test]
    fn the_thread_ends_when_it_is_dropped_although_a_process_keeps_the_output_open() {
        let (mut gate, port) = channel("a program").expect("there are descriptors");
        let (stdout, mut program) = io::pipe().expect("a pipe");
        let lines = Lines::start(stdout.into(), port.sender(), ("a program", 4096)).expect("a thread");
        program.write_all(b"one\ntwo").expect("it is read");
        let mut heard = Vec::new();
        while heard.is_empty() {
            let bell = gate.bell();
            poll(&mut [PollFd::new(bell.as_fd(), PollFlags::POLLIN)], PollTimeout::NONE).expect("it is rung");
            gate.take(|packet| heard.push(packet));
        }
        assert_eq!(heard, [Packet::from(*b"one\n")]);
        drop(lines);
        // The other end of the pipe is closed by the thread alone.
        while program.write_all(b"three\n").is_ok() {
            thread::park_timeout(Duration::from_millis(5));
        }
    }
}
