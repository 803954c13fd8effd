//! Clock of a run: the current time, a queue of events ordered by time and then by their insertion, and a queue of the
//! actors' tasks in the order in which they were woken. Nothing else determines the order of execution, so under
//! virtual time the same seed gives the same run. The drivers of time `drive`, `real` and `replay` advance it.

use std::cell::{Cell, RefCell};
use std::cmp::Ordering;
use std::collections::{BinaryHeap, VecDeque};
use std::rc::Rc;

use crate::time::Time;

/// Clock of a run: its current time, the queue of scheduled events and the queue of woken actors. Clones share them.
#[derive(Clone, Default)]
pub struct Clock {
    now: Rc<Cell<Time>>,
    /// Whether `now` is an earlier time for a while.
    past: Rc<Cell<bool>>,
    queue: Rc<RefCell<Queue>>,
    steps: Rc<Cell<u64>>,
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
    /// Whether the task is in the queue of woken tasks.
    woken: bool,
    /// In real time, latest time at which the task has to be woken; `Time::MAX` if it need not be woken.
    latest: Time,
}

/// Handle of a task that is registered with a [`Clock`]: a function that runs one actor each time the actor is woken.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TaskId(usize);

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
    /// Returns the current time of the run.
    pub fn now(&self) -> Time {
        self.now.get()
    }

    /// Runs the function `inside` as of the earlier time `past`, which is the current time until it returns.
    pub(super) fn as_of(&self, past: Time, inside: impl FnOnce()) {
        let (now, before) = (self.now.replace(past), self.past.replace(true));
        inside();
        self.now.set(now);
        self.past.set(before);
    }

    /// Returns whether something runs as of an earlier time.
    #[inline]
    pub(super) fn is_past(&self) -> bool {
        self.past.get()
    }

    /// Returns how many things the actors have done so far: messages that they handled, wake-ups, and scheduled calls.
    pub(crate) fn steps(&self) -> u64 {
        self.steps.get()
    }

    /// Notes that an actor has done something.
    #[inline]
    pub(super) fn count_step(&self) {
        self.steps.set(self.steps.get() + 1);
    }

    /// Registers a task with the function `run`, which is called once each time that the task was woken.
    pub(crate) fn register(&self, run: Rc<dyn Fn()>) -> TaskId {
        let mut queue = self.queue.borrow_mut();
        queue.tasks.push(Task { run, woken: false, latest: Time::MAX });
        TaskId(queue.tasks.len() - 1)
    }

    /// Wakes a task: it runs once, after all tasks that were woken before it. A task that is already woken is left
    /// where it is in the queue.
    pub(crate) fn wake(&self, task: TaskId) {
        let Queue { tasks, woken, .. } = &mut *self.queue.borrow_mut();
        // After the end of a run no task is left.
        if let Some(task_entry) = tasks.get_mut(task.0)
            && !std::mem::replace(&mut task_entry.woken, true)
        {
            woken.push_back(task.0);
        }
    }

    /// Runs the woken tasks, and those that they wake, until none is left.
    pub(super) fn run_woken(&self) {
        while let Some(run) = self.next_woken() {
            run();
        }
    }

    /// Runs a task at once, whether it is woken or not. It must not be the one that runs.
    pub(super) fn run(&self, task: TaskId) {
        let run = self.queue.borrow().tasks.get(task.0).map(|task| Rc::clone(&task.run));
        // After the end of a run no task is left.
        run.iter().for_each(|run| run());
    }

    fn next_woken(&self) -> Option<Rc<dyn Fn()>> {
        let Queue { tasks, woken, .. } = &mut *self.queue.borrow_mut();
        let task_entry = &mut tasks[woken.pop_front()?];
        task_entry.woken = false;
        Some(Rc::clone(&task_entry.run))
    }

    /// Schedules a wake-up of `task` at time `at`. In real time the wake-up may be delayed up to the latest time that
    /// `expect` has set.
    pub(crate) fn arm(&self, at: Time, task: TaskId) {
        self.push(at, Action::Wake(task));
    }

    /// Sets the latest time to which wake-ups of `task` may be delayed in real time, so that several are served at
    /// once; `None` if no wake-up is expected.
    pub(crate) fn expect(&self, latest: Option<Time>, task: TaskId) {
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

    /// Removes the earliest event from the queue, sets the current time to its time and executes it. Returns `false` if
    /// there is no event.
    pub(super) fn step(&self) -> bool {
        let Some(event) = self.queue.borrow_mut().events.pop() else { return false };
        assert!(event.at >= self.now(), "time runs forward");
        self.now.set(event.at);
        self.execute(event.action);
        true
    }

    /// Returns the time of the earliest event in the queue; `None` if there is no event.
    fn next(&self) -> Option<Time> {
        self.queue.borrow().events.peek().map(|event| event.at)
    }

    /// Returns the latest time until which the event loop may sleep in real time: the earliest of the latest times of
    /// all tasks' wake-ups and of the scheduled calls; `None` if there is none.
    pub(super) fn latest(&self) -> Option<Time> {
        let queue = self.queue.borrow();
        let calls = queue.events.iter().filter(|event| matches!(event.action, Action::Call(_))).map(|event| event.at);
        let latest = queue.tasks.iter().map(|task| task.latest).chain(calls).fold(Time::MAX, Time::min);
        Some(latest).filter(|latest| *latest < Time::MAX)
    }

    /// Sets the current time, as read from a real clock or a recording; it never goes back. Events that are due stay in
    /// the queue.
    pub(super) fn set(&self, now: Time) {
        self.now.set(now.max(self.now()));
    }

    /// Removes the earliest event from the queue and executes it if its time has come, however late it is. Returns
    /// `false` if no event is due.
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
            Action::Call(call) => {
                self.count_step();
                call();
            }
            Action::Wake(task) => self.wake(task),
        }
    }

    /// Drops all tasks and events at the end of a run. They hold references to actors, which hold this clock, so that
    /// otherwise neither would be freed.
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
