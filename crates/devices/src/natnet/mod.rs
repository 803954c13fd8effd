//! Source `natnet`: rigid bodies of a motion capture system that streams NatNet (OptiTrack), bitstreams 3.0 to 4.4.
//!
//! The worker passes the server's datagrams on unchanged. The source itself does no I/O: it decodes them, finds each
//! robot's body, transforms poses to the team's frame, and computes velocities from a short window of poses.

mod body;
mod client;
pub mod frame;
mod model;
mod packet;
mod settings;
mod worker;

use murmurate::config::ConfigError;
use murmurate::edge::Settings;
use murmurate::localization::alignment::Alignment;
use murmurate::localization::plausibility::Limits;
use murmurate::localization::{In, Out, Parts, Source};
use murmurate::messages::geometry::{self, Deviation, MAX_HEADING, MAX_SIZE, Twist, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::Reading;
use murmurate::time::{Span, Time};

use body::{Body, Pose};
use frame::{FrameLayout, MocapFrame, RigidBody, Tracking};
use model::Definition;
use packet::{Malformed, Version};
use settings::{BodyName, Config, Up};

/// Description of the source `natnet` in one line, for lists of all sources.
pub const ABOUT: &str = "motion capture that streams NatNet (OptiTrack Motive)";

/// Largest time by which the stamp of a frame may be before that of the last frame, for the frame to be dropped as late
/// \[s\]. A larger difference means that the server was restarted.
const LATE_S: f64 = 1.0;
/// Smallest standard deviation of a position that readings report \[m\]. It is computed from the mean marker error,
/// which may be close to zero by chance.
const LEAST_ERROR_M: f32 = 1e-4;
/// Smallest length of the projection of a body's unit x axis onto the floor. Below it the body, tilted by more than 60
/// degrees, has no heading.
const LEVEL: f64 = 0.5;

/// Largest number of rigid bodies of others whose faults are logged, each once.
const MOST_STRANGERS: usize = 8;
/// Largest number of names of rigid bodies that a log line lists.
const MOST_NAMES: usize = 12;

/// Fraction of the period of readings by which a frame may come before a reading is due and still give that reading. So
/// every second frame of 100 Hz gives a reading at 50 Hz.
const EARLY: f64 = 0.1;

/// Makes the source `natnet`, which localizes `robots` by motion capture, and the worker that does its I/O. An error
/// names the wrong setting.
pub fn make(settings: &Settings, robots: &[RobotId]) -> Result<Parts, ConfigError> {
    let config = Config::read(settings, robots)?;
    let worker = Box::new(worker::Listener { config: config.network.clone() });
    Ok(Parts { source: Box::new(move || Box::new(NatNet::new(&config))), worker })
}

/// Robot with the name of its rigid body in the tracker, the poses of that body, and the limits of its motion.
struct Tracked {
    robot: RobotId,
    name: BodyName,
    /// Streaming ID of the body; `None` until model definitions contain the body's name.
    id: Option<i32>,
    body: Body,
    limits: Limits,
}

/// Logic of the source `natnet`, without I/O: converts datagrams of the motion capture server to readings.
struct NatNet {
    config: Config,
    robots: Vec<Tracked>,
    layout: FrameLayout,
    /// NatNet version of the server; `None` before the server's description arrives.
    version: Option<Version>,
    /// Last received definitions (names and IDs) of the tracker's rigid bodies; empty before the first arrive.
    definitions: Vec<Definition>,
    /// Streaming IDs of bodies of no robot that were tracked without a pose, each logged once.
    strangers: Vec<i32>,
    /// Number and stamp \[s\] of the last frame; `None` before the first.
    last: Option<(i32, f64)>,
    /// Stamp of a frame from which the next readings are put out \[s\]; frames before it give none.
    due_s: f64,
}

impl NatNet {
    fn new(config: &Config) -> NatNet {
        let tracked = |(robot, name): &(RobotId, BodyName)| {
            let id = if let BodyName::Id(id) = name { Some(*id) } else { None };
            Tracked { robot: *robot, name: name.clone(), id, body: Body::default(), limits: Limits::default() }
        };
        NatNet {
            robots: config.bodies.iter().map(tracked).collect(),
            config: config.clone(),
            layout: FrameLayout::Sized,
            version: None,
            definitions: Vec::new(),
            strangers: Vec::new(),
            last: None,
            due_s: 0.0,
        }
    }

    /// Processes a datagram of the server, and appends readings to `out`. Messages of unused kinds are ignored. An
    /// error says why the datagram is malformed.
    fn datagram(&mut self, datagram: &[u8], out: &mut Vec<Out>) -> Result<(), Malformed> {
        let (message, payload) = packet::split(datagram)?;
        match message {
            packet::FRAME => {
                let (frame, layout) = frame::decode(payload, self.layout)?;
                self.layout = layout;
                self.frame(&frame, out);
            }
            packet::MODEL => self.identify(model::decode(payload, self.version)?),
            packet::SERVER_INFO => {
                let version = packet::server_info(payload)?.natnet;
                if self.version != Some(version) {
                    (self.version, self.layout) = (Some(version), FrameLayout::of(version));
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// Finds the streaming ID of each robot's rigid body by the body's name in the model definitions. A name that
    /// several bodies have says nothing. Does nothing if the definitions have not changed.
    fn identify(&mut self, definitions: Vec<Definition>) {
        if definitions == self.definitions {
            return;
        }
        for Tracked { robot, name, id, body, .. } in &mut self.robots {
            let BodyName::Name(name) = name else { continue };
            let mut ids: Vec<i32> = definitions.iter().filter(|other| other.name == *name).map(|one| one.id).collect();
            ids.dedup();
            let found = if let [id] = ids[..] { Some(id) } else { None };
            if found.is_none() {
                tracing::warn!("{robot}: {}", not_found(name, &ids, &definitions));
            }
            if found != *id {
                (*id, *body) = (found, Body::default());
            }
        }
        self.definitions = definitions;
    }

    fn frame(&mut self, frame: &MocapFrame, out: &mut Vec<Out>) {
        if let Some((number, stamp_s)) = self.last {
            if number == frame.number || stamp_s.total_cmp(&frame.stamp_s).is_eq() {
                out.push(Out::Refused("the tracker repeats a frame or its stamp"));
                return;
            }
            if frame.stamp_s < stamp_s && stamp_s - frame.stamp_s < LATE_S {
                out.push(Out::Refused("a frame has arrived after a newer one"));
                return;
            }
            if frame.stamp_s < stamp_s {
                self.due_s = 0.0;
                self.robots.iter_mut().for_each(|tracked| tracked.body = Body::default());
            }
        }
        self.last = Some((frame.number, frame.stamp_s));
        let is_due = frame.stamp_s + EARLY * self.config.period_s >= self.due_s;
        if is_due {
            // Due times form a grid, which keeps the mean rate; after a pause the grid begins anew.
            let next_s = self.due_s + self.config.period_s;
            self.due_s = if next_s > frame.stamp_s { next_s } else { frame.stamp_s + self.config.period_s };
        }
        for at in 0..self.robots.len() {
            match self.follow(at, frame) {
                Ok(Some(reading)) if is_due => out.push(checked(reading)),
                Ok(_) => {}
                Err(why) => out.push(Out::RefusedOf(self.robots[at].robot, why)),
            }
        }
        self.note_strangers(frame);
    }

    /// Logs each body of no robot that is tracked without a pose, once. It concerns nobody, and its tracker may have to
    /// be corrected.
    fn note_strangers(&mut self, frame: &MocapFrame) {
        for rigid in &frame.bodies {
            let Tracking::NoPose(why) = rigid.tracking else { continue };
            let id = rigid.id;
            let is_ours = self.robots.iter().any(|tracked| tracked.id == Some(id));
            if !is_ours && self.strangers.len() < MOST_STRANGERS && !self.strangers.contains(&id) {
                self.strangers.push(id);
                tracing::warn!("the tracker's rigid body {id}, which is no robot's, is ignored: {why}");
            }
        }
    }

    /// Processes the pose of the body of robot `at` in a frame. Returns a reading if the body is tracked and its
    /// velocity is known. An error is the reason for which the pose is refused.
    fn follow(&mut self, at: usize, frame: &MocapFrame) -> Result<Option<Reading>, &'static str> {
        let (before, rest) = self.robots.split_at_mut(at);
        let Some((tracked, after)) = rest.split_first_mut() else { return Ok(None) };
        let Tracked { robot, id: Some(id), body, limits, .. } = tracked else { return Ok(None) };
        if before.iter().chain(&*after).any(|other| other.id == Some(*id)) {
            return Err("another robot has the same rigid body: give each its own, in `bodies` or in the tracker");
        }
        let rigid = sole(frame, *id)?;
        let pose = self.config.frame.pose(frame.stamp_s, rigid);
        Ok(body.take(pose, limits, self.config.window_s).map(|rates| {
            let known = rigid.error_m > 0.0 && rigid.error_m <= MAX_SIZE;
            let error_m = known.then(|| rigid.error_m.max(LEAST_ERROR_M));
            let vector = |[x, y]: [f64; 2]| Vec2::new(x as f32, y as f32);
            let heading = pose.heading.map(|heading| (heading as f32).clamp(-MAX_HEADING, MAX_HEADING));
            Reading {
                robot: *robot,
                stamp_ns: Span::from_secs(frame.stamp_s).as_nanos(),
                pose: geometry::Pose { position: vector(pose.position), heading },
                twist: Twist { velocity: vector(rates.velocity), yaw_rate: rates.yaw_rate.map(|rate| rate as f32) },
                deviation: Deviation {
                    position_m: error_m,
                    velocity_m_s: error_m.map(|error_m| error_m * std::f32::consts::SQRT_2 / rates.span_s as f32),
                    ..Deviation::default()
                },
            }
        }))
    }
}

/// Returns the rigid body with this streaming ID in a frame. An error says why the frame has no pose of it.
fn sole(frame: &MocapFrame, id: i32) -> Result<&RigidBody, &'static str> {
    let mut own = frame.bodies.iter().filter(|rigid| rigid.id == id).peekable();
    if own.peek().is_none() {
        return Err("the tracker's frames have no rigid body of its ID: does it stream rigid bodies?");
    }
    let mut tracked = own.filter(|rigid| rigid.tracking != Tracking::Lost);
    match (tracked.next(), tracked.next()) {
        (None, _) => Err("the tracker has lost its rigid body"),
        (Some(RigidBody { tracking: Tracking::NoPose(why), .. }), None) => Err(why),
        (Some(rigid), None) => Ok(rigid),
        (Some(_), Some(_)) => Err("two rigid bodies in a frame have its ID: correct the IDs in the tracker"),
    }
}

/// Returns the text about a robot's body `name` that the model definitions have not, or several times, with the
/// streaming IDs `ids`. Names of the tracker come from outside, so their odd characters are escaped.
fn not_found(name: &str, ids: &[i32], definitions: &[Definition]) -> String {
    let quoted = |name: &str| format!("'{}'", name.chars().take(40).collect::<String>().escape_debug());
    let own = quoted(name);
    if !ids.is_empty() {
        let ids = ids.iter().map(i32::to_string).collect::<Vec<_>>().join(", ");
        return format!("the tracker has several rigid bodies {own}, with the IDs {ids}: rename them, or set `bodies`");
    }
    let plain = |name: &str| name.trim().to_lowercase();
    let is_alike = definitions.iter().any(|definition| plain(&definition.name) == plain(name));
    let hint = if is_alike { "; blanks and capitals count" } else { "" };
    let mut known: Vec<String> = definitions.iter().map(|definition| quoted(&definition.name)).collect();
    let more = known.len().saturating_sub(MOST_NAMES);
    known.truncate(MOST_NAMES);
    if more > 0 {
        known.push(format!("and {more} more"));
    }
    let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
    format!("the tracker has no rigid body {own}: set `bodies`; it has: {known}{hint}")
}

fn checked(reading: Reading) -> Out {
    match reading.unfit() {
        None => Out::Reading(reading),
        Some(why) => Out::RefusedOf(reading.robot, why),
    }
}

impl Source for NatNet {
    fn take(&mut self, _: Time, input: In, out: &mut Vec<Out>) {
        let In::Packet(datagram) = input else { return };
        if let Err(Malformed(why)) = self.datagram(datagram, out) {
            out.push(Out::Refused(why));
        }
    }

    fn limit(&mut self, robot: RobotId, limits: &Limits) {
        let own = self.robots.iter_mut().find(|tracked| tracked.robot == robot);
        own.into_iter().for_each(|tracked| tracked.limits = *limits);
    }
}

/// Frame of the tracker: which of its axes points up, and its alignment with the team's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TrackerFrame {
    up: Up,
    level: Alignment,
}

impl TrackerFrame {
    /// Transforms a rigid body's pose to the team's frame. The heading is the direction of the body's x axis.
    fn pose(&self, stamp_s: f64, rigid: &RigidBody) -> Pose {
        let raised = |[x, y, z]: [f64; 3]| match self.up {
            Up::Y => [x, -z, y],
            Up::Z => [x, y, z],
        };
        let [x, y, _] = raised(rigid.position);
        let [i, j, k, w] = rigid.rotation;
        let [i, j, k] = raised([i, j, k]);
        // The body's x axis, projected onto the floor.
        let (ahead, left) = (1.0 - 2.0 * (j * j + k * k), 2.0 * (i * j + w * k));
        let level = libm::hypot(ahead, left) >= LEVEL;
        Pose {
            stamp_s,
            position: self.level.position(x, y),
            heading: level.then(|| self.level.heading(libm::atan2(left, ahead))),
        }
    }
}
