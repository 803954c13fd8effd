//! Waiting for file descriptors and a time, on Linux: by `epoll`, and by a timer of the kernel, since timeouts have a
//! resolution of a millisecond.

use std::os::fd::AsFd;
use std::rc::Rc;

use nix::errno::Errno;
use nix::sys::epoll::{Epoll, EpollCreateFlags, EpollEvent, EpollFlags, EpollTimeout};
use nix::sys::time::TimeSpec;
use nix::sys::timerfd::{ClockId, Expiration, TimerFd, TimerFlags, TimerSetTimeFlags};

use crate::time::{Span, Time};

/// Largest number of readable file descriptors that one `epoll` wait reports; the next wait reports the others.
const MAX_EVENTS: usize = 16;
/// Key of the timer in the `epoll` of a [`Watch`]; other descriptors have their index.
const TIMER: u64 = u64::MAX;

/// File descriptors that are watched, each with an index.
pub(super) struct Watch {
    /// Watches all file descriptors, and the timer.
    all: Epoll,
    /// Watches the file descriptors that are never paused, and the timer.
    never_paused: Epoll,
    timer: TimerFd,
    /// Time for which the timer is set; `None` before it is first set.
    timer_at: Option<Time>,
}

impl Watch {
    /// Creates an empty set. Panics if the kernel has no descriptor left.
    pub(super) fn new() -> Watch {
        let epoll = || Epoll::new(EpollCreateFlags::EPOLL_CLOEXEC).expect("a process may watch descriptors");
        let flags = TimerFlags::TFD_NONBLOCK | TimerFlags::TFD_CLOEXEC;
        let timer = TimerFd::new(ClockId::CLOCK_MONOTONIC, flags).expect("a process may have a timer");
        let (all, never_paused) = (epoll(), epoll());
        for epoll in [&all, &never_paused] {
            // Edge-triggered, so that it need not be read before it is set again.
            let event = EpollEvent::new(EpollFlags::EPOLLIN | EpollFlags::EPOLLET, TIMER);
            epoll.add(timer.as_fd(), event).expect("a timer can be watched");
        }
        Watch { all, never_paused, timer, timer_at: None }
    }

    /// Starts to watch `source`, which has this index: until it is readable or, with `end`, until its other end is
    /// closed. Returns whether it can be watched: the end of a regular file cannot.
    pub(super) fn add(&mut self, index: usize, source: &Rc<dyn AsFd>, end: bool, pausable: bool) -> bool {
        let flags = if end { EpollFlags::empty() } else { EpollFlags::EPOLLIN };
        let event = EpollEvent::new(flags, index as u64);
        let also = (!pausable).then_some(&self.never_paused);
        for epoll in also.into_iter().chain([&self.all]) {
            match epoll.add(source.as_fd(), event) {
                Ok(()) => {}
                Err(Errno::EPERM) if end => return false,
                Err(error) => panic!("a descriptor that is open cannot be watched: {error}"),
            }
        }
        true
    }

    /// Ends the watch of the descriptor with this index.
    pub(super) fn remove(&mut self, _: usize, source: &Rc<dyn AsFd>) {
        for epoll in [&self.all, &self.never_paused] {
            // An error means that it is not watched any more, which is the aim.
            let _ = epoll.delete(source.as_fd());
        }
    }

    /// Sleeps until a descriptor is ready or the time `until` has come, and appends the indices of those that are to
    /// `ready`. Does not sleep if `until` is not after `now`. While `paused`, pausable descriptors are not watched.
    /// `elapsed` returns the time of the real clock.
    pub(super) fn wait(
        &mut self,
        (now, until): (Time, Time),
        paused: bool,
        elapsed: impl Fn() -> Time,
        ready: &mut Vec<usize>,
    ) {
        let timeout = if until <= now {
            EpollTimeout::ZERO
        } else {
            self.set_timer(now, until, elapsed);
            EpollTimeout::NONE
        };
        let epoll = if paused { &self.never_paused } else { &self.all };
        let mut events = [EpollEvent::empty(); MAX_EVENTS];
        let count = match epoll.wait(&mut events, timeout) {
            Ok(count) => count,
            Err(Errno::EINTR) => 0,
            Err(error) => panic!("the kernel does not watch descriptors that are open: {error}"),
        };
        ready.extend(events[..count].iter().filter(|event| event.data() != TIMER).map(|event| event.data() as usize));
    }

    /// Sets the timer so that it ends the sleep at `until` at the latest. A timer that is set for an earlier time
    /// stays. A timeout of `epoll` instead would be set and cleared for every datagram, which costs more than the
    /// datagram.
    fn set_timer(&mut self, now: Time, until: Time, elapsed: impl Fn() -> Time) {
        // A timer that has expired does not fire until it is set again.
        if self.timer_at.is_some_and(|at| at > now && at <= until) {
            return;
        }
        let span = Span::from_nanos(until.since(elapsed()).as_nanos().max(1));
        let once = Expiration::OneShot(TimeSpec::from_duration(std::time::Duration::from_nanos(span.as_nanos())));
        self.timer.set(once, TimerSetTimeFlags::empty()).expect("an open timer can be set");
        self.timer_at = Some(until);
    }
}
