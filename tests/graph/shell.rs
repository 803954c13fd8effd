//! Guarantees of the shell about mailboxes, timers, restarts and injected faults, tested with a core that records
//! everything it is given.

use std::cell::RefCell;
use std::process::Command;
use std::rc::Rc;
use std::time::Duration;

use actix::Recipient;
use murmurate::actor::Core;
use murmurate::edge::{self, Input, Packet, Seat, Worker};
use murmurate::faults::{ActorFault, ActorFaultKind, Role};
use murmurate::messages::ids::RobotId;
use murmurate::runtime::clock::Clock;
use murmurate::runtime::drive::{End, run_virtual};
use murmurate::runtime::shell::{MAILBOX_CAPACITY, Mailbox, start};
use murmurate::time::{Span, Time};

/// Record of one input: incarnation, time \[ms\] and number. Number 0 stands for a timer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Note(u32, u64, u64);

struct Noting {
    incarnation: u32,
    /// Times at which it wakes \[ms\].
    alarms: Vec<u64>,
}

impl Core for Noting {
    type In = u64;
    type Out = Note;

    fn handle(&mut self, now: Time, number: u64, out: &mut Vec<Note>) {
        assert!(number < 1_000_000, "a number that breaks an invariant");
        out.push(Note(self.incarnation, now.as_nanos() / 1_000_000, number));
    }

    fn wake_at(&self) -> Option<Time> {
        self.alarms.iter().min().map(|&ms| at(ms))
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Note>) {
        self.alarms.retain(|&ms| at(ms) > now);
        out.push(Note(self.incarnation, now.as_nanos() / 1_000_000, 0));
    }
}

fn at(ms: u64) -> Time {
    Time::ZERO + Span::from_millis(ms)
}

fn fault(kind: ActorFaultKind, from: u64, lasts: u64) -> ActorFault {
    let (lasts, by) = (Span::from_millis(lasts), Span::from_millis(30));
    ActorFault { role: Role::Cache, robot: RobotId(0), kind, at: at(from), lasts, by, episode: None }
}

/// Sends the numbers to a recording core at their times \[ms\], with these faults. Returns its records and the
/// mailbox's counts of refused and lost messages.
fn notes(alarms: &[u64], sent: &[(u64, u64)], faults: &[ActorFault]) -> (Vec<Note>, u64, u64) {
    let said = Rc::new(RefCell::new(Vec::new()));
    let build = |clock: &Clock| {
        let mailbox = Mailbox::new("noting");
        let (alarms, said) = (alarms.to_vec(), Rc::clone(&said));
        let make = move |incarnation| Noting { incarnation, alarms: alarms.clone() };
        start(clock, &mailbox, tracing::Span::none(), make, move |note| said.borrow_mut().push(note));
        for &(ms, number) in sent {
            let mailbox: Mailbox<u64> = mailbox.clone();
            clock.call(at(ms), Box::new(move || mailbox.send(number)));
        }
        for fault in faults.iter().cloned() {
            let mailbox = mailbox.clone();
            clock.call(fault.at, Box::new(move || mailbox.inject(fault)));
        }
        mailbox
    };
    let (mailbox, end) = run_virtual(build, |_, _| false);
    assert_eq!(end, End::Idle);
    let notes = said.borrow().clone();
    (notes, mailbox.refused(), mailbox.lost())
}

#[test]
fn messages_are_handled_in_order_and_timers_on_time() {
    let (notes, refused, lost) = notes(&[5, 20, 7], &[(1, 11), (1, 12), (6, 13), (20, 14)], &[]);
    let expected =
        [Note(1, 1, 11), Note(1, 1, 12), Note(1, 5, 0), Note(1, 6, 13), Note(1, 7, 0), Note(1, 20, 14), Note(1, 20, 0)];
    assert_eq!((&notes[..], refused, lost), (&expected[..], 0, 0));
}

#[test]
fn a_full_mailbox_refuses_and_counts() {
    let said = Rc::new(RefCell::new(0));
    let build = |clock: &Clock| {
        let mailbox = Mailbox::new("noting");
        let said = Rc::clone(&said);
        let make = |incarnation| Noting { incarnation, alarms: Vec::new() };
        start(clock, &mailbox, tracing::Span::none(), make, move |_| *said.borrow_mut() += 1);
        let sender = mailbox.clone();
        let flood = move || (0..MAILBOX_CAPACITY as u64 + 10).for_each(|number| sender.send(number + 1));
        clock.call(at(1), Box::new(flood));
        mailbox
    };
    let (mailbox, _) = run_virtual(build, |_, _| false);
    assert_eq!((*said.borrow(), mailbox.refused()), (MAILBOX_CAPACITY, 10));
}

#[test]
fn a_crashed_actor_loses_its_messages_and_restarts_without_state() {
    let sent = [(1, 11), (3, 12), (9, 13), (11, 14)];
    let (notes, refused, lost) = notes(&[1], &sent, &[fault(ActorFaultKind::Crash, 2, 8)]);
    // The alarm at 1 ms was over; the restarted core sets it again, and it fires at once.
    assert_eq!(notes, [Note(1, 1, 11), Note(1, 1, 0), Note(2, 10, 0), Note(2, 11, 14)]);
    assert_eq!((refused, lost), (0, 2));
}

#[test]
fn a_stalled_actor_handles_everything_afterwards_in_order() {
    let sent = [(1, 11), (3, 12), (9, 13), (11, 14)];
    let (notes, _, lost) = notes(&[5], &sent, &[fault(ActorFaultKind::Stall, 2, 8)]);
    assert_eq!(notes, [Note(1, 1, 11), Note(1, 10, 12), Note(1, 10, 13), Note(1, 10, 0), Note(1, 11, 14)]);
    assert_eq!(lost, 0);
}

