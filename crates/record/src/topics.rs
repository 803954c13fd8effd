//! Conversion of events to the messages of a record's topics. Equal events give equal messages, so a replay can be
//! compared with its record message by message.

use std::collections::BTreeMap;

use ::foxglove::messages::SceneUpdate;
use prost::Message;
use serde::Serialize;
use serde_json::{Value, json};

pub use super::drawing::Body;
use super::foxglove::{self, Severity};
pub use super::stage::Stage;
use super::tape::{self, SentDigest};
pub use super::topic::{PROGRAM, RECEIPTS, RECEIVED, Topic, WIFI};
use super::truth::{TrueRobot, Truth as TruthMessage};
use super::{Event, Logged, Scope, drawing};
use murmurate::messages::geometry::Vec2;
use murmurate::messages::hardware::{Celsius, Hardware, Health, Reason};
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::local::{Remembered, Truth};
use murmurate::messages::phase::Phase;
use murmurate::messages::round::Round;
use murmurate::messages::wire::{Kind, Mode, Sensed, Wire};
use murmurate::net::protocol::codec::{self, Content, Flags, Header};
use murmurate::net::protocol::sender::Peer;
use murmurate::net::protocol::ways::Ways;
use murmurate::results::episode::Episode;
use murmurate::safety::guard::SafetyCounts;
use murmurate::time::{Span, Time};

/// Shortest time between two drawings of the team.
const DRAWING_PERIOD: Span = Span::from_millis(50);
/// Shortest time between two poses of a robot.
const POSE_PERIOD: Span = Span::from_millis(20);
/// Period with which walls and goals are drawn again, for viewers that start in the middle of a record.
const STANDING_PERIOD: Span = Span::from_millis(5000);

/// Function that takes a message of a record: its topic, its time \[ns\], and its bytes.
pub type Take<'a> = &'a mut dyn FnMut(Topic, u64, &[u8]);

/// Converter of a run's events to the messages of its record.
pub struct Topics {
    stage: Stage,
    scope: Scope,
    /// Wall clock at the run's time zero \[ns\] since 1970; 0 in a simulation.
    anchor_ns: u64,
    sent: SentDigest,
    turn: Vec<u8>,
    /// Number of messages that an operator has received.
    received: u32,
    team: Vec<Option<Body>>,
    /// Whether `team` holds true states and not reported ones.
    true_states: bool,
    /// Whether a robot's pose has changed since the last drawing.
    moved: bool,
    drawn: Option<Time>,
    /// Time at which walls and goals are drawn next.
    standing_due: Time,
    goals: BTreeMap<RobotId, Vec2>,
    followed: Option<(Round, Phase)>,
    /// Time since which an episode runs; `None` between episodes.
    running: Option<Time>,
    guards: BTreeMap<RobotId, SafetyCounts>,
    /// Time of the last pose message of each robot.
    posed: BTreeMap<RobotId, Time>,
}

impl Topics {
    /// Returns the converter for a new record. `stage` has the constant properties of the run, `scope` its kind.
    /// `anchor_ns` is the wall clock at the start of the run \[ns\] since 1970; 0 in a simulation.
    pub fn new(stage: Stage, scope: Scope, anchor_ns: u64) -> Topics {
        Topics {
            team: vec![None; stage.robots],
            stage,
            scope,
            anchor_ns,
            sent: SentDigest::default(),
            turn: Vec::new(),
            received: 0,
            true_states: false,
            moved: false,
            drawn: None,
            standing_due: Time::ZERO,
            goals: BTreeMap::new(),
            followed: None,
            running: None,
            guards: BTreeMap::new(),
            posed: BTreeMap::new(),
        }
    }

    /// Returns the constant properties of the recorded run: ground, walls, hosts and robots.
    pub fn stage(&self) -> &Stage {
        &self.stage
    }

    /// Converts a time of the run to the time \[ns\] that messages have: since 1970, or since the start of a
    /// simulation.
    pub fn time_of(&self, now: Time) -> u64 {
        self.anchor_ns + now.as_nanos()
    }

