//! The clock of a run: the present, and an event queue ordered by (time, sequence). There is no other source of
//! order, so under virtual time a seed gives the same run, however often. `drive` and `real` move it on.

use std::cell::{Cell, RefCell};
use std::cmp::Ordering;
use std::collections::BinaryHeap;
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
    sleepers: Vec<Rc<dyn Fn()>>,
}

/// Who can be woken by the clock.
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

    /// Makes `wake` known; it is called whenever an instant comes that was `arm`ed for it.
    pub fn register(&self, wake: Rc<dyn Fn()>) -> Sleeper {
        let mut queue = self.queue.borrow_mut();
        queue.sleepers.push(wake);
        Sleeper(queue.sleepers.len() - 1)
    }

    /// Wakes `sleeper` at `at`.
    pub fn arm(&self, at: Time, sleeper: Sleeper) {
        self.push(at, What::Wake(sleeper));
    }

    /// Calls `call` at `at`.
    pub fn call(&self, at: Time, call: Box<dyn FnOnce()>) {
        self.push(at, What::Call(call));
    }

    fn push(&self, at: Time, what: What) {
        let mut queue = self.queue.borrow_mut();
        let sequence = queue.sequence;
        queue.sequence += 1;
        queue.events.push(Event { at: at.max(self.now()), sequence, what });
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
    pub(super) fn next(&self) -> Option<Time> {
        self.queue.borrow().events.peek().map(|event| event.at)
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
            What::Wake(Sleeper(index)) => {
                let wake = Rc::clone(&self.queue.borrow().sleepers[index]);
                wake();
            }
        }
    }

    /// Lets go of all sleepers and events, which hold the actors that hold this clock.
    pub(super) fn clear(&self) {
        *self.queue.borrow_mut() = Queue::default();
    }
}
