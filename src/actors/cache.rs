//! Cache: stores what one robot knows: its own estimate, and the newest latent of each neighbour within range.
//!
//! An arriving message only updates the Cache. At each tick of the robot's control period it sends a `Percept` to the
//! Agent. Ages count from arrival, on this host's clock. Where a tracker measures the neighbours for the Cache, its
//! witness holds what they say of their own motion against that.

use std::collections::BTreeMap;

use super::perceived::Perceived;
use super::witness::{Finding, Witness};
use crate::actor::Core;
use crate::estimation::{self, Estimator};
use crate::hearing::{CommRange, Handling, MAX_NEIGHBOURS};
use crate::messages::ids::RobotId;
use crate::messages::local::{NeighbourLatent, Percept};
use crate::messages::wire::{Latent, Reading, Sensed};
use crate::random::Stream;
use crate::time::{Span, Time};

/// Input message of a Cache, the actor that stores one robot's readings and its neighbours' messages.
#[derive(Clone, Debug)]
pub enum In {
    /// Reading (measured pose and velocity) of the Cache's own robot.
    Reading(Reading),
    /// Latent (policy message) of another robot.
    Latent(Latent),
    /// Reading of another robot, by a host other than that of its Agent.
    Measured(Reading),
    /// Values of a sense of the Cache's own robot.
    Sensed(Sensed),
}

/// Configuration of a Cache, the actor that stores one robot's readings and its neighbours' messages.
#[derive(Clone, Copy, Debug)]
pub struct Config {
    /// Robot whose readings and neighbours' messages the Cache stores.
    pub robot: RobotId,
    /// Control period of the robot: time between two of its control ticks.
    pub period: Span,
    /// Time of the control tick within each period, at which the Cache sends a percept.
    pub phase: Span,
    /// Communication range: largest distance between sender and receiver at which a latent is accepted; fixed, or drawn
    /// at random for each latent.
    pub range: CommRange,
    /// Hold time: largest age at which a latent is used.
    pub hold: Span,
    /// Whether a latent is used in every control step within the hold time, or only once.
    pub handling: Handling,
    /// Estimator that computes the robot's state from its readings.
    pub estimator: estimation::Entry,
    /// Known delay from a measurement to the arrival of its reading, for which the estimator can compensate.
    pub sensor_delay: Span,
    /// Largest age of the robot's newest reading. If it is older, the Cache sends no percept, so that the robot stops.
    pub own_age: Span,
    /// Largest speed of the robots along each axis \[m/s\], by which readings of other robots are held against what
    /// these say of themselves.
    pub limit_m_s: f32,
    /// Number of senses of the robot.
    pub senses: usize,
}

/// Output message of a Cache, the actor that stores one robot's readings and its neighbours' messages.
#[derive(Clone, Debug, PartialEq)]
pub enum Out {
    /// Percept (inputs of the policy at a control tick) for the robot's Agent.
    Percept(Percept),
    /// Notice to the robot's Controller that a new reading of the robot has arrived.
    Fresh,
    /// Another robot whose latents contradict its readings, or no longer do, for the robot's Controller and the host's
    /// Status.
    Found(RobotId, Finding),
}

/// Cache of one robot: an actor that holds the robot's estimator and the newest latent of each neighbour, and sends
/// percepts to the robot's Agent.
#[derive(Debug)]
pub struct Cache {
    config: Config,
    stream: Stream,
    next: Time,
    /// Arrival time and measurement stamp \[ns\] of the robot's newest reading; `None` before the first.
    own: Option<(Time, u64)>,
    /// Heading \[rad\] and yaw rate \[rad/s\] of the robot's newest reading, as far as it has them.
    turning: (Option<f32>, Option<f32>),
    estimator: Box<dyn Estimator>,
    latents: BTreeMap<RobotId, (Time, Latent)>,
    witness: Witness,
    /// Newest values of each sense.
    sensed: Vec<Perceived>,
}

impl Cache {
    /// Creates an empty Cache. `stream` is the random stream from which the communication range of each latent is
    /// drawn.
    pub fn new(config: Config, stream: Stream) -> Cache {
        let settings = estimation::Settings { delay: config.sensor_delay };
        let (next, estimator) = (Time::ZERO + config.phase, (config.estimator.make)(&settings));
        let witness = Witness::new(config.limit_m_s);
        let (latents, sensed) = (BTreeMap::new(), (0..config.senses).map(|_| Perceived::default()).collect());
        Cache { config, stream, next, own: None, turning: (None, None), estimator, latents, witness, sensed }
    }

