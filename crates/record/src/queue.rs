//! The bounded event queue between the thread that runs the actors and the writer thread of a record.
//!
//! In real time the control thread never waits and never wakes the writer, which polls every 180 ms. Events that do not
//! fit are dropped and counted. A simulation waits for the writer instead and drops nothing.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, TryLockError};
use std::time::Duration;

use super::Event;
use murmurate::graph::inputs::Input;
use murmurate::messages::ids::LinkId;
use murmurate::net::protocol::codec::Frame;
use murmurate::net::protocol::counts::Refusal;
use murmurate::time::{Span, Time};

/// Capacity of a record's queue \[events\]: about ten seconds of events of a host in a team of five, some 2 MB.
const CAPACITY: usize = 16_384;
/// Number of events that a simulation collects before it passes them to the writer.
const BATCH: usize = 2048;
/// Largest size of a host's inputs that is recorded per second in real time \[bytes\], beside those that its team
/// declares, so that a flood of datagrams does not fill the disk.
const INPUT_BYTES: usize = 1_000_000;
/// Shortest time between two events `Event::Dropped` (counts of dropped events) in a record.
const COUNT_PERIOD: Span = Span::from_millis(1000);
/// Longest time that the writer thread waits for events before it checks the queue again.
pub const POLL: Duration = Duration::from_millis(180);

/// Treatment of events when the queue of a record is full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WhenFull {
    /// Events are dropped and counted. It is used in real time.
    Drop,
    /// The sending thread waits for the thread that writes the record. It is used in simulations.
    Wait,
}

/// Sending end of a record's event queue, for the thread that runs the actors.
pub struct Inlet {
    when_full: WhenFull,
    shared: Arc<Shared>,
    events: RefCell<Vec<Event>>,
    /// Events of the current turn of the event loop.
    current: RefCell<Current>,
    /// Numbers of refused datagrams of turns in which nothing else has happened, and the time of the last of these
    /// turns.
    carried: RefCell<Refused>,
    carried_at: Cell<Time>,
    /// Number of things that the actors had done at the end of the last turn.
    steps: Cell<u64>,
    /// Number of dropped events that no `Event::Dropped` in the queue reports yet.
    missing: Cell<u64>,
    /// Time of the last `Event::Dropped` that was put into the queue; `None` before the first.
    counted: Cell<Option<Time>>,
    dropped: Cell<u64>,
    /// Size of the inputs recorded in the current second of the run \[bytes\].
    input_bytes: Cell<usize>,
    /// Largest size of the inputs that are recorded per second \[bytes\].
    most_input_bytes: Cell<usize>,
    second_began: Cell<Time>,
    /// Time at which the last turn of the event loop ended.
    turned: Cell<Time>,
    /// Whether the writer thread is known to have ended.
    abandoned: Cell<bool>,
}

/// Numbers of refused datagrams, by link and cause.
type Refused = BTreeMap<(LinkId, Refusal), u64>;

/// Events of the current turn of the event loop.
#[derive(Default)]
struct Current {
    /// Events in their order; `None` in the place of a datagram that was refused.
    events: Vec<Option<Event>>,
    /// Place in `events` behind the last datagram that was refused: the next one is likely to come after it.
    cursor: usize,
    refused: Refused,
    /// Number of datagrams in `refused`.
    count: u64,
}

impl Current {
    /// Replaces a datagram that has come in this turn by a count. One of an earlier turn, which a fault has delayed,
    /// stays in the record.
    fn refuse(&mut self, link: LinkId, cause: Refusal, frame: &Frame) {
        let is = |event: &Option<Event>| {
            matches!(event, Some(Event::Input(Input::Frame(at, other, _)))
                if *at == link && std::sync::Arc::ptr_eq(other, frame))
        };
        let later = self.events[self.cursor..].iter().position(is).map(|at| at + self.cursor);
        if let Some(at) = later.or_else(|| self.events[..self.cursor].iter().position(is)) {
            self.events[at] = None;
            self.cursor = at + 1;
            *self.refused.entry((link, cause)).or_default() += 1;
            self.count += 1;
        }
    }
}

