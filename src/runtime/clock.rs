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
    tasks: Vec<Task>,
    woken: VecDeque<usize>,
}

struct Task {
    run: Rc<dyn Fn()>,
    /// Whether it is in the queue of woken tasks.
    woken: bool,
    /// Latest time at which it has to be woken, in real time; `Time::MAX` if never.
    latest: Time,
}

/// Handle of a task of the clock. A task runs after a mailbox or the clock has woken it.
#[derive(Clone, Copy, Debug)]
pub struct TaskId(usize);

struct Event {
    at: Time,
    sequence: u64,
    action: Action,
}

enum Action {
    Wake(TaskId),
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
    /// Current time of the run.
    pub fn now(&self) -> Time {
        self.now.get()
    }

    /// Registers a task with the function `run`, which is called once after each time that the task was woken.
    pub fn register(&self, run: Rc<dyn Fn()>) -> TaskId {
        let mut queue = self.queue.borrow_mut();
        queue.tasks.push(Task { run, woken: false, latest: Time::MAX });
        TaskId(queue.tasks.len() - 1)
    }

    /// Wakes a task: it runs after all tasks that were woken before it.
    pub fn wake(&self, task: TaskId) {
        let Queue { tasks, woken, .. } = &mut *self.queue.borrow_mut();
        // After the end of a run no task is left.
        if let Some(task_entry) = tasks.get_mut(task.0)
            && !std::mem::replace(&mut task_entry.woken, true)
        {
            woken.push_back(task.0);
        }
    }

    /// Runs woken tasks until none is left.
    pub(super) fn run_woken(&self) {
        while let Some(run) = self.next_woken() {
            run();
        }
    }

    fn next_woken(&self) -> Option<Rc<dyn Fn()>> {
        let Queue { tasks, woken, .. } = &mut *self.queue.borrow_mut();
        let task_entry = &mut tasks[woken.pop_front()?];
        task_entry.woken = false;
        Some(Rc::clone(&task_entry.run))
    }

    /// Schedules a wake-up of `task` at time `at`. In real time the wake-up may be delayed until the time given to
    /// [`Clock::expect`].
    pub fn arm(&self, at: Time, task: TaskId) {
        self.push(at, Action::Wake(task));
    }

    /// Sets the latest time to which the wake-ups of `task` may be delayed in real time; `None` if no wake-up is
    /// expected.
    pub fn expect(&self, latest: Option<Time>, task: TaskId) {
        if let Some(task_entry) = self.queue.borrow_mut().tasks.get_mut(task.0) {
            task_entry.latest = latest.unwrap_or(Time::MAX);
        }
    }

    /// Schedules one call of the function `call` at time `at`.
    pub fn call(&self, at: Time, call: Box<dyn FnOnce()>) {
        self.push(at, Action::Call(call));
    }

    fn push(&self, at: Time, action: Action) {
        let mut queue = self.queue.borrow_mut();
        let sequence = queue.sequence;
        queue.sequence += 1;
        let at = at.max(self.now());
        queue.events.push(Event { at, sequence, action });
    }

    /// Advances to the earliest event and executes it; `false` if there is none.
    pub(super) fn step(&self) -> bool {
        let Some(event) = self.queue.borrow_mut().events.pop() else { return false };
        assert!(event.at >= self.now(), "time runs forward");
        self.now.set(event.at);
        self.execute(event.action);
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
        let calls = queue.events.iter().filter(|event| matches!(event.action, Action::Call(_))).map(|event| event.at);
        let latest = queue.tasks.iter().map(|task| task.latest).chain(calls).fold(Time::MAX, Time::min);
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
        self.execute(event.action);
        true
    }

    fn execute(&self, action: Action) {
        match action {
            Action::Call(call) => call(),
            Action::Wake(task) => self.wake(task),
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
        let task = clock.register(Rc::new(|| {}));
        clock.arm(ms(10), task);
        clock.expect(Some(ms(15)), task);
        assert_eq!(clock.latest(), Some(ms(15)));
        clock.call(ms(12), Box::new(|| {}));
        assert_eq!(clock.latest(), Some(ms(12)), "both at once");
        clock.set(ms(12));
        assert!(clock.catch_up() && clock.catch_up() && !clock.catch_up());
        clock.expect(None, task);
        assert_eq!(clock.latest(), None);
    }

    #[test]
    fn a_task_that_is_postponed_does_not_wake_the_driver_at_its_earlier_time() {
        let clock = Clock::default();
        let ms = |ms: u64| Time::ZERO + Span::from_millis(ms);
        let task = clock.register(Rc::new(|| {}));
        clock.arm(ms(10), task);
        clock.expect(Some(ms(10)), task);
        clock.expect(Some(ms(30)), task);
        assert_eq!(clock.latest(), Some(ms(30)));
        clock.set(ms(30));
        assert!(clock.catch_up(), "the event of before wakes it");
    }
}
