//! The clock of a run: the present, an event queue ordered by (time, sequence), and who has been rung since, in that
//! order. There is no other source of order, so under virtual time a seed gives the same run, however often. `drive`
//! and `real` move it on.

use std::cell::{Cell, RefCell};
use std::cmp::Ordering;
use std::collections::{BinaryHeap, VecDeque};
use std::rc::Rc;

use crate::time::Time;

/// What the actors of one virtual world share: the time, and the queue of what is due.
#[derive(Clone, Default)]
pub struct Clock {
    now: Rc<Cell<Time>>,
    queue: Rc<RefCell<Queue>>,
}

#[derive(Default)]
struct Queue {
    events: BinaryHeap<Event>,
    sequence: u64,
    sleepers: Vec<Registered>,
    rung: VecDeque<usize>,
}

struct Registered {
    attend: Rc<dyn Fn()>,
    /// It is not rung twice before it has attended.
    rung: bool,
    /// When it has to be rung at the latest, in real time; `Time::MAX` if it need not be.
    latest: Time,
}

/// Who can be rung, by a mailbox or by the clock.
#[derive(Clone, Copy, Debug)]
pub struct Sleeper(usize);

struct Event {
    at: Time,
    sequence: u64,
    what: What,
}

enum What {
    Wake(Sleeper),
    Call(Box<dyn FnOnce()>),
}

impl Ord for Event {
    fn cmp(&self, other: &Event) -> Ordering {
        // Reversed: the heap gives its greatest first, and the earliest event is due first.
        (other.at, other.sequence).cmp(&(self.at, self.sequence))
    }
}

impl PartialOrd for Event {
    fn partial_cmp(&self, other: &Event) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Event {
    fn eq(&self, other: &Event) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Event {}

impl Clock {
    /// The present.
    pub fn now(&self) -> Time {
        self.now.get()
    }

    /// Makes `attend` known; it is called once after every time that it was rung.
    pub fn register(&self, attend: Rc<dyn Fn()>) -> Sleeper {
        let mut queue = self.queue.borrow_mut();
        queue.sleepers.push(Registered { attend, rung: false, latest: Time::MAX });
        Sleeper(queue.sleepers.len() - 1)
    }

    /// `sleeper` attends when those have attended that were rung before it.
    pub fn ring(&self, sleeper: Sleeper) {
        let Queue { sleepers, rung, .. } = &mut *self.queue.borrow_mut();
        // A run that has ended has nobody left to ring.
        if let Some(registered) = sleepers.get_mut(sleeper.0)
            && !std::mem::replace(&mut registered.rung, true)
        {
            rung.push_back(sleeper.0);
        }
    }

    /// Lets everyone attend who is rung, until nobody is.
    pub(super) fn attend(&self) {
        while let Some(attend) = self.next_rung() {
            attend();
        }
    }

    fn next_rung(&self) -> Option<Rc<dyn Fn()>> {
        let Queue { sleepers, rung, .. } = &mut *self.queue.borrow_mut();
        let registered = &mut sleepers[rung.pop_front()?];
        registered.rung = false;
        Some(Rc::clone(&registered.attend))
    }

    /// Rings `sleeper` at `at`. Real time may pass over that until whoever is rung has to be.
    pub fn arm(&self, at: Time, sleeper: Sleeper) {
        self.push(at, What::Wake(sleeper));
    }

    /// From now on `sleeper`, which is armed for then or before, has to be rung by `latest`, or never.
    pub fn expect(&self, latest: Option<Time>, sleeper: Sleeper) {
        if let Some(registered) = self.queue.borrow_mut().sleepers.get_mut(sleeper.0) {
            registered.latest = latest.unwrap_or(Time::MAX);
        }
    }

    /// Calls `call` at `at`.
    pub fn call(&self, at: Time, call: Box<dyn FnOnce()>) {
        self.push(at, What::Call(call));
    }

    fn push(&self, at: Time, what: What) {
        let mut queue = self.queue.borrow_mut();
        let sequence = queue.sequence;
        queue.sequence += 1;
        let at = at.max(self.now());
        queue.events.push(Event { at, sequence, what });
    }

    /// Goes to the earliest event and lets it happen; `false` if there is none.
    pub(super) fn step(&self) -> bool {
        let Some(event) = self.queue.borrow_mut().events.pop() else { return false };
        assert!(event.at >= self.now(), "time runs forward");
        self.now.set(event.at);
        self.happen(event.what);
        true
    }

    /// When the earliest event is due.
    fn next(&self) -> Option<Time> {
        self.queue.borrow().events.peek().map(|event| event.at)
    }

    /// When a driver of real time has to be awake at the latest. Looks at everyone, of whom a host has few; an event
    /// for a sleeper that has changed its mind since wakes nobody by itself.
    pub(super) fn latest(&self) -> Option<Time> {
        let queue = self.queue.borrow();
        let calls = queue.events.iter().filter(|event| matches!(event.what, What::Call(_))).map(|event| event.at);
        let latest = queue.sleepers.iter().map(|sleeper| sleeper.latest).chain(calls).fold(Time::MAX, Time::min);
        Some(latest).filter(|latest| *latest < Time::MAX)
    }

    /// The present is `now`, as read from a real clock, which may have passed over events.
    pub(super) fn set(&self, now: Time) {
        self.now.set(now.max(self.now()));
    }

    /// Lets the earliest event happen that is due by now, however late; `false` if there is none.
    pub(super) fn catch_up(&self) -> bool {
        if self.next().is_none_or(|at| at > self.now()) {
            return false;
        }
        let event = self.queue.borrow_mut().events.pop().expect("there is a next event");
        self.happen(event.what);
        true
    }

    fn happen(&self, what: What) {
        match what {
            What::Call(call) => call(),
            What::Wake(sleeper) => self.ring(sleeper),
        }
    }

    /// Lets go of all sleepers and events, which hold the actors that hold this clock.
    pub(super) fn clear(&self) {
        *self.queue.borrow_mut() = Queue::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Span;

    #[test]
    fn an_event_that_may_be_late_waits_for_one_that_may_not() {
        let clock = Clock::default();
        let ms = |ms: u64| Time::ZERO + Span::from_millis(ms);
        let sleeper = clock.register(Rc::new(|| {}));
        clock.arm(ms(10), sleeper);
        clock.expect(Some(ms(15)), sleeper);
        assert_eq!(clock.latest(), Some(ms(15)));
        clock.call(ms(12), Box::new(|| {}));
        assert_eq!(clock.latest(), Some(ms(12)), "both at once");
        clock.set(ms(12));
        assert!(clock.catch_up() && clock.catch_up() && !clock.catch_up());
        clock.expect(None, sleeper);
        assert_eq!(clock.latest(), None);
    }

    #[test]
    fn who_wants_to_be_rung_later_than_before_is_not_waited_for_before() {
        let clock = Clock::default();
        let ms = |ms: u64| Time::ZERO + Span::from_millis(ms);
        let sleeper = clock.register(Rc::new(|| {}));
        clock.arm(ms(10), sleeper);
        clock.expect(Some(ms(10)), sleeper);
        clock.expect(Some(ms(30)), sleeper);
        assert_eq!(clock.latest(), Some(ms(30)));
        clock.set(ms(30));
        assert!(clock.catch_up(), "the event of before rings it");
    }
}