/// Receiving end of a record's event queue, for the thread that writes the record.
pub struct Outlet(Arc<Shared>);

struct Shared {
    state: Mutex<State>,
    /// Notified after the writer has taken events; a simulation waits on it.
    room: Condvar,
    /// Notified when a simulation has added events, or when the sending end was closed.
    filled: Condvar,
}

struct State {
    events: Vec<Event>,
    /// Whether the sending end was closed.
    closed: bool,
    /// Whether the receiving end was dropped, because the writer thread has ended.
    abandoned: bool,
}

fn counts_of(refused: Refused) -> impl Iterator<Item = Event> {
    refused.into_iter().map(|((link, cause), count)| Event::Input(Input::Refused(link, cause, count)))
}

/// Returns the sending and the receiving end of a new event queue for a record.
pub fn queue(when_full: WhenFull) -> (Inlet, Outlet) {
    let room = if when_full == WhenFull::Drop { CAPACITY } else { BATCH * 2 };
    let state = State { events: Vec::with_capacity(room), closed: false, abandoned: false };
    let shared = Arc::new(Shared { state: Mutex::new(state), room: Condvar::new(), filled: Condvar::new() });
    let events = RefCell::new(Vec::with_capacity(room));
    let inlet = Inlet {
        when_full,
        shared: Arc::clone(&shared),
        events,
        current: RefCell::default(),
        carried: RefCell::default(),
        carried_at: Cell::new(Time::ZERO),
        steps: Cell::new(0),
        missing: Cell::new(0),
        counted: Cell::new(None),
        input_bytes: Cell::new(0),
        most_input_bytes: Cell::new(INPUT_BYTES),
        second_began: Cell::new(Time::ZERO),
        turned: Cell::new(Time::ZERO),
        dropped: Cell::new(0),
        abandoned: Cell::new(false),
    };
    (inlet, Outlet(shared))
}

impl Inlet {
    /// Adds an event of the current turn of the event loop. In real time it is dropped if the queue is full.
    pub fn push(&self, event: Event) {
        let mut current = self.current.borrow_mut();
        if let Event::Refused(link, cause, frame) = &event {
            return current.refuse(*link, *cause, frame);
        }
        if self.when_full == WhenFull::Drop && self.events.borrow().len() + current.events.len() >= CAPACITY {
            return self.miss();
        }
        current.events.push(Some(event));
    }

    /// Permits so many bytes of inputs a second beside the usual ones, for a team that declares large messages.
    pub fn expect(&self, bytes_per_s: usize) {
        self.most_input_bytes.set(INPUT_BYTES.saturating_add(bytes_per_s));
    }

    fn miss(&self) {
        self.missing.set(self.missing.get() + 1);
        self.dropped.set(self.dropped.get() + 1);
    }

    /// Adds the size of an input to that of the current second. Returns whether the inputs of this second are too large
    /// to be recorded.
    fn is_beyond(&self, event: &Event) -> bool {
        let bytes = match event {
            Event::Input(Input::Frame(_, frame, _)) => frame.len(),
            Event::Input(Input::Packet(_, packet)) => packet.len(),
            _ => return false,
        };
        self.input_bytes.set(self.input_bytes.get() + bytes);
        self.input_bytes.get() > self.most_input_bytes.get()
    }

    /// Ends the current turn of the event loop at the time `now`, and passes the events to the writer thread. A
    /// simulation collects those of many turns before it passes them.
    pub fn turn(&self, now: Time) {
        self.end(now, false);
    }

    /// Ends the current turn as [`Inlet::turn`]. `steps` is the number of things that the actors have done so far. A
    /// turn in which they have only refused datagrams is not recorded: its numbers go into the record before the next
    /// turn.
    pub fn turn_of(&self, now: Time, steps: u64) {
        let done = steps - self.steps.replace(steps);
        let refused = self.current.borrow().count;
        self.end(now, refused > 0 && done == refused);
    }