    /// Converts the events of one turn of the event loop, at the time `now`, to messages and passes these to `take`.
    /// `events` has all events of the turn, without the final `Event::Turn`.
    pub fn instant(&mut self, now: Time, events: &[Event], take: Take) {
        let at = self.time_of(now);
        // Written before the turn, whose inputs may be incomplete: a replay ends here.
        for event in events.iter().filter(|event| matches!(event, Event::Dropped(_))) {
            self.event(now, at, event, take);
        }
        if self.scope == Scope::Host {
            self.write_turn(now, at, events, take);
        }
        for event in events.iter().filter(|event| !matches!(event, Event::Dropped(_))) {
            self.event(now, at, event, take);
        }
        if self.moved && self.drawn.is_none_or(|drawn| now.since(drawn) >= DRAWING_PERIOD) {
            (self.moved, self.drawn) = (false, Some(now));
            self.draw(now, at, take);
        }
    }

    fn write_turn(&mut self, now: Time, at: u64, events: &[Event], take: Take) {
        self.turn.clear();
        for event in events {
            if let Event::Sent(link, frame) = event {
                self.sent.add(*link, frame);
            }
        }
        tape::begin(&mut self.turn, now, self.sent.take());
        for event in events {
            if let Event::Input(input) = event {
                tape::add(&mut self.turn, input);
            }
        }
        take(Topic::Turn, at, &self.turn);
    }

    fn event(&mut self, now: Time, at: u64, event: &Event, take: Take) {
        match event {
            Event::Published(host, frame) => {
                take(Topic::Wire(*host), at, frame);
                if self.scope == Scope::Simulation
                    && matches!(codec::first(frame), Ok(Content::Message(Kind::Mode | Kind::Latent | Kind::Sensed)))
                    && let Ok((_, message)) = codec::decode(frame)
                {
                    self.handle(now, at, &message, take);
                }
            }
            Event::Delivered(message) => {
                if self.scope == Scope::Operator {
                    self.received(at, message, take);
                }
                self.handle(now, at, message, take);
            }
            Event::Logged(Logged { severity, from, text }) => {
                encode_to(Topic::Program, at, &foxglove::log(at, *severity, from, text), take);
            }
            Event::Truth(truth) => self.truth(at, truth, take),
            Event::Episode(episode) => self.episode(at, episode, take),
            Event::Guard(robot, counts) => self.guard(at, *robot, *counts, take),
            Event::Remembered(Remembered { robot, digest }) => {
                let said = json!({ "robot": robot.0, "digest": format!("{digest:016x}") });
                json_to(Topic::Memory, at, &said, take);
            }
            Event::Hardware(robot, hardware) => {
                json_to(Topic::Hardware, at, &condition(*robot, hardware), take);
            }
            Event::Counts(host, counts) => {
                json_to(Topic::Counts, at, &json!({ "host": self.host(*host), "links": counts }), take);
            }
            Event::Peers(host, peers, ways) => {
                json_to(Topic::Links, at, &links(self.host(*host), peers, ways), take);
            }
            Event::Wifi(sample) => json_to(Topic::Wifi, at, sample, take),
            Event::Dropped(count) => {
                json_to(Topic::Counts, at, &json!({ "host": "", "recording_dropped": count }), take);
                self.log_line(
                    at,
                    Severity::Warning,
                    "record",
                    &format!("{count} events were dropped before this one"),
                    take,
                );
            }
            Event::Sent(..) | Event::Input(_) | Event::Refused(..) | Event::Keep | Event::Turn(_) => {}
        }
    }

    /// Returns the name of a host; that of an operator, which is outside the deployment, is `operator`.
    fn host(&self, host: HostId) -> &str {
        self.stage.hosts.get(usize::from(host.0)).map_or("operator", |name| name)
    }

