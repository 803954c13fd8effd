//! The driver of real time: does what is due, lets the actors run until every mailbox is empty, then sleeps until the
//! next event or until a file descriptor has something to read. One thread, no runtime's timers: they are a
//! millisecond coarse, and the poll here is not. What the actors do never lives here.

use std::cell::Cell;
use std::os::fd::AsFd;
use std::rc::Rc;
use std::time::Instant;

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::time::TimeSpec;
use nix::sys::timerfd::{ClockId, Expiration, TimerFd, TimerFlags, TimerSetTimeFlags};

use super::clock::Clock;
use super::drive::Tasks;
use super::shell::in_system;
use crate::time::{Span, Time};

/// The longest sleep. Whoever has to be heard sooner has something to read.
const MAX_SLEEP: Span = Span::from_millis(1000);

/// File descriptors, and who is rung when one of them has something to read.
#[derive(Default)]
pub struct Readers(Vec<Reader>);

struct Reader {
    source: Rc<dyn AsFd>,
    awaited: PollFlags,
    /// Whether it has nothing more to tell.
    over: Cell<bool>,
    ring: Box<dyn Fn()>,
}

impl Readers {
    /// Rings whenever `source` has something to read, until it has been read.
    pub fn watch(&mut self, source: Rc<dyn AsFd>, ring: impl Fn() + 'static) {
        self.0.push(Reader { source, awaited: PollFlags::POLLIN, over: Cell::new(false), ring: Box::new(ring) });
    }

    /// Rings once when the other end of `source`, which is written to, has gone. A regular file has no other end.
    pub fn watch_end(&mut self, source: Rc<dyn AsFd>, ring: impl Fn() + 'static) {
        self.0.push(Reader { source, awaited: PollFlags::empty(), over: Cell::new(false), ring: Box::new(ring) });
    }

    /// Sleeps until one has something to read or the alarm goes off, or looks only, and rings for those that have.
    fn sleep(&self, alarm: &Alarm, timeout: PollTimeout) {
        let readers: Vec<&Reader> = self.0.iter().filter(|reader| !reader.over.get()).collect();
        let mut polled: Vec<PollFd> =
            readers.iter().map(|reader| PollFd::new(reader.source.as_fd(), reader.awaited)).collect();
        polled.push(PollFd::new(alarm.timer.as_fd(), PollFlags::POLLIN));
        match poll(&mut polled, timeout) {
            Ok(_) | Err(Errno::EINTR) => {}
            Err(error) => panic!("the kernel does not poll sockets that are open: {error}"),
        }
        for (polled, reader) in polled.iter().zip(readers) {
            // An error is read from the socket, too: it must not be polled for ever.
            if polled.revents().is_some_and(|events| !events.is_empty()) {
                reader.over.set(reader.awaited.is_empty());
                (reader.ring)();
            }
        }
    }
}

/// Wakes the poll. A timeout of its own would set the machine's timer for every datagram that arrives, and take it
/// back, which costs more than the datagram; an alarm stands until something earlier is due.
struct Alarm {
    timer: TimerFd,
    /// When it goes off.
    at: Option<Time>,
}

impl Alarm {
    fn new() -> Alarm {
        let flags = TimerFlags::TFD_NONBLOCK | TimerFlags::TFD_CLOEXEC;
        let timer = TimerFd::new(ClockId::CLOCK_MONOTONIC, flags).expect("a process may have a timer");
        Alarm { timer, at: None }
    }

    /// Goes off at `next` at the latest.
    fn set(&mut self, now: Time, next: Time) {
        // One that has gone off rings until it is set again.
        if self.at.is_some_and(|at| at > now && at <= next) {
            return;
        }
        let next = next.min(now + MAX_SLEEP);
        let span = Span::from_nanos(next.since(now).as_nanos().max(1));
        let once = Expiration::OneShot(TimeSpec::from_duration(std::time::Duration::from_nanos(span.as_nanos())));
        self.timer.set(once, TimerSetTimeFlags::empty()).expect("an open timer can be set");
        self.at = Some(next);
    }
}

/// Runs actors in real time on this thread: `build` starts them and says which descriptors are read, and time goes by
/// from `origin` until `done`, which is asked after every turn.
pub fn run_real<W>(
    origin: Instant,
    build: impl FnOnce(&Clock, &mut Readers) -> W,
    mut done: impl FnMut(&W, Time) -> bool,
) -> W {
    let elapsed = || Time::from_nanos(u64::try_from(origin.elapsed().as_nanos()).expect("a run is below 500 years"));
    in_system(|| {
        let (clock, mut readers, mut actors) = (Clock::default(), Readers::default(), Tasks::new());
        let mut alarm = Alarm::new();
        clock.set(elapsed());
        let world = {
            let _inside = actors.enter();
            build(&clock, &mut readers)
        };
        loop {
            clock.set(elapsed());
            while clock.catch_up() {}
            actors.drain(&clock);
            let now = elapsed();
            if done(&world, now) {
                break;
            }
            match clock.next().unwrap_or(Time::MAX) {
                next if next <= now => readers.sleep(&alarm, PollTimeout::ZERO),
                next => {
                    alarm.set(now, next);
                    readers.sleep(&alarm, PollTimeout::NONE);
                }
            }
            clock.set(elapsed());
        }
        clock.clear();
        world
    })
}