    fn end(&self, now: Time, nothing_else: bool) {
        self.turned.set(now);
        if now.since(self.second_began.get()) >= Span::from_millis(1000) {
            self.second_began.set(now);
            self.input_bytes.set(0);
        }
        let Current { events, refused, .. } = std::mem::take(&mut *self.current.borrow_mut());
        let mut turn: Vec<Event> = events.into_iter().flatten().collect();
        if nothing_else && turn.is_empty() && self.when_full == WhenFull::Drop {
            let mut carried = self.carried.borrow_mut();
            refused.into_iter().for_each(|(cause, count)| *carried.entry(cause).or_default() += count);
            return self.carried_at.set(now);
        }
        let carried = std::mem::take(&mut *self.carried.borrow_mut());
        if !carried.is_empty() {
            counts_of(carried).for_each(|event| self.add(event));
            self.add(Event::Turn(self.carried_at.get()));
        }
        if self.when_full == WhenFull::Drop {
            turn.retain(|event| {
                let beyond = self.is_beyond(event);
                if beyond {
                    self.miss();
                }
                !beyond
            });
        }
        // Before the turn that lacks an event, so that a replay ends there.
        let due = self.counted.get().is_none_or(|at| now.since(at) >= COUNT_PERIOD);
        if self.missing.get() > 0 && due && self.events.borrow().len() + 1 < CAPACITY {
            self.counted.set(Some(now));
            self.events.borrow_mut().push(Event::Dropped(self.missing.replace(0)));
        }
        // A replay gives orders of the host's own process after all other inputs.
        let is_order = |event: &Event| matches!(event, Event::Input(input) if input.is_order());
        let at = turn.iter().position(is_order).unwrap_or(turn.len());
        turn.splice(at..at, counts_of(refused));
        // A simulation's record has no use for a turn without events.
        let idle = |events: &[Event]| matches!(events.last(), None | Some(Event::Turn(_)));
        if self.when_full == WhenFull::Wait && turn.is_empty() && idle(&self.events.borrow()) {
            return;
        }
        turn.into_iter().for_each(|event| self.add(event));
        self.add(Event::Turn(now));
        match self.when_full {
            WhenFull::Drop => self.offer(),
            WhenFull::Wait if self.events.borrow().len() >= BATCH => self.wait(),
            WhenFull::Wait => {}
        }
    }

    /// Adds an event to those for the writer. In real time it is dropped if the queue is full.
    fn add(&self, event: Event) {
        let mut events = self.events.borrow_mut();
        if self.when_full == WhenFull::Drop && events.len() >= CAPACITY {
            return self.miss();
        }
        events.push(event);
    }

    /// Passes the remaining events to the writer thread and closes the queue. Events that are added later are lost.
    pub fn close(&self) {
        let carried = std::mem::take(&mut *self.carried.borrow_mut());
        if !carried.is_empty() && self.events.borrow().len() + carried.len() + 4 <= CAPACITY {
            counts_of(carried).for_each(|event| self.add(event));
            self.add(Event::Turn(self.carried_at.get()));
        }
        if self.missing.get() > 0 && self.events.borrow().len() + 2 <= CAPACITY {
            let last = [Event::Dropped(self.missing.replace(0)), Event::Turn(self.turned.get())];
            self.events.borrow_mut().extend(last);
        }
        if self.when_full == WhenFull::Wait {
            self.wait();
        } else {
            self.offer();
        }
        self.shared.lock().closed = true;
        self.shared.filled.notify_one();
    }

    /// Returns the number of events that were dropped so far.
    pub fn dropped(&self) -> u64 {
        self.dropped.get()
    }

    /// Returns whether the writer thread is known to have ended, because the record's file could not be written.
    pub fn is_abandoned(&self) -> bool {
        self.abandoned.get()
    }

    /// Passes all collected events to the writer thread if they fit and the lock is free; otherwise keeps them for the
    /// next call.
    fn offer(&self) {
        let mut state = match self.shared.state.try_lock() {
            Ok(state) => state,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return,
        };
        let mut events = self.events.borrow_mut();
        if state.abandoned {
            self.abandoned.set(true);
            self.dropped.set(self.dropped.get() + events.len() as u64);
            events.clear();
        } else if state.events.len() + events.len() <= CAPACITY {
            state.events.append(&mut events);
        }
    }

