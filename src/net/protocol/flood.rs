//! Emergency stops on a mesh: each host says on what it has heard, so that a stop crosses hops. Pure.
//!
//! A host says a stop on in its own name. A stop that engages is believed of any member, so it needs no proof of where
//! it began, and none who says it on can say more than it could by itself. What ends a stop is not said on. A stop
//! whose number is behind what a host knows is said on with the next one, as its actors count it.

use std::collections::{BTreeSet, VecDeque};

use super::bucket::{Bucket, Rate};
use crate::messages::ids::HostId;
use crate::messages::latch::Latch;
use crate::random::{RngExt, Stream};
use crate::time::{Span, Time};

/// Largest random addition to each wait, so that hosts that have heard a stop at one instant do not say it on at one.
const SPREAD: Span = Span::from_millis(4);
/// Number of times that a host says a stop on, whoever else does.
const TIMES: usize = 3;
/// Wait between these, and as long as a neighbour has not said the stop.
const PERIOD: Span = Span::from_millis(10);
/// Time from the first hearing after which a neighbour that has not said the stop is waited for less often.
const SOON: Span = Span::from_millis(100);
/// Wait from then on: the period of states.
const LATER: Span = Span::from_millis(50);
/// Time from its own first hearing after which a host says a stop on no more. A stop that is heard after its re-arm
/// engages anew, so in this time, and in as much for each hop that took long, a re-arm may be overtaken.
const LASTS: Span = Span::from_millis(1_000);
/// Time for which a stop is known, and not said on anew. When it is over hardly a host of the team says the stop on any
/// more, and who repeats it then means it.
const KNOWN: Span = Span::from_millis(3_000);
/// Time since its last datagram for which another host counts as a neighbour.
pub(crate) const NEIGHBOUR: Span = Span::from_millis(1_000);
/// Limit of the stops that are said on: any member can make them, and each keeps the team standing as well as the next.
const RATE: Rate = Rate { per_s: 4.0, burst: 8.0 };

/// Emergency stops that a host says on.
#[derive(Clone, Debug)]
pub(crate) struct Flood {
    /// Latest latch that is known.
    latest: Latch,
    newest: Option<Said>,
    /// Stops that were heard, each with the time of the first hearing.
    known: VecDeque<(Time, Latch)>,
    left: Bucket,
}

/// Stop that is said on now.
#[derive(Clone, Debug)]
struct Said {
    latch: Latch,
    since: Time,
    due: Time,
    times: usize,
    /// Hosts that have said it.
    by: BTreeSet<HostId>,
}

impl Flood {
    /// Returns the state of a host that has heard no stop.
    pub fn new() -> Flood {
        let left = Bucket::full(Time::ZERO, &RATE);
        Flood { latest: Latch::default(), newest: None, known: VecDeque::new(), left }
    }

    /// Handles that the host `from` says a stop, with this latch. Random waits are drawn from `stream`.
    pub fn hear(&mut self, now: Time, from: HostId, latch: Latch, stream: &mut Stream) {
        self.latest = self.latest.after(latch, false);
        if let Some(said) = self.newest.as_mut().filter(|said| latch <= said.latch) {
            // Who says an earlier stop stands as well.
            said.by.insert(from);
            return;
        }
        while self.known.front().is_some_and(|(since, _)| now.since(*since) >= KNOWN) {
            self.known.pop_front();
        }
        let is_known = self.known.iter().any(|(_, known)| *known == latch);
        if !is_known && self.left.take(now, &RATE) {
            // As it was heard, and as it is said on.
            self.known.extend([(now, latch), (now, self.latest)]);
            let (due, by) = (now + spread(stream), BTreeSet::from([from]));
            self.newest = Some(Said { latch: self.latest, since: now, due, times: 0, by });
        }
    }

    /// Handles that one who may end a stop says this latch, which does not engage.
    pub fn end(&mut self, latch: Latch) {
        self.latest = self.latest.joined(latch);
        if !self.latest.is_engaged() {
            self.newest = None;
        }
    }

    /// Returns the time at which `next` has to be called; `None` if nothing is said on.
    pub fn due(&self) -> Option<Time> {
        self.newest.as_ref().map(|said| said.due)
    }

