//! Emulation of one case of a network study: stations, their medium, and control steps that use received messages.

use super::case::{Addressing, Case, ReliabilityMode, Sweep};
use super::endpoint::{DRAIN, Output, STEP, StationProtocol, WARM_UP};
use super::linked::{self, Linked};
use super::medium::MediumEmulator;
use super::outcome::{Outcome, Tally};
use super::rtps::{self, Rtps};
use super::traffic::{self, HARNESS_WARM_UP, Moments, Schedule};
use murmurate::net::media::radio::Destination;
use murmurate::random::Seed;
use murmurate::time::{Span, Time};

/// Returns the seed of a case's random numbers, derived from the study's seed `seed`. Cases of equal message rate have
/// equal seeds, and thus the same publication times.
pub fn seed(seed: u64, case: &Case) -> Seed {
    Seed::of_run(seed).child(&format!("network/{}", case.rate))
}

/// Times of a case, and the moments at which its stations publish.
#[derive(Clone, Copy, Debug)]
pub struct Timing {
    /// Moments of a station's publications within its periods.
    pub moments: Moments,
    /// Time before the measurement in which messages are published and not counted.
    pub warm_up: Span,
    /// Time after the measurement in which late messages may still arrive; messages are published in it, too, unless
    /// `stops` says otherwise.
    pub drain: Span,
    /// Whether publication stops at the end of the measurement.
    pub stops: bool,
}

impl Timing {
    /// Times of a network study's case.
    pub const STUDY: Timing = Timing { moments: Moments::Random, warm_up: WARM_UP, drain: DRAIN, stops: false };
    /// Times of the harness for real middleware (`netpeer/lab.py`): messages by which participants
    /// find each other, then evenly spaced ones to the end of the measurement, and a drain of 1 s.
    pub const HARNESS: Timing =
        Timing { moments: Moments::Harness, warm_up: HARNESS_WARM_UP, drain: Span::from_millis(1000), stops: true };
}

/// Time between the starts of two participants of the harness, as its announcements show it.
const STARTS: Span = Span::from_millis(3);

/// Emulates `case` of the network study `sweep` and returns its outcome. Calls `proceed` every 4096 events; returns
/// `None` as soon as `proceed` returns `false`.
pub fn run(sweep: &Sweep, case: &Case, proceed: &dyn Fn() -> bool) -> Option<Outcome> {
    match case.reliability {
        ReliabilityMode::Ack | ReliabilityMode::AckOff => run_rtps(sweep, case, &Timing::STUDY, proceed),
        reliability => {
            let seed = seed(sweep.seed, case);
            let setup = linked::setup(case.addressing, reliability);
            let end = |at| Linked::new(at, setup.clone(), sweep.features(), &seed);
            Emulation::new(sweep, case, (&seed, &Timing::STUDY), end).run(proceed)
        }
    }
}

/// Emulates `case` with stations that use RTPS, at the times `timing`. In contrast to `run`, reliability mode
/// `best-effort` is that of RTPS, too.
pub fn run_rtps(sweep: &Sweep, case: &Case, timing: &Timing, proceed: &dyn Fn() -> bool) -> Option<Outcome> {
    let seed = seed(sweep.seed, case);
    let qos = (case.reliability, sweep.history);
    let announcements: Vec<Span> = match timing.moments {
        Moments::Random => traffic::phases(sweep.stations, rtps::ANNOUNCEMENT_PERIOD, &seed.child("announcements")),
        // Processes that are started together announce themselves one after the other.
        Moments::Harness => (0..u64::from(sweep.stations)).map(|at| STARTS * at).collect(),
    };
    let end = |at: u16| {
        let announcement = Time::ZERO + announcements[usize::from(at)];
        Rtps::new((at, sweep.stations), sweep.bytes, case.addressing, qos, announcement)
    };
    Emulation::new(sweep, case, (&seed, timing), end).run(proceed)
}

struct Emulation<E: StationProtocol> {
    addressing: Addressing,
    stations: u16,
    medium: MediumEmulator<E::Packet>,
    endpoints: Vec<E>,
    schedules: Vec<Schedule>,
    /// Time of each station's next control step, by the index of the station.
    steps: Vec<Time>,
    everyone: Destination,
    tally: Tally,
    /// Time from which no message is published.
    last: Time,
    end: Time,
}

/// Kind of the next event of the emulation; the order of the variants decides which of simultaneous events is
/// first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Due {
    Medium,
    Wake(u16),
    Publish(u16),
    Step(u16),
}