    /// Waits until the writer thread has taken the previous events, then passes all collected events to it.
    fn wait(&self) {
        let busy = |state: &mut State| !state.events.is_empty() && !state.abandoned;
        let mut state = self.shared.room.wait_while(self.shared.lock(), busy).unwrap_or_else(|e| e.into_inner());
        let mut events = self.events.borrow_mut();
        if state.abandoned {
            self.abandoned.set(true);
            self.dropped.set(self.dropped.get() + events.len() as u64);
            events.clear();
        } else {
            state.events.append(&mut events);
        }
        drop(state);
        self.shared.filled.notify_one();
    }
}

impl Drop for Inlet {
    fn drop(&mut self) {
        self.close();
    }
}

impl Outlet {
    /// Moves the queued events into `events`, which must be empty; waits for events for at most [`POLL`]. Returns
    /// `false` if the sending end was closed and no events are left.
    pub fn take(&self, events: &mut Vec<Event>) -> bool {
        let mut state = self.0.lock();
        if state.events.is_empty() && !state.closed {
            let idle = |state: &mut State| state.events.is_empty() && !state.closed;
            let waited = self.0.filled.wait_timeout_while(state, POLL, idle);
            state = waited.unwrap_or_else(|poisoned| poisoned.into_inner()).0;
        }
        std::mem::swap(&mut state.events, events);
        let open = !state.closed || !events.is_empty();
        drop(state);
        self.0.room.notify_one();
        open
    }
}

