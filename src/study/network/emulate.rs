//! One case of a network study, emulated: stations, their medium, and the control steps that look at what has come.

use super::case::{Addressing, Assurance, Case, Sweep};
use super::endpoint::{DRAIN, Endpoint, STEP, Said, WARM};
use super::linked::{self, Linked};
use super::medium::Air;
use super::outcome::{Outcome, Tally};
use super::rtps::Rtps;
use super::talk::{self, Schedule};
use crate::net::media::radio::Destination;
use crate::random::Seed;
use crate::time::{Span, Time};

/// The seed of a case. Cases of one rate share their schedules: what differs between them is not when stations speak.
pub fn seed(seed: u64, case: &Case) -> Seed {
    Seed::of_run(seed).child(&format!("network/{}", case.rate))
}

/// Runs a case. `goes_on` is asked now and then; `None` once it says no.
pub fn run(sweep: &Sweep, case: &Case, goes_on: &dyn Fn() -> bool) -> Option<Outcome> {
    let seed = seed(sweep.seed, case);
    match case.reliability {
        Assurance::Ack | Assurance::AckOff => {
            let end = |at| Rtps::new(at, sweep.stations, sweep.bytes, case.reliability, sweep.history);
            Emulation::new(sweep, case, &seed, end).run(goes_on)
        }
        reliability => {
            let setup = linked::setup(case.addressing, reliability);
            let end = |at| Linked::new(at, setup.clone(), sweep.features(), &seed);
            Emulation::new(sweep, case, &seed, end).run(goes_on)
        }
    }
}

struct Emulation<E: Endpoint> {
    addressing: Addressing,
    stations: u16,
    air: Air<E::Packet>,
    ends: Vec<E>,
    schedules: Vec<Schedule>,
    /// When each station looks at what it has.
    steps: Vec<Time>,
    everyone: Destination,
    tally: Tally,
    over: Time,
}

/// What is due next.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Due {
    Air,
    Wake(u16),
    Publish(u16),
    Step(u16),
}

impl<E: Endpoint> Emulation<E> {
    fn new(sweep: &Sweep, case: &Case, seed: &Seed, end: impl Fn(u16) -> E) -> Emulation<E> {
        let n = sweep.stations;
        let window = (Time::ZERO + WARM, Time::ZERO + WARM + Span::from_secs(sweep.seconds));
        Emulation {
            addressing: case.addressing,
            stations: n,
            air: Air::new(sweep.medium_of(case), n, &seed.child("medium")),
            ends: (0..n).map(end).collect(),
            schedules: (0..n).map(|at| Schedule::new(Time::ZERO, at, (n, case.rate), seed)).collect(),
            steps: talk::phases(n, STEP, seed).into_iter().map(|phase| window.0 + phase).collect(),
            everyone: Destination::Many((0..n).collect()),
            tally: Tally::new(n, window),
            over: window.1 + DRAIN,
        }
    }

    fn run(mut self, goes_on: &dyn Fn() -> bool) -> Option<Outcome> {
        let (mut said, mut deliveries) = (Vec::new(), Vec::new());
        let (_, end) = self.tally.window();
        for turn in 0u64.. {
            if turn.is_multiple_of(4096) && !goes_on() {
                return None;
            }
            let (now, due) = self.next();
            self.tally.sees_airtime(now, || self.air.taken_s(now));
            if now > self.over {
                break;
            }
            match due {
                Due::Air => {
                    self.air.wake(now, &mut deliveries);
                    for delivery in deliveries.drain(..) {
                        self.ends[usize::from(delivery.to)].receive(delivery.at, &delivery.token, &mut said);
                        Self::act(
                            &mut self.air,
                            &mut self.tally,
                            (delivery.at, delivery.to),
                            (&self.everyone, self.addressing),
                            &mut said,
                        );
                    }
                    continue;
                }
                Due::Wake(at) => self.ends[usize::from(at)].wake(now, &mut said),
                Due::Publish(at) => {
                    let sequence = self.schedules[usize::from(at)].say();
                    self.tally.published(now, at, sequence);
                    self.ends[usize::from(at)].publish(now, sequence, &mut said);
                }
                Due::Step(at) => {
                    self.tally.step(now, at);
                    let next = now + STEP;
                    self.steps[usize::from(at)] = if next < end { next } else { Time::MAX };
                }
            }
            if let Due::Wake(at) | Due::Publish(at) = due {
                Self::act(&mut self.air, &mut self.tally, (now, at), (&self.everyone, self.addressing), &mut said);
            }
        }
        Some(self.tally.outcome())
    }

    /// The next event; of several at one instant always the same one first.
    fn next(&self) -> (Time, Due) {
        let wakes = (0..self.stations).zip(&self.ends).filter_map(|(at, end)| Some((end.wake_at()?, Due::Wake(at))));
        let speaks = (0..self.stations).zip(&self.schedules).map(|(at, schedule)| (schedule.next(), Due::Publish(at)));
        let steps = (0..self.stations).zip(&self.steps).map(|(at, step)| (*step, Due::Step(at)));
        let air = self.air.wake_at().map(|at| (at, Due::Air));
        wakes.chain(speaks).chain(steps).chain(air).min().expect("stations go on speaking")
    }

    /// Does what a station says.
    fn act(
        air: &mut Air<E::Packet>,
        tally: &mut Tally,
        (now, station): (Time, u16),
        (everyone, addressing): (&Destination, Addressing),
        said: &mut Vec<Said<E::Packet>>,
    ) {
        for said in said.drain(..) {
            match said {
                Said::Hear { from, sequence } => tally.heard(now, station, from, sequence),
                Said::Send { to: Some(to), bytes, packet } => {
                    tally.sent(now, 1, bytes);
                    air.offer(now, station, Destination::One(to), bytes, packet);
                }
                Said::Send { to: None, bytes, packet } => match (addressing, everyone) {
                    (Addressing::Unicast, Destination::Many(all)) => {
                        for &to in all.iter().filter(|to| **to != station) {
                            tally.sent(now, 1, bytes);
                            air.offer(now, station, Destination::One(to), bytes, packet.clone());
                        }
                    }
                    (_, everyone) => {
                        tally.sent(now, 1, bytes);
                        air.offer(now, station, everyone.clone(), bytes, packet);
                    }
                },
            }
        }
    }
}
