//! Messages of a network study's stations and their publication schedule, equal in emulation and measurement.

use rand::RngExt;

use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::{Features, Latent, Phase, Round};
use murmurate::random::{Seed, Stream};
use murmurate::time::{Span, Time};

/// Length of a datagram beyond its message's payload \[bytes\]: header 14, block 3, tag 16, and MessagePack's overhead.
/// UDP, IP and lower layers are not included.
pub const FRAMING_BYTES: usize = 40;

/// Returns the message with the number `sequence` of a station, published `stamp` after the start of a case. `case` is
/// the number of the measurement, 0 in emulation. The message's position holds the time of publication, and its latent
/// has `features` floats.
pub fn message(station: u16, case: u32, sequence: u32, stamp: Span, features: usize) -> Latent {
    let own = 0.5 * f32::from(station + 1);
    let us = stamp.as_nanos() / 1000;
    // Both are integers below 2^24, which a float represents exactly.
    let (ms, us) = ((us / 1000) as f32, (us % 1000) as f32);
    Latent {
        robot: RobotId(station),
        round: Round { term: case, episode: sequence },
        phase: Phase::Running,
        motion: Motion { position: Vec2::new(ms, us), velocity: Vec2::zeros() },
        features: Features((0..features).map(|at| own + at as f32).collect()),
        part: None,
    }
}

/// Returns the time from the start of the case to the message's publication, which the message contains.
pub fn stamp(latent: &Latent) -> Span {
    let position = latent.motion.position;
    Span::from_nanos(1_000_000 * position.x as u64 + 1000 * position.y as u64)
}

/// Returns the offset of each station's control steps within their period `period`, in the order of the stations. They
/// are drawn from `seed`.
pub fn phases(stations: u16, period: Span, seed: &Seed) -> Vec<Span> {
    let mut stream = seed.stream("steps");
    (0..stations).map(|_| Span::from_secs(period.as_secs() * stream.random_range(0.0..1.0))).collect()
}

/// Number of messages of each participant of the harness before the measurement.
const HELLOS: u32 = 10;
/// Period of these messages, for up to five participants.
const HELLO_PERIOD: Span = Span::from_millis(100);
/// Time from the last of these messages to the measurement.
const PAUSE: Span = Span::from_millis(500);
/// Time from the first message of a participant of the harness to the measurement.
pub const HARNESS_WARM_UP: Span = Span::from_millis(1500);

/// Moments of a station's publications within its periods.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moments {
    /// Drawn uniformly in each period. So stations are not synchronized, and no fixed offset dominates a case.
    Random,
    /// The same in each period, evenly spaced among the stations, as in the harness for real middleware
    /// (`netpeer/lab.py`). Before them are 10 messages of each participant, one every 100 ms, by which participants
    /// find each other, and a pause of 0.5 s.
    Harness,
}

/// Publication times of one station: one in every period.
#[derive(Clone, Debug)]
pub struct Schedule {
    begin: Time,
    period: Span,
    /// Random numbers for the moments within the periods, or fixed moments in those of hellos and of messages.
    within: Result<Stream, [Span; 2]>,
    published: u32,
    next: Time,
}

impl Schedule {
    /// Returns the schedule of the station with the index `station`, from `begin` on. `stations` is the number of
    /// stations, and `rate` the message rate of all together \[1/s\]; `moments` says when in its periods it publishes.
    pub fn new(begin: Time, station: u16, (stations, rate): (u16, f64), (seed, moments): (&Seed, Moments)) -> Schedule {
        let period = Span::from_secs(f64::from(stations) / rate);
        let within = match moments {
            Moments::Random => Ok(seed.stream(&format!("publish/{station}"))),
            Moments::Harness => {
                let share = f64::from(station) / f64::from(stations);
                Err([HELLO_PERIOD, period].map(|period| Span::from_secs(period.as_secs() * share)))
            }
        };
        let mut schedule = Schedule { begin, period, within, published: 0, next: begin };
        schedule.draw();
        schedule
    }

    fn draw(&mut self) {
        let published = u64::from(self.published);
        self.next = self.begin
            + match &mut self.within {
                Ok(stream) => {
                    let within = Span::from_secs(self.period.as_secs() * stream.random_range(0.0..1.0));
                    self.period * published + within
                }
                Err([hello, _]) if self.published < HELLOS => HELLO_PERIOD * published + *hello,
                Err([_, message]) => {
                    let hellos = u64::from(HELLOS);
                    HELLO_PERIOD * hellos + PAUSE + self.period * (published - hellos) + *message
                }
            };
    }

    /// Returns the time at which the next message is to be published.
    pub fn next(&self) -> Time {
        self.next
    }

    /// Marks the next message as published and advances to the one after it. Returns the sequence number of the
    /// published one, from 0.
    pub fn publish(&mut self) -> u32 {
        self.published += 1;
        self.draw();
        self.published - 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_station_publishes_once_a_period_and_its_timestamp_survives() {
        let seed = Seed::of_run(1);
        let mut schedule = Schedule::new(Time::ZERO, 3, (5, 100.0), (&seed, Moments::Random));
        for k in 0..50 {
            let (at, low) = (schedule.next(), Time::ZERO + Span::from_millis(50 * k));
            assert!(at >= low && at <= low + Span::from_millis(50), "{k}: {at}");
            assert_eq!(u64::from(schedule.publish()), k);
        }
        let at = Span::from_nanos(61_234_567_000);
        assert_eq!(stamp(&message(1, 0, 7, at, 32)), at);
    }
}