impl Drop for Outlet {
    fn drop(&mut self) {
        self.0.lock().abandoned = true;
        self.0.room.notify_one();
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::messages::ids::LinkId;

    fn stamps(events: &[Event]) -> Vec<u64> {
        let stamp = |event: &Event| match event {
            Event::Turn(at) => at.as_nanos(),
            Event::Dropped(count) => 1_000_000 + count,
            other => panic!("{other:?}"),
        };
        events.iter().map(stamp).collect()
    }

    #[test]
    fn a_full_queue_drops_and_counts_and_says_where() {
        let (inlet, outlet) = queue(WhenFull::Drop);
        let mut events = Vec::new();
        let over = 2 * CAPACITY as u64 + 7;
        (0..over).for_each(|at| inlet.turn(Time::from_nanos(at)));
        assert_eq!(inlet.dropped(), 7);
        assert!(outlet.take(&mut events));
        assert_eq!(stamps(&events), (0..CAPACITY as u64).collect::<Vec<_>>());
        events.clear();
        inlet.turn(Time::from_nanos(900_000));
        assert_eq!(inlet.dropped(), 8, "its own queue was full until this turn's end");
        inlet.turn(Time::from_nanos(900_001));
        assert!(outlet.take(&mut events));
        events.clear();
        drop(inlet);
        assert!(outlet.take(&mut events));
        assert_eq!(stamps(&events), [1_000_008, 900_001]);
        events.clear();
        assert!(!outlet.take(&mut events));
    }

    #[test]
    fn a_flood_of_inputs_is_cut_to_a_megabyte_a_second_and_counted_once_a_second() {
        let (inlet, outlet) = queue(WhenFull::Drop);
        let (mut bytes, mut counted, mut marks, mut events) = (0, 0, 0, Vec::new());
        for turn in 0..2500u64 {
            for _ in 0..10 {
                inlet.push(Event::Input(Input::Frame(LinkId(0), vec![7; 1000].into(), None)));
            }
            inlet.turn(Time::from_nanos(turn * 1_000_000));
            assert!(outlet.take(&mut events));
            let before = bytes;
            for event in events.drain(..) {
                match event {
                    Event::Input(Input::Frame(_, frame, _)) => bytes += frame.len(),
                    Event::Dropped(count) => (counted, marks) = (counted + count, marks + 1),
                    _ => {}
                }
            }
            assert!(bytes == before + 10_000 || marks > 0, "a turn that lacks an input comes after its mark");
        }
        assert_eq!((bytes, marks), (3_000_000, 3), "of 25 MB in 2.5 s");
        assert_eq!(inlet.dropped(), 22_000);
        inlet.close();
        outlet.take(&mut events);
        let rest = events.iter().map(|event| if let Event::Dropped(count) = event { *count } else { 0 });
        assert_eq!(counted + rest.sum::<u64>(), 22_000, "the end counts the rest");
    }

    #[test]
    fn refused_datagrams_are_counted_and_turns_of_nothing_else_are_one() {
        let (inlet, outlet) = queue(WhenFull::Drop);
        let at = |ms: u64| Time::from_nanos(ms * 1_000_000);
        let arrive = |bytes: usize| {
            let frame: Frame = vec![7; bytes].into();
            inlet.push(Event::Input(Input::Frame(LinkId(1), Frame::clone(&frame), None)));
            frame
        };
        let mut steps = 0;
        // Three turns of nothing but junk: 2.2 MB in a second, more than is kept of inputs.
        for turn in 0..3u64 {
            let junk: Vec<Frame> = (0..700).map(|_| arrive(1100)).collect();
            junk.iter().for_each(|frame| inlet.push(Event::Refused(LinkId(1), Refusal::Auth, Frame::clone(frame))));
            steps += 700;
            inlet.turn_of(at(turn), steps);
        }
        // One with a datagram that is taken, another copy of it that is not, and an order.
        let (_taken, copy) = (arrive(40), arrive(40));
        inlet.push(Event::Refused(LinkId(1), Refusal::Duplicate, copy));
        inlet.push(Event::Input(Input::Leave));
        inlet.turn_of(at(9), steps + 5);
        // A refusal of a datagram of an earlier turn changes nothing.
        inlet.push(Event::Refused(LinkId(1), Refusal::Late, vec![1].into()));
        inlet.turn_of(at(10), steps + 6);
        let mut events = Vec::new();
        assert!(outlet.take(&mut events));
        let said: Vec<String> = events
            .iter()
            .map(|event| match event {
                Event::Input(Input::Refused(link, cause, count)) => format!("{cause:?} {} {count}", link.0),
                Event::Input(Input::Frame(_, frame, _)) => format!("frame {}", frame.len()),
                Event::Input(Input::Leave) => "leave".to_owned(),
                Event::Turn(at) => format!("turn {}", at.as_nanos() / 1_000_000),
                other => panic!("{other:?}"),
            })
            .collect();
        let expected = ["Auth 1 2100", "turn 2", "frame 40", "Duplicate 1 1", "leave", "turn 9", "turn 10"];
        assert_eq!(said, expected);
        assert_eq!(inlet.dropped(), 0);
    }

    #[test]
    fn a_simulation_waits_for_its_writer_and_loses_nothing() {
        let (inlet, outlet) = queue(WhenFull::Wait);
        let writer = std::thread::spawn(move || {
            let (mut all, mut events) = (Vec::new(), Vec::new());
            while outlet.take(&mut events) {
                all.extend(stamps(&events));
                events.clear();
            }
            all
        });
        let count = 10 * BATCH as u64 + 3;
        for at in 0..count {
            inlet.push(Event::Dropped(at));
            inlet.turn(Time::from_nanos(at));
            inlet.turn(Time::from_nanos(at));
        }
        drop(inlet);
        let expected: Vec<u64> = (0..count).flat_map(|at| [1_000_000 + at, at]).collect();
        assert_eq!(writer.join().unwrap(), expected);
    }

    #[test]
    fn events_for_a_writer_that_has_ended_are_counted() {
        for when_full in [WhenFull::Drop, WhenFull::Wait] {
            let (inlet, outlet) = queue(when_full);
            drop(outlet);
            (0..BATCH as u64 / 2).for_each(|at| {
                inlet.push(Event::Dropped(1));
                inlet.turn(Time::from_nanos(at));
            });
            assert_eq!(inlet.dropped(), BATCH as u64);
        }
    }
}