    /// Records a message that an operator has received.
    fn received(&mut self, at: u64, message: &Wire, take: Take) {
        let sequence = self.received;
        self.received = sequence.wrapping_add(1);
        let header = Header { flags: Flags(0), team: 0, sender: HostId::operator(0), incarnation: 0, sequence };
        // Every message that was received fits into a datagram.
        if let Ok(frame) = codec::encode(&header, message) {
            take(Topic::Received, at, &frame);
        }
    }

    fn handle(&mut self, now: Time, at: u64, message: &Wire, take: Take) {
        match message {
            Wire::Mode(mode) => self.follow(now, at, mode, take),
            Wire::Reading(reading) => {
                let body = Body { position: reading.pose.position, heading: reading.pose.heading };
                self.place(reading.robot, body);
            }
            Wire::Latent(latent) => {
                let before = self.team.get(latent.robot.index()).copied().flatten();
                let body = Body { position: latent.motion.position, heading: before.and_then(|body| body.heading) };
                if before.is_none() {
                    self.place(latent.robot, body);
                }
                let last = self.posed.get(&latent.robot);
                if last.is_none_or(|last| now.since(*last) >= POSE_PERIOD) {
                    self.posed.insert(latent.robot, now);
                    encode_to(Topic::Pose(latent.robot), at, &drawing::pose(at, body), take);
                }
            }
            Wire::Telemetry(telemetry) => {
                for condition in &telemetry.robots {
                    if let Some(seen) = condition.seen {
                        let body = Body { position: seen.pose.position, heading: seen.pose.heading };
                        self.place(condition.robot, body);
                    }
                }
            }
            Wire::Sensed(sensed) => self.scan(at, sensed, take),
            _ => {}
        }
    }

    /// Records the values of a sense that are distances along rays.
    fn scan(&self, at: u64, sensed: &Sensed, take: Take) {
        let sense = self.stage.senses.get(usize::from(sensed.sense));
        let Some((sense, rays_rad)) = sense.and_then(|sense| Some((sense, sense.rays_rad?))) else { return };
        if !sensed.is_whole() {
            return;
        }
        let scan = drawing::scan(at, sensed, (rays_rad, sense.mount_m));
        encode_to(Topic::Scan(sensed.robot, sensed.sense), at, &scan, take);
    }

    /// Sets the pose of a robot from a report, unless true states are known.
    fn place(&mut self, robot: RobotId, body: Body) {
        if let Some(place) = self.team.get_mut(robot.index()).filter(|_| !self.true_states) {
            self.moved |= *place != Some(body);
            *place = Some(body);
        }
    }

    fn truth(&mut self, at: u64, truth: &Truth, take: Take) {
        self.true_states = true;
        let mut robots = Vec::with_capacity(truth.samples.len());
        for sample in truth.samples.iter() {
            self.team[sample.robot.index()] =
                Some(Body { position: sample.motion.position, heading: Some(sample.heading) });
            let (motion, command) = (sample.motion, sample.command);
            robots.push(TrueRobot {
                robot: sample.robot.0.into(),
                x: motion.position.x.into(),
                y: motion.position.y.into(),
                velocity_x: motion.velocity.x.into(),
                velocity_y: motion.velocity.y.into(),
                heading: sample.heading.into(),
                yaw_rate: sample.yaw_rate.into(),
                command_x: command.x.into(),
                command_y: command.y.into(),
                touches_robot: sample.contacts.robot,
                touches_wall: sample.contacts.wall,
            });
        }
        self.moved = true;
        encode_to(Topic::Truth, at, &TruthMessage { timestamp: foxglove::time(at), robots }, take);
    }

    /// Records a change of goals or phase in an instruction of the state server.
    fn follow(&mut self, now: Time, at: u64, mode: &Mode, take: Take) {
        for (robot, task) in (mode.first.0..).zip(mode.tasks.iter()) {
            if self.goals.insert(RobotId(robot), task.goal) != Some(task.goal) {
                (self.standing_due, self.moved) = (now, true);
            }
        }
        self.running = if mode.phase == Phase::Running { self.running.or(Some(now)) } else { None };
        if self.followed.replace((mode.round, mode.phase)) == Some((mode.round, mode.phase)) {
            return;
        }
        let (episode, phase) = (mode.round.episode, name_of(mode.phase));
        let said = json!({ "repeat": mode.repeat, "episode": episode, "phase": phase });
        json_to(Topic::Episode, at, &said, take);
        self.log_line(at, Severity::Info, "state server", &format!("episode {}: {phase}", episode + 1), take);
    }

