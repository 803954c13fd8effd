//! Shell of an actor: adds a mailbox, a timer, supervision and fault injection to the actor's core, its state machine.
//!
//! A mailbox is bounded; refused messages are counted and dropped. Messages of one sender stay in order; between
//! senders there is no guaranteed order. The actor library starts, stops and restarts an actor. The mailbox is not the
//! library's, and the clock runs woken actors in the order of their wake-ups: the library's own mailboxes and tasks
//! took a third of a run's time. An actor that crashes by an injected fault restarts with a new core. A panic ends the
//! process: state after a broken invariant must not drive a robot.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::{Rc, Weak};

use actix::{Actor, ActorContext, Addr, Context, Handler, Message, Supervised, Supervisor, System};
use tracing::Span as TraceSpan;

use super::clock::{Clock, TaskId};
use super::mailbox::Envelope;
pub use super::mailbox::{MAILBOX_CAPACITY, Mailbox};
use crate::actor::Core;
use crate::edge::panic::end_if_panicking;
use crate::faults::{ActorFault, ActorFaultKind};
use crate::time::{Span, Time};

/// Number of successive wake-ups of a core (an actor's state machine) at one instant that counts as a bug and panics.
const MAX_WAKES_AT_ONCE: usize = 64;

/// An actor: its core (state machine) with mailbox, timer, injected faults and supervision.
struct Shell<C: Core + 'static> {
    make: Box<dyn FnMut(u32) -> C>,
    core: Option<C>,
    incarnation: u32,
    /// Address by which the actor library is told to stop and restart the actor after an injected crash.
    supervisee: Option<Addr<Supervisee<C>>>,
    /// False from an injected crash until the actor library has restarted the actor.
    alive: bool,
    sink: Box<dyn FnMut(C::Out)>,
    out: Vec<C::Out>,
    clock: Clock,
    task: TaskId,
    armed: Option<Time>,
    /// Time of the actor's next turn, as last given to the clock.
    expected: Option<Time>,
    faults: Faults,
    held: VecDeque<(Time, C::In)>,
    mailbox: Mailbox<C::In>,
}

/// Injected faults of an actor: for each kind the time until which it lasts, and the delay of inputs while it is slow.
#[derive(Default)]
struct Faults {
    down: Time,
    stalled: Time,
    mute: Time,
    slow: Time,
    slow_by: Span,
}

impl Faults {
    /// Returns the time at which an input or a timer that is due at `at` is processed under the injected faults: `at`
    /// itself, or later if the actor is slow or stalled.
    #[inline]
    fn taken_up(&self, at: Time) -> Time {
        let at = if at < self.slow { at + self.slow_by } else { at };
        at.max(self.stalled)
    }
}

/// Starts an actor that takes its messages from `mailbox`. The function `make` builds its core (state machine) at each
/// start or restart, with the number of the start, from 1. Each output of the core is passed to `sink`. Log lines of
/// the actor belong to `span`. Panics if the mailbox already has an actor.
pub fn start<C: Core + 'static>(
    clock: &Clock,
    mailbox: &Mailbox<C::In>,
    span: TraceSpan,
    mut make: impl FnMut(u32) -> C + 'static,
    sink: impl FnMut(C::Out) + 'static,
) {
    let shell = Rc::new_cyclic(|shell: &Weak<RefCell<Shell<C>>>| {
        let (shell, name, time) = (shell.clone(), mailbox.clone(), clock.clone());
        let task = clock.register(Rc::new(move || {
            if let Some(shell) = shell.upgrade() {
                let (now, _inside) = (time.now(), span.enter());
                let _guard = ExitOnPanic { name: name.name(), now };
                name.0.before.get().iter().for_each(|settle| settle());
                shell.borrow_mut().run(now);
            }
        }));
        RefCell::new(Shell {
            core: Some(make(1)),
            make: Box::new(make),
            incarnation: 1,
            supervisee: None,
            alive: true,
            sink: Box::new(sink),
            out: Vec::new(),
            clock: clock.clone(),
            task,
            armed: None,
            expected: None,
            faults: Faults::default(),
            held: VecDeque::new(),
            mailbox: mailbox.clone(),
        })
    });
    let task = shell.borrow().task;
    assert!(mailbox.0.waker.set((clock.clone(), task)).is_ok(), "{} is started once", mailbox.name());
    let supervisee = Supervisee(Rc::clone(&shell));
    // The supervisor stops an actor without a held address.
    shell.borrow_mut().supervisee = Some(Supervisor::start(move |_: &mut Context<Supervisee<C>>| supervisee));
    // In its first turn the core returns its first wake-up time.
    clock.wake(task);
}

