//! Worker that runs a user's program: the program reads packets from stdin and writes packets to stdout, one packet a
//! line.
//!
//! So a driver or a source of readings can be written in any language. The program writes its stderr to that of this
//! process.

use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Child, Command, Stdio};
use std::thread;

use super::{Packet, PacketSender, Port, Worker};

/// Longest line of the program's output \[bytes\]. A longer line is split, so its reader refuses the parts.
const LONGEST: u64 = 4096;

/// Worker that runs a user's program as a child process and exchanges packets with it, one a line, over stdin and
/// stdout.
#[derive(Clone, Debug)]
pub struct Program {
    /// The program file, followed by its arguments.
    pub command: Vec<String>,
}

impl Worker for Program {
    fn run(self: Box<Self>, mut port: Port) {
        let Some((program, arguments)) = self.command.split_first() else { return };
        let mut child = match Command::new(program).args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()
        {
            Ok(child) => child,
            Err(error) => {
                tracing::error!("'{program}' cannot be started: {error}");
                return;
            }
        };
        let (sender, stdout) = (port.sender(), child.stdout.take());
        let reader = thread::spawn(move || stdout.map(|stdout| read(stdout, &sender)));
        let mut stdin = child.stdin.take();
        while let Some(line) = port.wait() {
            let written = stdin.as_mut().map(|stdin| stdin.write_all(&line).and_then(|()| stdin.flush()));
            if let Some(Err(error)) = written {
                tracing::error!("'{program}' does not read its input: {error}");
                break;
            }
        }
        // The program has to end when its stdin is closed.
        drop(stdin);
        end(&mut child, program);
        let _ = reader.join();
    }
}

/// Reads lines from the program's stdout and sends each as a packet, until the program closes it.
fn read(stdout: impl Read, sender: &PacketSender) {
    let mut stdout = BufReader::new(stdout);
    loop {
        let mut line = Vec::new();
        match stdout.by_ref().take(LONGEST).read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => return,
            Ok(_) => sender.send(Packet::from(line)),
        }
    }
}

/// Waits up to 0.5 s for the program to end, then kills it.
fn end(child: &mut Child, program: &str) {
    let waited = (0..100).find_map(|_| {
        thread::park_timeout(std::time::Duration::from_millis(5));
        child.try_wait().transpose()
    });
    if waited.is_none() {
        tracing::warn!("'{program}' does not end, and is killed");
        let _ = child.kill();
        let _ = child.wait();
    }
}