    fn episode(&self, at: u64, episode: &Episode, take: Take) {
        json_to(Topic::Episode, at, episode, take);
        self.log_line(
            at,
            Severity::Info,
            "judge",
            &format!("episode {}: {}", episode.number(), episode.in_words()),
            take,
        );
    }

    fn guard(&mut self, at: u64, robot: RobotId, counts: SafetyCounts, take: Take) {
        let before = self.guards.insert(robot, counts).unwrap_or_default();
        if before == counts {
            return;
        }
        let mut said = serde_json::to_value(counts).expect("counts are JSON");
        said["robot"] = robot.0.into();
        json_to(Topic::Guard, at, &said, take);
        for reason in counts.begun_since(&before) {
            self.log_line(at, Severity::Warning, &format!("guard of robot {}", robot.0), reason.name(), take);
        }
    }

    fn log_line(&self, at: u64, level: Severity, name: &str, text: &str, take: Take) {
        encode_to(Topic::Log, at, &foxglove::log(at, level, name, text), take);
    }

    fn draw(&mut self, now: Time, at: u64, take: Take) {
        let mut scene = SceneUpdate::default();
        let episode = self.followed.map_or(0, |(round, _)| round.episode);
        if now >= self.standing_due {
            self.standing_due = now + STANDING_PERIOD;
            let goals: Vec<Vec2> = self.goals.values().copied().collect();
            scene.entities.extend(drawing::walls_and_goals(at, (&self.stage, episode), &goals));
        }
        let elapsed = self.running.map(|began| now.since(began));
        scene.entities.extend(drawing::movers(at, (&self.stage, episode), elapsed));
        scene.entities.extend(drawing::team(at, &self.stage, &self.team));
        encode_to(Topic::Scene, at, &scene, take);
        encode_to(Topic::Robots, at, &drawing::cloud(at, &self.team), take);
        encode_to(Topic::Transforms, at, &drawing::transforms(at, &self.team), take);
    }
}

/// Returns the condition of a robot's hardware as JSON.
fn condition(robot: RobotId, hardware: &Hardware) -> serde_json::Value {
    let health = match hardware.health {
        Health::Ready => "ready",
        Health::Faulty => "faulty",
        Health::Silent => "silent",
        Health::Other => "other",
    };
    json!({
        "robot": robot, "health": health, "battery": hardware.battery,
        "temperature_c": hardware.temperature.map(Celsius::degrees),
        "reason": hardware.reason.as_ref().map(Reason::text),
    })
}

fn encode_to(topic: Topic, at: u64, message: &impl Message, take: Take) {
    take(topic, at, &message.encode_to_vec());
}

fn json_to(topic: Topic, at: u64, value: &impl Serialize, take: Take) {
    take(topic, at, &serde_json::to_vec(value).expect("counts and results are JSON"));
}

/// Returns the content of a message about the links of a host. Without a mesh and a link that chooses it has no ways.
fn links(host: &str, peers: &[Peer], ways: &Ways) -> Value {
    let mut said = json!({ "host": host, "peers": peers });
    if let (Some(said), Value::Object(ways)) = (said.as_object_mut(), json!(ways)) {
        said.extend(ways);
    }
    said
}

/// Returns the name of a phase in records.
pub fn name_of(phase: Phase) -> &'static str {
    match phase {
        Phase::NeedReset => "need-reset",
        Phase::Resetting => "resetting",
        Phase::FinishedResetting => "finished-resetting",
        Phase::Running => "running",
        Phase::FinishedRunning => "finished-running",
        Phase::AbortRunning => "abort-running",
        Phase::EpisodesFinished => "episodes-finished",
        Phase::Waiting => "waiting",
        Phase::Other => "other",
    }
}