#[test]
fn a_stalled_actor_queues_a_mailbox_of_messages_and_refuses_the_rest() {
    let flood = (0..MAILBOX_CAPACITY as u64).map(|number| (3, number + 1));
    let more = (1..=10).map(|number| (4, number));
    let sent: Vec<(u64, u64)> = flood.chain(more).collect();
    let (notes, refused, lost) = notes(&[], &sent, &[fault(ActorFaultKind::Stall, 2, 8)]);
    assert_eq!((notes.len(), refused, lost), (MAILBOX_CAPACITY, 10, 0));
}

#[test]
fn a_mute_actor_works_without_output() {
    let (notes, ..) = notes(&[], &[(1, 11), (3, 12), (11, 14)], &[fault(ActorFaultKind::Mute, 2, 8)]);
    assert_eq!(notes, [Note(1, 1, 11), Note(1, 11, 14)]);
}

#[test]
fn a_slow_actor_handles_everything_late_in_order() {
    // Slow from 2 to 10 ms, by 30 ms; later messages must not overtake.
    let sent = [(1, 11), (3, 12), (9, 13), (11, 14), (60, 15)];
    let (notes, ..) = notes(&[5], &sent, &[fault(ActorFaultKind::Slow, 2, 8)]);
    let numbers: Vec<u64> = notes.iter().map(|note| note.2).filter(|number| *number > 0).collect();
    assert_eq!(numbers, [11, 12, 13, 14, 15]);
    assert!(notes.contains(&Note(1, 33, 12)) && notes.contains(&Note(1, 35, 0)) && notes.contains(&Note(1, 39, 13)));
    assert!(notes.contains(&Note(1, 60, 15)));
}

/// Runs only as a child process of the next test.
#[test]
fn child_that_breaks_an_invariant() {
    if std::env::var_os("MURMURATE_TEST_CHILD").is_some() {
        notes(&[], &[(1, 1_000_000)], &[]);
        unreachable!("the process has ended");
    }
}

#[test]
fn a_real_panic_ends_the_process_with_a_clear_message() {
    let this = std::env::current_exe().expect("a test knows where it is");
    let output = Command::new(this)
        .args(["--exact", "shell::child_that_breaks_an_invariant", "--nocapture"])
        .env("MURMURATE_TEST_CHILD", "1")
        .output()
        .expect("the test starts itself");
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(101));
    assert!(said.contains("noting broke an invariant at 0.001 s"), "{said}");
    assert!(!said.contains("the process has ended"), "{said}");
}

/// Worker whose actor breaks an invariant at its first packet.
struct Fragile;

impl Worker for Fragile {
    fn start(self: Box<Self>, seat: Seat) -> Recipient<Input> {
        seat.serve(|| |packet| panic!("it takes no packets, such as {packet:?}"))
    }
}

/// Runs only as a child process of the next test.
#[test]
fn child_whose_worker_breaks_an_invariant() {
    if std::env::var_os("MURMURATE_TEST_CHILD").is_some() {
        let (mut gate, worker) = edge::start(Box::new(Fragile), "driver 3").expect("a thread");
        gate.send(Packet::from(*b"!"));
        // The end of the process comes first.
        worker.join(Duration::from_secs(60));
        unreachable!("the process has ended");
    }
}

#[test]
fn a_panic_in_a_worker_ends_the_process_as_one_in_a_core_does() {
    let this = std::env::current_exe().expect("a test knows where it is");
    let output = Command::new(this)
        .args(["--exact", "shell::child_whose_worker_breaks_an_invariant", "--nocapture"])
        .env("MURMURATE_TEST_CHILD", "1")
        .output()
        .expect("the test starts itself");
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(101), "{said}");
    assert!(said.contains("the worker of driver 3 broke an invariant"), "{said}");
    assert!(!said.contains("the process has ended"), "{said}");
}

#[test]
fn what_is_left_is_handled_as_of_its_time_before_an_actor_that_runs_after_it() {
    let said = Rc::new(RefCell::new(Vec::new()));
    let build = |clock: &Clock| {
        let (first, second) = (Mailbox::new("first"), Mailbox::new("second"));
        second.runs_after(&first);
        let (to, noted) = (second.clone(), Rc::clone(&said));
        let make = |alarms: &'static [u64]| move |incarnation| Noting { incarnation, alarms: alarms.to_vec() };
        // What the first actor puts out for what was left for it is left for the second.
        start(clock, &first, tracing::Span::none(), make(&[]), move |Note(_, ms, number)| to.send(1000 * ms + number));
        start(clock, &second, tracing::Span::none(), make(&[20]), move |note| noted.borrow_mut().push(note));
        for (ms, number) in [(3, 1), (7, 2), (30, 3)] {
            let first = first.clone();
            clock.call(at(ms), Box::new(move || first.leave(number)));
        }
        let woken = first.clone();
        clock.call(at(40), Box::new(move || woken.send(4)));
        (first, second)
    };
    run_virtual(build, |_, _| false);
    // The alarm makes the second actor take the first two; that of the first actor at 40 ms makes it take the third,
    // which it leaves for the second as of 30 ms.
    let expected = [Note(1, 3, 3001), Note(1, 7, 7002), Note(1, 20, 0), Note(1, 30, 30_003), Note(1, 40, 40_004)];
    assert_eq!(&said.borrow()[..], &expected[..]);
}
