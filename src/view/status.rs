//! JSON messages to the page: the scene once, goals at each episode, and the status twice a second.

use std::collections::{BTreeMap, VecDeque};

use serde::Serialize;

use crate::scenario::arena::Arena;

/// Largest number of log lines in a status.
pub const LOG_LINES: usize = 40;
/// Longest log line \[characters\].
const LINE: usize = 300;

/// Properties of a run that do not change, which the live page gets first: scenario, ground, robots and links.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Scene {
    /// Name of the scenario.
    pub scenario: String,
    /// Name of the deployment's mode.
    pub mode: String,
    /// Name of the policy.
    pub policy: String,
    /// Number of robots.
    pub robots: usize,
    /// Number of episodes of the run; 0 if unknown.
    pub episodes: u32,
    /// Half the size of the ground along x and y \[m\]; its middle is the origin.
    pub half_extent: [f32; 2],
    /// Solid blocks: smallest x and y, then largest x and y \[m\], world frame.
    pub walls: Vec<[f32; 4]>,
    /// Radius of a robot's hull \[m\].
    pub hull_m: f32,
    /// Communication range \[m\]; null if it is unlimited.
    pub range_m: Option<f32>,
    /// Unit of encoded coordinates in snapshots \[m\].
    pub scale_m: f32,
    /// Commands that the process accepts: the stop alone, orders to the team, or faults as well.
    pub control: &'static str,
    /// Names of the links, on which the page can put faults if the team is emulated.
    pub links: Vec<String>,
    /// Whether this process receives enough to show links between robots.
    pub hears_links: bool,
    /// Whether this process knows the results of episodes.
    pub hears_results: bool,
    /// Record that is played; null for a running team.
    pub record: Option<Record>,
}

/// Properties of a record that the page's scrubber needs.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Record {
    /// Name of the record's file or folder.
    pub name: String,
    /// Duration of the record \[s\].
    pub duration_s: f64,
    /// Marks of the record, in the order of time.
    pub marks: Vec<Mark>,
}

/// Kind of a mark on the timeline of a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum MarkKind {
    /// A successful episode has ended.
    Success,
    /// An episode has ended without success.
    Failure,
    /// The emergency stop state of the team has changed.
    Stop,
    /// The guard of a robot has begun to stop or slow it.
    Guard,
}

/// Mark on the timeline of a record: an event with its time, kind and description.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Mark {
    /// Time of the event since the start of the record \[s\].
    pub at_s: f64,
    /// Kind of the event.
    pub kind: MarkKind,
    /// Description of the event, as text.
    pub text: String,
}

/// State of the playback of a record.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Playback {
    /// Whether the playback runs; false while it is halted.
    pub playing: bool,
    /// Playback speed: seconds of the record for each second of real time.
    pub rate: f64,
}

impl Scene {
    /// Makes the scene of an arena. Encoded positions reach 2 m beyond its ground; the other fields have defaults.
    pub fn of_arena(arena: &Arena) -> Scene {
        let half = arena.half_extent.to_array();
        let wall = |block: &crate::scenario::arena::KeepOut| {
            let ([x, y], [far_x, far_y]) = (block.min.to_array(), block.max.to_array());
            [x, y, far_x, far_y]
        };
        Scene {
            half_extent: half,
            walls: arena.keep_outs.iter().map(wall).collect(),
            hull_m: arena.robot_radius_m,
            scale_m: super::snapshot::scale_m(half[0].max(half[1]) + 2.0),
            control: "stop",
            ..Scene::default()
        }
    }

    /// Encodes the scene as JSON for the page.
    pub fn to_json(&self) -> String {
        message("scene", self)
    }
}

/// Goals of the robots of one episode.
#[derive(Clone, Debug, Serialize)]
pub struct Goals {
    /// Goal of each robot \[m\], world frame; null if it is unknown.
    pub goals: Vec<Option<[f32; 2]>>,
}