impl<C: Core + 'static> Shell<C> {
    fn take_in(&mut self, now: Time, input: C::In) {
        self.clock.count_step();
        let due = self.faults.taken_up(now);
        let Some(core) = &mut self.core else { return self.mailbox.lose(1) };
        if due <= now && self.held.is_empty() {
            core.handle(now, input, &mut self.out);
        } else if self.held.len() < MAILBOX_CAPACITY {
            self.held.push_back((due, input));
        } else {
            self.mailbox.refuse();
        }
    }

    /// Processes all messages in the mailbox, then timers and delayed inputs that are due. Messages after an injected
    /// crash are lost.
    fn run(&mut self, now: Time) {
        self.mailbox.0.left.set(false);
        loop {
            let next = self.mailbox.0.queue.borrow_mut().pop_front();
            match next {
                None => {
                    // The next messages then take the same places of memory, and not those after the last ones.
                    self.mailbox.0.queue.borrow_mut().clear();
                    break;
                }
                Some(Envelope::Deliver(input)) => self.take_in(now, input),
                Some(Envelope::Left(at, input)) => {
                    let clock = self.clock.clone();
                    clock.as_of(at, || {
                        self.take_in(at, input);
                        self.pass_on(at);
                    });
                }
                Some(Envelope::Inject(fault)) => {
                    self.clock.count_step();
                    self.inject(now, &fault);
                }
                Some(Envelope::Recover) => {
                    self.clock.count_step();
                    self.faults = Faults::default();
                }
            }
        }
        self.turn(now);
    }

    /// Restarts the core after a crash, processes delayed inputs and timers that are due, passes on the output, and
    /// sets the timer for the next turn.
    fn turn(&mut self, now: Time) {
        if self.core.is_none() {
            self.restart(now);
        }
        if !self.held.is_empty() {
            self.take_up_held(now);
        }
        let mut next = self.core.as_ref().and_then(Core::wake_at);
        if let Some(core) = &mut self.core {
            let mut wakes = 0;
            while next.is_some_and(|at| self.faults.taken_up(at) <= now) {
                self.clock.count_step();
                core.wake(now, &mut self.out);
                wakes += 1;
                assert!(wakes < MAX_WAKES_AT_ONCE, "a woken core wants to be woken later, not again at {now}");
                next = core.wake_at();
            }
        }
        self.pass_on(now);
        self.arm(now, next);
    }

    /// Passes on what the core has put out.
    fn pass_on(&mut self, now: Time) {
        if !self.out.is_empty() {
            let muted = now < self.faults.mute;
            self.out.drain(..).filter(|_| !muted).for_each(&mut self.sink);
        }
    }

    /// Makes a new core, if the actor library has restarted the actor and the time of the injected crash is over.
    #[cold]
    fn restart(&mut self, now: Time) {
        if self.alive && now >= self.faults.down {
            self.incarnation += 1;
            self.clock.count_step();
            self.core = Some((self.make)(self.incarnation));
            tracing::info!(incarnation = self.incarnation, "restarted");
        }
    }

    /// Passes to the core those inputs that a fault has delayed and that are due now.
    #[cold]
    fn take_up_held(&mut self, now: Time) {
        let Some(core) = &mut self.core else { return };
        while self.held.front().is_some_and(|(due, _)| (*due).max(self.faults.stalled) <= now) {
            let (_, input) = self.held.pop_front().expect("there is a front");
            self.clock.count_step();
            core.handle(now, input, &mut self.out);
        }
    }

    /// Sets the timer of the actor for its next turn: the wake-up time `wake` of the core, a delayed input or the
    /// restart after a crash, whichever is first.
    fn arm(&mut self, now: Time, wake: Option<Time>) {
        let next = match &self.core {
            None => Some(self.faults.down),
            Some(_) => {
                let wake = wake.map(|at| self.faults.taken_up(at));
                let held = self.held.front().map(|(due, _)| (*due).max(self.faults.stalled));
                wake.into_iter().chain(held).min()
            }
        };
        if next != self.expected {
            self.expected = next;
            let tolerance = |at: Time| self.core.as_ref().map_or(Span::ZERO, |core| core.tolerance(at.since(now)));
            self.clock.expect(next.map(|at| at + tolerance(at)), self.task);
        }
        // An earlier wake-up that is still scheduled calls this again: one event serves many re-armings.
        let stands = self.armed.filter(|at| *at > now);
        if let Some(next) = next
            && stands.is_none_or(|at| next < at)
        {
            self.clock.arm(next, self.task);
            self.armed = Some(next);
        }
    }

    #[cold]
    fn inject(&mut self, now: Time, fault: &ActorFault) {
        tracing::warn!(kind = ?fault.kind, lasts = %fault.lasts, "fault injected");
        let until = now + fault.lasts;
        match fault.kind {
            // Of two faults at once the longer one counts.
            ActorFaultKind::Stall => self.faults.stalled = self.faults.stalled.max(until),
            ActorFaultKind::Mute => self.faults.mute = self.faults.mute.max(until),
            ActorFaultKind::Slow => {
                self.faults.slow = self.faults.slow.max(until);
                self.faults.slow_by = fault.by;
            }
            // It is the robot's, and none of the actor.
            ActorFaultKind::Flat => {}
            ActorFaultKind::Crash => {
                self.faults = Faults { down: self.faults.down.max(until), ..Faults::default() };
                // A crash loses the actor's state, unsent output and delayed inputs.
                self.core = None;
                self.out.clear();
                self.mailbox.lose(self.held.len());
                self.held.clear();
                self.alive = false;
                self.supervisee.as_ref().expect("it was started").do_send(Crash);
            }
        }
    }
}