    fn perceive(&self, now: Time) -> Option<Percept> {
        let (arrived, _) = self.own?;
        if now.since(arrived) > self.config.own_age {
            return None;
        }
        let estimate = self.estimator.at(now)?;
        let heard = self.latents.values().map(|(arrived, latent)| NeighbourLatent {
            robot: latent.robot,
            round: latent.round,
            phase: latent.phase,
            motion: self.witness.believed(now, latent.robot, (*arrived, latent.motion)),
            features: latent.features.clone(),
            age: now.since(*arrived),
        });
        let robot = self.config.robot;
        let deviation_m = self.estimator.deviation_m(now);
        let measured = self.witness.obstacles(now);
        let (due, heard, (heading, yaw_rate)) = (self.next, heard.collect(), self.turning);
        let sensed = self.sensed.iter().map(|sense| sense.at(now)).collect();
        Some(Percept { robot, due, estimate, deviation_m, heading, yaw_rate, heard, measured, sensed })
    }

    fn hear(&mut self, now: Time, latent: Latent, out: &mut Vec<Out>) {
        let robot = latent.robot;
        if robot == self.config.robot {
            return;
        }
        if let Some((found, distance_m)) = self.witness.heard(now, robot, latent.motion) {
            report(robot, found, distance_m);
            out.push(Out::Found(robot, found));
        }
        let Some(own) = self.estimator.at(now) else { return };
        let motion = self.witness.believed(now, robot, (now, latent.motion));
        let near = self.config.range.admits(own.position, motion.position, &mut self.stream);
        let room = self.latents.len() < MAX_NEIGHBOURS || self.latents.contains_key(&robot);
        if near && room {
            self.latents.insert(robot, (now, latent));
        }
    }
}

/// Logs a change of what is thought of a robot that says it is `distance_m` \[m\] from where it is measured.
fn report(robot: RobotId, found: Finding, distance_m: f32) {
    match found {
        Finding::Suspect => tracing::error!(
            "{robot} says that it is {distance_m:.2} m from where it is measured; where it is measured counts: check \
             {robot}, its host and its key"
        ),
        Finding::Cleared => tracing::warn!("{robot} is again where it says it is"),
    }
}