impl<E: StationProtocol> Emulation<E> {
    fn new(sweep: &Sweep, case: &Case, (seed, timing): (&Seed, &Timing), end: impl Fn(u16) -> E) -> Emulation<E> {
        let n = sweep.stations;
        let begin = Time::ZERO + timing.warm_up;
        let window = (begin, begin + Span::from_secs(sweep.seconds));
        let schedule = |at| Schedule::new(Time::ZERO, at, (n, case.rate), (seed, timing.moments));
        let mut medium = MediumEmulator::new(sweep.medium_of(case), n, &seed.child("medium"));
        let mut tally = Tally::new(n, window);
        if let Some(places) = &sweep.places {
            medium.place(&places.of(n));
            let reached: Vec<_> = (0..n).map(|from| medium.reached(from)).collect();
            tally.count_only(|station, from| {
                reached[usize::from(from)].iter().any(|to| to.reads && to.station == station)
            });
        }
        Emulation {
            addressing: case.addressing,
            stations: n,
            medium,
            endpoints: (0..n).map(end).collect(),
            schedules: (0..n).map(schedule).collect(),
            steps: traffic::phases(n, STEP, seed).into_iter().map(|phase| window.0 + phase).collect(),
            everyone: Destination::Many((0..n).collect()),
            tally,
            last: if timing.stops { window.1 } else { Time::MAX },
            end: window.1 + timing.drain,
        }
    }

    fn run(mut self, proceed: &dyn Fn() -> bool) -> Option<Outcome> {
        let (mut outputs, mut deliveries) = (Vec::new(), Vec::new());
        let (_, end) = self.tally.window();
        for turn in 0u64.. {
            if turn.is_multiple_of(4096) && !proceed() {
                return None;
            }
            let (now, due) = self.next();
            self.tally.sample_airtime(now, || self.medium.busy_s(now));
            if now > self.end {
                break;
            }
            match due {
                Due::Medium => {
                    self.medium.wake(now, &mut deliveries);
                    for delivery in deliveries.drain(..) {
                        self.endpoints[usize::from(delivery.to)].receive(delivery.at, &delivery.token, &mut outputs);
                        Self::act(
                            &mut self.medium,
                            &mut self.tally,
                            (delivery.at, delivery.to),
                            (&self.everyone, self.addressing),
                            &mut outputs,
                        );
                    }
                    continue;
                }
                Due::Wake(at) => self.endpoints[usize::from(at)].wake(now, &mut outputs),
                Due::Publish(at) => {
                    let sequence = self.schedules[usize::from(at)].publish();
                    self.tally.published(now, at, sequence);
                    self.endpoints[usize::from(at)].publish(now, sequence, &mut outputs);
                }
                Due::Step(at) => {
                    self.tally.step(now, at);
                    let next = now + STEP;
                    self.steps[usize::from(at)] = if next < end { next } else { Time::MAX };
                }
            }
            if let Due::Wake(at) | Due::Publish(at) = due {
                Self::act(
                    &mut self.medium,
                    &mut self.tally,
                    (now, at),
                    (&self.everyone, self.addressing),
                    &mut outputs,
                );
            }
        }
        Some(self.tally.outcome())
    }

    /// Returns the time and the kind of the next event of the emulation.
    fn next(&self) -> (Time, Due) {
        let wakes =
            (0..self.stations).zip(&self.endpoints).filter_map(|(at, end)| Some((end.wake_at()?, Due::Wake(at))));
        let publications = (0..self.stations)
            .zip(&self.schedules)
            .map(|(at, schedule)| (schedule.next(), Due::Publish(at)))
            .filter(|(at, _)| *at < self.last);
        let steps = (0..self.stations).zip(&self.steps).map(|(at, step)| (*step, Due::Step(at)));
        let medium = self.medium.wake_at().map(|at| (at, Due::Medium));
        wakes.chain(publications).chain(steps).chain(medium).min().unwrap_or((Time::MAX, Due::Medium))
    }

    /// Executes the outputs of a station's protocol: counts delivered messages, and queues datagrams on the medium.
    fn act(
        medium: &mut MediumEmulator<E::Packet>,
        tally: &mut Tally,
        (now, station): (Time, u16),
        (everyone, addressing): (&Destination, Addressing),
        outputs: &mut Vec<Output<E::Packet>>,
    ) {
        for output in outputs.drain(..) {
            match output {
                Output::Deliver { from, sequence } => tally.received(now, station, from, sequence),
                Output::Send { to: Some(to), bytes, packet } => {
                    tally.sent(now, 1, bytes);
                    medium.offer(now, station, Destination::One(to), bytes, packet);
                }
                Output::Multicast { bytes, packet } => {
                    tally.sent(now, 1, bytes);
                    medium.offer(now, station, everyone.clone(), bytes, packet);
                }
                Output::Send { to: None, bytes, packet } => match (addressing, everyone) {
                    (Addressing::Unicast, Destination::Many(all)) => {
                        for &to in all.iter().filter(|to| **to != station) {
                            tally.sent(now, 1, bytes);
                            medium.offer(now, station, Destination::One(to), bytes, packet.clone());
                        }
                    }
                    (_, everyone) => {
                        tally.sent(now, 1, bytes);
                        medium.offer(now, station, everyone.clone(), bytes, packet);
                    }
                },
            }
        }
    }
}