    /// Returns the stop that is to be said on at `now`. `neighbours` are the hosts that are heard now.
    pub fn next(
        &mut self,
        now: Time,
        mut neighbours: impl Iterator<Item = HostId>,
        stream: &mut Stream,
    ) -> Option<Latch> {
        let said = self.newest.as_mut().filter(|said| said.due <= now)?;
        let age = now.since(said.since);
        if age > LASTS {
            self.newest = None;
            return None;
        }
        let is_due = said.times < TIMES || neighbours.any(|host| !said.by.contains(&host));
        said.times += usize::from(is_due);
        said.due = now + if age < SOON { PERIOD } else { LATER } + spread(stream);
        is_due.then_some(said.latch)
    }
}

fn spread(stream: &mut Stream) -> Span {
    Span::from_nanos(stream.random_range(0..SPREAD.as_nanos()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Seed;

    /// Host with neighbours 1 and 2, and the times in milliseconds at which it says something.
    struct Host(Flood, Stream, Vec<u64>);

    impl Host {
        fn new() -> Host {
            Host(Flood::new(), Seed::of_run(1).stream("flood"), Vec::new())
        }

        fn hear(&mut self, ms: u64, from: u16, latch: Latch) {
            self.0.hear(at_ms(ms), HostId(from), latch, &mut self.1);
        }

        fn run_to(&mut self, ms: u64) {
            while let Some(due) = self.0.due().filter(|due| *due <= at_ms(ms)) {
                if self.0.next(due, [1, 2].map(HostId).into_iter(), &mut self.1).is_some() {
                    self.2.push(due.since(Time::ZERO).as_nanos() / 1_000_000);
                }
            }
        }
    }

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    #[test]
    fn a_stop_is_said_on_at_once_and_until_all_neighbours_have_said_it() {
        let mut host = Host::new();
        host.hear(0, 1, Latch::engaged(1));
        host.run_to(60);
        assert!((4..7).contains(&host.2.len()) && host.2[0] < 4, "{:?}", host.2);
        host.hear(60, 2, Latch::engaged(1));
        let before = host.2.len();
        host.run_to(5000);
        assert_eq!((host.2.len(), host.0.due()), (before, None));
    }

    #[test]
    fn a_neighbour_that_says_nothing_is_told_for_a_second() {
        let mut host = Host::new();
        host.hear(0, 1, Latch::engaged(1));
        host.run_to(5000);
        assert!((20..40).contains(&host.2.len()), "{:?}", host.2);
        assert!(*host.2.last().expect("it has spoken") <= 1000);
    }

    #[test]
    fn a_stop_is_said_on_once_in_three_seconds_and_what_ends_it_ends_that() {
        let mut host = Host::new();
        host.hear(0, 1, Latch::engaged(1));
        host.run_to(5);
        host.0.end(Latch::held(2));
        host.hear(7, 1, Latch::engaged(1));
        host.run_to(2000);
        assert_eq!(host.2.len(), 1, "a re-arm has ended it, and it is known");
        host.hear(3100, 7, Latch::engaged(1));
        host.run_to(3105);
        assert_eq!(host.2.len(), 2, "who says it now means it");
        host.0.end(Latch::held(1));
        assert!(host.0.due().is_some(), "an earlier hold ends nothing");
    }

    #[test]
    fn a_stop_with_a_number_that_is_behind_is_said_on_with_the_next_one() {
        let mut host = Host::new();
        host.0.end(Latch::held(5));
        host.hear(0, 1, Latch::engaged(3));
        host.0.end(Latch::held(5));
        let said = host.0.next(at_ms(10), [1].map(HostId).into_iter(), &mut host.1);
        assert_eq!(said, Some(Latch::engaged(6)), "the hold that was there before does not end it");
        host.hear(11, 2, Latch::engaged(8));
        let newest = host.0.newest.as_ref().expect("it says one on");
        assert_eq!((newest.latch, newest.times), (Latch::engaged(8), 0), "a later one is said on from the beginning");
        host.0.end(Latch::held(9));
        host.hear(12, 2, Latch::engaged(6));
        assert!(host.0.due().is_none(), "what neighbours say after it is known");
    }

    #[test]
    fn many_stops_of_one_liar_are_not_all_said_on() {
        let mut host = Host::new();
        (0..1000).for_each(|number| host.hear(number, 1, Latch::engaged(100 + number)));
        assert!(host.0.known.len() <= 24, "{}", host.0.known.len());
    }
}