impl Core for Cache {
    type In = In;
    type Out = Out;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        match input {
            In::Reading(reading) => {
                self.estimator.take(now, &reading);
                self.turning = (reading.pose.heading, reading.twist.yaw_rate);
                // A repeated stamp is the same measurement and does not make the state newer. (A robot that is placed
                // is measured twice at one instant, at two places.)
                if self.own.is_none_or(|(_, stamp_ns)| stamp_ns != reading.stamp_ns) {
                    self.own = Some((now, reading.stamp_ns));
                    out.push(Out::Fresh);
                }
            }
            In::Latent(latent) => self.hear(now, latent, out),
            In::Measured(reading) => self.witness.measured(now, &reading),
            In::Sensed(sensed) => {
                if let Some(sense) = self.sensed.get_mut(usize::from(sensed.sense)) {
                    sense.take(now, sensed);
                }
            }
        }
    }

    fn wake_at(&self) -> Option<Time> {
        Some(self.next)
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        let Config { hold, handling, .. } = self.config;
        self.latents.retain(|_, (arrived, _)| now.since(*arrived) <= hold);
        if let Some(percept) = self.perceive(now) {
            out.push(Out::Percept(percept));
            // Without a percept the agent does not step, so the messages are still unused.
            if handling == Handling::AsPublished {
                self.latents.clear();
            }
        }
        self.next = now.next_on_grid(self.config.phase, self.config.period);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::messages::geometry::{Motion, Vec2};
    use crate::messages::local::Sensation;
    use crate::messages::wire::{Features, Phase, Round};
    use crate::random::Seed;

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    fn cache() -> Cache {
        handling(Handling::Hold)
    }

    fn handling(handling: Handling) -> Cache {
        let config = Config {
            robot: RobotId(0),
            period: Span::from_millis(50),
            phase: Span::ZERO,
            range: CommRange::fixed(2.0),
            hold: Span::from_millis(80),
            handling,
            estimator: estimation::REGISTRY[0],
            sensor_delay: Span::ZERO,
            own_age: Span::from_millis(100),
            limit_m_s: 1.5,
            senses: 1,
        };
        Cache::new(config, Seed::of_run(0).stream("cache"))
    }

    fn reading(stamp_ns: u64) -> In {
        In::Reading(Reading::of_point(RobotId(0), stamp_ns, Motion::default()))
    }

    fn latent(robot: u16, x: f32) -> In {
        In::Latent(Latent {
            robot: RobotId(robot),
            round: Round::default(),
            phase: Phase::Running,
            motion: Motion::at_rest(Vec2::new(x, 0.0)),
            features: Features(Arc::new([1.0])),
            part: None,
        })
    }

    fn tick(cache: &mut Cache, ms: u64) -> Option<Percept> {
        let mut out = Vec::new();
        cache.wake(at_ms(ms), &mut out);
        match out.pop() {
            Some(Out::Percept(percept)) => Some(percept),
            _ => None,
        }
    }

    #[test]
    fn a_neighbour_is_held_for_the_window_if_it_is_in_range() {
        let mut cache = cache();
        cache.handle(at_ms(0), reading(1), &mut Vec::new());
        cache.handle(at_ms(0), latent(2, 1.9), &mut Vec::new());
        cache.handle(at_ms(0), latent(1, 1.0), &mut Vec::new());
        cache.handle(at_ms(0), latent(3, 2.1), &mut Vec::new());
        let heard: Vec<u16> = tick(&mut cache, 50).unwrap().heard.iter().map(|heard| heard.robot.0).collect();
        assert_eq!(heard, [1, 2], "in the order of ids, without the one out of range");
        cache.handle(at_ms(60), reading(2), &mut Vec::new());
        assert!(tick(&mut cache, 100).unwrap().heard.is_empty(), "80 ms have passed");
    }

    #[test]
    fn as_published_a_message_is_seen_in_one_step_and_never_after_its_window() {
        let mut cache = handling(Handling::AsPublished);
        let heard = |percept: Option<Percept>| percept.expect("it knows where it is").heard.len();
        cache.handle(at_ms(0), reading(1), &mut Vec::new());
        cache.handle(at_ms(0), latent(1, 1.0), &mut Vec::new());
        cache.handle(at_ms(10), latent(1, 1.0), &mut Vec::new());
        assert_eq!(heard(tick(&mut cache, 50)), 1, "the newest of each neighbour");
        cache.handle(at_ms(60), reading(2), &mut Vec::new());
        assert_eq!(heard(tick(&mut cache, 70)), 0, "it was seen");
        cache.handle(at_ms(130), latent(1, 1.0), &mut Vec::new());
        assert_eq!(tick(&mut cache, 180), None, "no step, because the robot does not know where it is");
        cache.handle(at_ms(190), reading(3), &mut Vec::new());
        assert_eq!(heard(tick(&mut cache, 200)), 1, "nothing has seen it");
        cache.handle(at_ms(210), latent(1, 1.0), &mut Vec::new());
        cache.handle(at_ms(290), reading(4), &mut Vec::new());
        assert_eq!(heard(tick(&mut cache, 300)), 0, "80 ms have passed");
    }

    #[test]
    fn values_of_the_robots_senses_are_perceived_and_those_of_no_sense_are_not() {
        let mut cache = cache();
        cache.handle(at_ms(0), reading(1), &mut Vec::new());
        assert_eq!(tick(&mut cache, 0).expect("it knows where it is").sensed, [None]);
        for sense in [0, 1] {
            let sensed = Sensed::split(RobotId(0), sense, 7, &[3.0]).expect("it can be sent").remove(0);
            cache.handle(at_ms(20), In::Sensed(sensed), &mut Vec::new());
        }
        let expected = Some(Sensation { values: Features([3.0].into()), age: Span::from_millis(30) });
        assert_eq!(tick(&mut cache, 50).expect("it knows where it is").sensed, [expected]);
    }

    #[test]
    fn a_stale_or_repeated_own_reading_silences_the_robot() {
        let mut cache = cache();
        assert_eq!(tick(&mut cache, 0), None, "nothing is known yet");
        let mut out = Vec::new();
        cache.handle(at_ms(0), reading(1), &mut out);
        let moved = Motion { velocity: Vec2::new(1.0, 0.0), ..Motion::default() };
        for (ms, motion) in [(80, Motion::default()), (90, moved)] {
            let again = In::Reading(Reading::of_point(RobotId(0), 1, motion));
            cache.handle(at_ms(ms), again, &mut out);
        }
        assert_eq!(out, [Out::Fresh], "a stamp is news once, whatever else the reading says");
        assert!(tick(&mut cache, 100).is_some());
        assert_eq!(tick(&mut cache, 150), None);
    }
}