/// The part of an actor that the actor library knows: the library starts it, stops it at an injected crash and restarts
/// it.
struct Supervisee<C: Core + 'static>(Rc<RefCell<Shell<C>>>);

/// Message of the actor library that stops an actor at an injected crash, so that its supervisor restarts it.
struct Crash;

impl Message for Crash {
    type Result = ();
}

impl<C: Core + 'static> Actor for Supervisee<C> {
    type Context = Context<Self>;
}

impl<C: Core + 'static> Handler<Crash> for Supervisee<C> {
    type Result = ();

    fn handle(&mut self, _: Crash, context: &mut Self::Context) {
        context.stop();
    }
}

impl<C: Core + 'static> Supervised for Supervisee<C> {
    fn restarting(&mut self, _: &mut Self::Context) {
        let mut shell = self.0.borrow_mut();
        shell.alive = true;
        shell.clock.wake(shell.task);
    }
}

/// Guard that reports a panic in an actor and ends the process when the panic drops it. Without it, the actor library
/// would continue without a message.
struct ExitOnPanic<'a> {
    name: &'a str,
    now: Time,
}

impl Drop for ExitOnPanic<'_> {
    fn drop(&mut self) {
        end_if_panicking(|| (self.name.to_owned(), format!(" at {}", self.now)));
    }
}

/// Runs the function `inside` on this thread in a new system of the actor library, so that it can start actors, and
/// returns its result.
pub(super) fn in_system<R>(inside: impl FnOnce() -> R) -> R {
    let system = System::with_tokio_rt(|| {
        tokio::runtime::Builder::new_current_thread().build().expect("a runtime without I/O or timers needs nothing")
    });
    system.block_on(async { inside() })
}
