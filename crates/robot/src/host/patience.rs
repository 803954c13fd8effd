//! Waits until a host's links can be opened: at boot, a network interface or its address may come a moment later. Says
//! so once, and ends by Ctrl-C, SIGTERM or after a limit.

use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use sd_notify::NotifyState;

use crate::outlets::Outlets;
use crate::output::talk;
use murmurate::live::links::LinkError;

/// Longest wait for links. The unit in `packaging/` allows a start of a minute; after this wait the process ends, and
/// the service manager starts it again.
const LONGEST: Duration = Duration::from_secs(20);
/// The same for a process of `launch`, which starts it again three times, in front of a person.
const LONGEST_LAUNCHED: Duration = Duration::from_secs(2);
/// Time between two attempts to open a link.
const RETRY_MS: u16 = 100;

/// Wait of a host for its links.
pub struct Patience<'a> {
    signal: &'a AtomicUsize,
    /// Becomes readable when a signal arrives.
    wake: &'a UnixStream,
    outlets: &'a Outlets,
    /// Whether the reader of stdout supervises this process, which ends when it has gone.
    supervised: bool,
    begun: Instant,
    longest: Duration,
    /// Last reason to wait; `None` if there was none.
    why: Option<String>,
}

impl<'a> Patience<'a> {
    /// Returns the wait of a process that gets the number of a signal in `signal`, and then a byte in `wake`.
    /// `supervised` says whether another process reads its events, and `launched` whether that is `launch`.
    pub fn new(
        (signal, wake): (&'a AtomicUsize, &'a UnixStream),
        outlets: &'a Outlets,
        (supervised, launched): (bool, bool),
    ) -> Patience<'a> {
        let longest = if launched { LONGEST_LAUNCHED } else { LONGEST };
        Patience { signal, wake, outlets, supervised, begun: Instant::now(), longest, why: None }
    }

    /// Waits a moment because a link cannot be opened, which `error` explains. Returns whether to try again: not after
    /// a signal, after the limit, or when the supervisor has gone.
    pub fn wait(&mut self, error: &LinkError) -> bool {
        let why = error.to_string();
        if self.why.is_none() {
            let limit_s = self.longest.as_secs();
            talk(&format!("waiting up to {limit_s} s until it is fit; Ctrl-C ends that: {why}"));
        }
        if self.why.as_ref() != Some(&why) {
            self.outlets.notify(&NotifyState::Status(&format!("waiting: {why}")));
            self.why = Some(why);
        }
        let mut polled = vec![PollFd::new(self.wake.as_fd(), PollFlags::POLLIN)];
        let stdout = std::io::stdout();
        if self.supervised {
            // Only its end is reported.
            polled.push(PollFd::new(stdout.as_fd(), PollFlags::empty()));
        }
        let ended = poll(&mut polled, PollTimeout::from(RETRY_MS)).is_ok_and(|count| count > 0);
        !ended && self.signal.load(Ordering::Relaxed) == 0 && self.begun.elapsed() < self.longest
    }

    /// Says that the wait is over, if there was one.
    pub fn end(&self) {
        if self.why.is_some() {
            self.outlets.notify(&NotifyState::Status("running"));
            talk(&format!("the links are open after {:.1} s", self.begun.elapsed().as_secs_f64()));
        }
    }
}