impl Goals {
    /// Encodes the goals as JSON for the page.
    pub fn to_json(&self) -> String {
        message("goals", self)
    }
}

/// Number of successful episodes with its Wilson interval.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Success {
    /// Number of successful episodes.
    pub successes: usize,
    /// Number of episodes with a result.
    pub episodes: usize,
    /// Lower and upper end of the 95 % interval of the success rate, 0 to 1.
    pub interval: [f64; 2],
}

/// Faults that a page has set on one link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct LinkImpairment {
    /// Whether the link loses every frame.
    pub cut: bool,
    /// Additional delay of every frame \[ms\].
    pub delay_ms: f64,
    /// Probability, 0 to 1, that a frame is lost.
    pub loss: f64,
}

/// State of the team as the page shows it beside the picture.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Status {
    /// Time since the start of the run \[s\].
    pub time_s: f64,
    /// Simulated seconds per second of real time, over the last second; null on real robots.
    pub speed: Option<f64>,
    /// Number of the current episode, from 1; null before an instruction of the state server was received.
    pub episode: Option<u32>,
    /// Phase of the episode according to the state server; null before an instruction of it was received.
    pub phase: Option<u8>,
    /// Emergency stop of the team: clear, held or stopped.
    pub latch: &'static str,
    /// Number of robots that follow this emergency stop state.
    pub confirmed: usize,
    /// Number of robots.
    pub robots: usize,
    /// Whether an order of a page is not yet confirmed by all robots.
    pub ordering: bool,
    /// Whether the team pauses after the current episode: `no`, `asked`, or `yes` once it has paused.
    pub pause: &'static str,
    /// Number of episodes by verdict.
    pub verdicts: BTreeMap<String, u32>,
    /// Successful episodes so far; null if this process does not know results.
    pub success: Option<Success>,
    /// Number of times that control ticks became late, by robot, where it is known.
    pub late: Vec<(u16, u64)>,
    /// By robot: age of its oldest link to a neighbour \[ms\], as its host reports it. Used if this process does not
    /// know the links themselves.
    pub link: Vec<(u16, u32)>,
    /// Last reason why a robot's guard has stopped or slowed it, by robot.
    pub guard: Vec<(u16, &'static str)>,
    /// Battery charge by robot \[%\], where it is known.
    pub battery: Vec<(u16, u8)>,
    /// Descriptions of the actors that a page has crashed.
    pub killed: Vec<String>,
    /// Faults that a page has set on links, by the link's name.
    pub impaired: BTreeMap<String, LinkImpairment>,
    /// Newest log lines: number of the line, time since the start of the run \[s\], text.
    pub log: VecDeque<(u64, f64, String)>,
    /// Whether the run is over.
    pub over: bool,
    /// State of the playback of a record; null for a running team.
    pub playback: Option<Playback>,
}

impl Status {
    /// Encodes the status as JSON for the page.
    pub fn to_json(&self) -> String {
        message("status", self)
    }
}

/// Newest log lines of a run, for the page.
#[derive(Clone, Debug, Default)]
pub struct Log {
    lines: VecDeque<(u64, f64, String)>,
    count: u64,
}

impl Log {
    /// Adds a line at the time `time_s` \[s\] of the run.
    pub fn add(&mut self, time_s: f64, line: &str) {
        self.count += 1;
        self.lines.push_back((self.count, time_s, line.chars().take(LINE).collect()));
        if self.lines.len() > LOG_LINES {
            self.lines.pop_front();
        }
    }

    /// Returns the number of lines added to the log since the start of the run.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Returns the newest lines of the log: number of the line, time of the run \[s\], text.
    pub fn lines(&self) -> &VecDeque<(u64, f64, String)> {
        &self.lines
    }
}

/// Encodes a message to the page as JSON, with the name of its kind.
fn message(kind: &str, body: &impl Serialize) -> String {
    serde_json::json!({ "kind": kind, "body": body }).to_string()
}
