//! Clock of a run: the current time, an event queue ordered by (time, sequence), and the queue of tasks that were
//! woken, in that order. Nothing else determines the order, so under virtual time the same seed gives the same run.
//! `drive` and `real` advance it.

use std::cell::{Cell, RefCell};
use std::cmp::Ordering;
use std::collections::{BinaryHeap, VecDeque};
use std::rc::Rc;

use crate::time::Time;

/// Time and event queue that the actors of one run share.
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
    /// Whether it is in the queue of woken tasks.
    rung: bool,
    /// Latest time at which it has to be woken, in real time; `Time::MAX` if never.
    latest: Time,
}

/// Handle of a task, which a mailbox or the clock can wake.
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
        // Reversed: the heap returns its greatest element first, and the earliest event is due first.
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
    /// Returns the current time.
    pub fn now(&self) -> Time {
        self.now.get()
    }

    /// Registers a task; `attend` runs once after each time that it was woken.
    pub fn register(&self, attend: Rc<dyn Fn()>) -> Sleeper {
        let mut queue = self.queue.borrow_mut();
        queue.sleepers.push(Registered { attend, rung: false, latest: Time::MAX });
        Sleeper(queue.sleepers.len() - 1)
    }

    /// Wakes a task: it runs after all tasks that were woken before it.
    pub fn ring(&self, sleeper: Sleeper) {
        let Queue { sleepers, rung, .. } = &mut *self.queue.borrow_mut();
        // After the end of a run no task is left.
        if let Some(registered) = sleepers.get_mut(sleeper.0)
            && !std::mem::replace(&mut registered.rung, true)
        {
            rung.push_back(sleeper.0);
        }
    }

    /// Runs woken tasks until none is left.
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

    /// Schedules a wake-up of a task. In real time it may be delayed until the time given to [`Clock::expect`].
    pub fn arm(&self, at: Time, sleeper: Sleeper) {
        self.push(at, What::Wake(sleeper));
    }

    /// Sets the latest time at which a task that is armed for then or before has to be woken; none for never.
    pub fn expect(&self, latest: Option<Time>, sleeper: Sleeper) {
        if let Some(registered) = self.queue.borrow_mut().sleepers.get_mut(sleeper.0) {
            registered.latest = latest.unwrap_or(Time::MAX);
        }
    }

    /// Schedules a call.
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

    /// Advances to the earliest event and executes it; `false` if there is none.
    pub(super) fn step(&self) -> bool {
        let Some(event) = self.queue.borrow_mut().events.pop() else { return false };
        assert!(event.at >= self.now(), "time runs forward");
        self.now.set(event.at);
        self.happen(event.what);
        true
    }

    /// Returns the time of the earliest event.
    fn next(&self) -> Option<Time> {
        self.queue.borrow().events.peek().map(|event| event.at)
    }

    /// Returns the latest time until which a driver of real time may sleep. It looks at all tasks, of which a host has
    /// few; an event for a task that has since been re-armed does not wake the driver.
    pub(super) fn latest(&self) -> Option<Time> {
        let queue = self.queue.borrow();
        let calls = queue.events.iter().filter(|event| matches!(event.what, What::Call(_))).map(|event| event.at);
        let latest = queue.sleepers.iter().map(|sleeper| sleeper.latest).chain(calls).fold(Time::MAX, Time::min);
        Some(latest).filter(|latest| *latest < Time::MAX)
    }

    /// Sets the current time, as read from a real clock; events before it stay in the queue.
    pub(super) fn set(&self, now: Time) {
        self.now.set(now.max(self.now()));
    }

    /// Executes the earliest event that is due by now, however late; `false` if there is none.
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

    /// Drops all tasks and events, which hold the actors that hold this clock.
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
