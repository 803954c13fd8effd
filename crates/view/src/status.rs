//! JSON messages to the page: the scene once, goals at each episode, and the status twice a second.

use std::collections::{BTreeMap, VecDeque};

use serde::Serialize;

use super::mesh::MeshStatus;
use super::scans::ScanForm;
use murmurate::messages::geometry::Planar;
use murmurate::messages::ids::RobotId;
use murmurate::scenario::{Arena, DrawnMover, KeepOut, Solid};

/// Largest number of log lines that the live page gets.
pub const LOG_LINES: usize = 40;
/// Longest log line \[characters\].
const LINE: usize = 300;
/// Longest time between two events that share a line of the log \[s\].
const BURST_S: f64 = 10.0;
/// Largest number of robots that such a line names.
const LISTED: usize = 8;

/// Constant properties of a run, which the live page gets first: scenario, ground, robots and links.
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
    /// Walls and other solid blocks \[m\], world frame.
    pub walls: Vec<Solid>,
    /// Walls and obstacles of each episode, where obstacles are drawn for each; empty where all episodes have `walls`.
    pub drawn: Vec<Vec<Solid>>,
    /// Obstacles that move while an episode runs; empty if there are none.
    pub movers: Vec<DrawnMover>,
    /// Waypoints of each robot in each episode \[m\], world frame; empty if there are none.
    pub waypoints: Vec<Vec<Vec<[f32; 2]>>>,
    /// Whether goals belong to no robot.
    pub unlabelled: bool,
    /// Radius of a robot's hull \[m\].
    pub hull_m: f32,
    /// Communication range of the robots \[m\]; null if it is unlimited.
    pub range_m: Option<f32>,
    /// Unit of the coordinates in encoded snapshots of the team \[m\].
    pub scale_m: f32,
    /// Commands that the process accepts from the page, as a word: `stop` (emergency stop alone), `team` (all orders to
    /// the team), `emulation` (faults, too) or `playback` (of a record).
    pub control: &'static str,
    /// Names of the deployment's links. In an emulated team the page can put faults on them.
    pub links: Vec<String>,
    /// Directions of the rays of each sense whose values are distances; empty if there is none.
    pub scans: Vec<ScanForm>,
    /// Whether this process receives enough messages to show the links between robots.
    pub hears_links: bool,
    /// Whether this process knows the results of episodes.
    pub hears_results: bool,
    /// Properties of the record that is played; null for a running team.
    pub record: Option<PlayedRecord>,
}

/// Properties of a record that the live page needs to play it.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PlayedRecord {
    /// Name of the record's file or folder.
    pub name: String,
    /// Duration of the record \[s\].
    pub duration_s: f64,
    /// Marks on the timeline of the record (such as ends of episodes), in the order of time.
    pub marks: Vec<Mark>,
    /// Note about what the record cannot show, and why; empty if there is nothing to note.
    pub note: String,
}

/// Kind of an event that is marked on the timeline of a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum MarkKind {
    /// A successful episode has ended.
    Success,
    /// An episode has ended without success.
    Failure,
    /// The emergency stop of the team was engaged, re-armed or cleared.
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
    /// Returns the scene of an arena, with ground, walls and the robots' radius; the other fields have defaults.
    /// Encoded positions may be up to 2 m beyond the ground.
    pub fn of_arena(arena: &Arena) -> Scene {
        let half = arena.half_extent.to_array();
        Scene {
            half_extent: half,
            walls: arena.keep_outs.iter().map(KeepOut::solid).collect(),
            hull_m: arena.robot_radius_m,
            scale_m: super::snapshot::scale_m(half[0].max(half[1]) + 2.0),
            control: "stop",
            ..Scene::default()
        }
    }

    /// Encodes the scene as a JSON message to the page.
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
    /// Encodes the goals as a JSON message to the page.
    pub fn to_json(&self) -> String {
        message("goals", self)
    }
}

/// Number of successful episodes, with the 95 % Wilson interval of the success rate.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Success {
    /// Number of successful episodes.
    pub successes: usize,
    /// Number of episodes with a result.
    pub episodes: usize,
    /// Lower and upper end of the 95 % interval of the success rate, 0 to 1.
    pub interval: [f64; 2],
}

/// Faults that a user of the live page has put on one link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct LinkImpairment {
    /// Whether the link loses every frame.
    pub cut: bool,
    /// Delay that is added to every frame \[ms\].
    pub delay_ms: f64,
    /// Probability, 0 to 1, that a frame is lost.
    pub loss: f64,
}

/// End of a run, for the live page.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Ending {
    /// Whether the run has ended as it should.
    pub regular: bool,
    /// Description of the end, as text.
    pub text: String,
}

/// State of the team that the live page shows beside the snapshots: episode, emergency stop, results, faults and log.
#[derive(Clone, Debug, Default, Serialize)]
pub struct PageStatus {
    /// Time since the start of the run \[s\].
    pub time_s: f64,
    /// Simulated seconds per second of real time, over the last second; null if the team is not simulated.
    pub speed: Option<f64>,
    /// Number of the current episode, from 1; null before an instruction of the state server was received.
    pub episode: Option<u32>,
    /// Phase of the episode according to the state server, as its number on the wire, 0 to 7 in the order of `Phase`;
    /// null before an instruction of the state server was received.
    pub phase: Option<u8>,
    /// State of the team's emergency stop, as a word: `clear`, `held` (re-armed, and not resumed yet) or `stopped`.
    pub latch: &'static str,
    /// Number of robots that follow the team's state of the emergency stop.
    pub confirmed: usize,
    /// Number of robots.
    pub robots: usize,
    /// Whether an order from a page (such as stop or resume) waits for the confirmation of all robots.
    pub ordering: bool,
    /// Pause of the team: `no`, `asked` (it pauses after the current episode), or `yes` once it has paused.
    pub pause: &'static str,
    /// Number of episodes with each verdict, by the verdict's name.
    pub verdicts: BTreeMap<String, u32>,
    /// Success rate so far; null if this process does not know the results of episodes.
    pub success: Option<Success>,
    /// Id of a robot, and how many times its control ticks began to be late; one pair for each robot of which it is
    /// known.
    pub late: Vec<(u16, u64)>,
    /// Id of a robot, and the time since the last message of the neighbour that has been silent longest \[ms\], as the
    /// robot's host reports it. The page shows it if this process does not know the links themselves.
    pub link: Vec<(u16, u32)>,
    /// Id of a robot, the last reason why its guard has stopped or slowed it, and the time since then \[s\], null if
    /// that is unknown; one entry for each robot with a reason in the last minute. An emergency stop is left out once
    /// the team may move again.
    pub guard: Vec<(u16, &'static str, Option<f64>)>,
    /// Ids of robots whose agent runs in a process that has died and is not back yet.
    pub down: Vec<u16>,
    /// Id of a robot, and its battery charge \[%\]; one pair for each robot of which it is known.
    pub battery: Vec<(u16, u8)>,
    /// Id of a robot that flies, and the state of its flight in words.
    pub flight: Vec<(u16, &'static str)>,
    /// Descriptions of the actors that a user of the page has crashed.
    pub killed: Vec<String>,
    /// Faults that a user of the page has put on links, by the link's name.
    pub impaired: BTreeMap<String, LinkImpairment>,
    /// Robots that robots hear directly, and the hops over which they are heard; null in a team without a mesh and
    /// without a link that chooses.
    pub mesh: Option<MeshStatus>,
    /// Newest lines of the log.
    pub log: Vec<LogLine>,
    /// Whether the run is over, or this process has ended the page.
    pub over: bool,
    /// End of the run; null before it.
    pub ending: Option<Ending>,
    /// Reason why this process understands nothing of the team that it hears, such as another key; null if there is
    /// none. Then a stop of the page has no effect, either.
    pub trouble: Option<&'static str>,
    /// State of the playback of a record; null for a running team.
    pub playback: Option<Playback>,
}

impl PageStatus {
    /// Encodes the status as a JSON message to the page.
    pub fn to_json(&self) -> String {
        message("status", self)
    }
}

/// Line of a run's log for the live page.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LogLine {
    /// Number of the line's newest change; later changes have larger ones.
    pub number: u64,
    /// Number that the line got first. It stays when the line changes, so that the page can replace it.
    pub id: u64,
    /// Time since the start of the run \[s\], of the newest event in the line.
    pub time_s: f64,
    /// Text of the line.
    pub text: String,
    #[serde(skip)]
    burst: Option<Burst>,
}

/// Events of one kind that follow each other closely and share a line of the log.
#[derive(Clone, Debug, PartialEq)]
struct Burst {
    kind: &'static str,
    episode: Option<u32>,
    /// Number of events of each robot.
    robots: BTreeMap<RobotId, u64>,
}

impl Burst {
    fn text(&self) -> String {
        let times: u64 = self.robots.values().sum();
        let often = if times > 1 { format!(" ({times} times)") } else { String::new() };
        let mut ids = self.robots.keys();
        match (ids.next(), self.robots.len()) {
            (Some(robot), 1) => format!("{robot}: {}{often}", self.kind),
            (_, many) => {
                let listed: Vec<String> = self.robots.keys().take(LISTED).map(|robot| robot.0.to_string()).collect();
                let more = many.checked_sub(LISTED).filter(|more| *more > 0);
                let more = more.map_or_else(String::new, |more| format!(" and {more} more"));
                format!("robots {}{more}: {}{often}", listed.join(", "), self.kind)
            }
        }
    }
}

/// Newest lines of a run's log, for the live page. What guards do again and again takes one line for each kind, so that
/// it pushes no other event out.
#[derive(Clone, Debug, Default)]
pub struct Log {
    lines: VecDeque<LogLine>,
    count: u64,
}

impl Log {
    /// Adds a line to the log. `time_s` is the time since the start of the run \[s\].
    pub fn add(&mut self, time_s: f64, line: &str) {
        self.push(time_s, line.chars().take(LINE).collect(), None);
    }

    /// Adds an event of a robot that may happen many times, such as an action of its guard: to the line of the same
    /// kind if that is of the same episode and at most 10 s old, otherwise in a line of its own.
    pub fn repeat(&mut self, time_s: f64, kind: &'static str, robot: RobotId, episode: Option<u32>) {
        let same = |line: &LogLine| {
            let like = line.burst.as_ref().is_some_and(|burst| (burst.kind, burst.episode) == (kind, episode));
            like && time_s - line.time_s <= BURST_S
        };
        let known = self.lines.iter().rposition(same).and_then(|at| self.lines.remove(at));
        let (id, mut burst) = match known {
            Some(LogLine { id, burst: Some(burst), .. }) => (Some(id), burst),
            _ => (None, Burst { kind, episode, robots: BTreeMap::new() }),
        };
        *burst.robots.entry(robot).or_default() += 1;
        let text = burst.text();
        self.push(time_s, text, Some(burst));
        if let (Some(id), Some(line)) = (id, self.lines.back_mut()) {
            line.id = id;
        }
    }

    fn push(&mut self, time_s: f64, text: String, burst: Option<Burst>) {
        self.count += 1;
        self.lines.push_back(LogLine { number: self.count, id: self.count, time_s, text, burst });
        if self.lines.len() > LOG_LINES {
            // The oldest line of a guard leaves first, unless it is the last one of its kind.
            let kind = |line: &LogLine| line.burst.as_ref().map(|burst| burst.kind);
            let newer = |at: usize| self.lines.iter().skip(at + 1).any(|line| kind(line) == kind(&self.lines[at]));
            let repeated = (0..self.lines.len()).find(|at| kind(&self.lines[*at]).is_some() && newer(*at));
            let event = (0..self.lines.len()).find(|at| kind(&self.lines[*at]).is_none());
            self.lines.remove(repeated.or(event).unwrap_or(0));
        }
    }

    /// Returns the number of changes of the log since the start of the run.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Returns the newest lines of the log, in the order of their newest changes.
    pub fn lines(&self) -> &VecDeque<LogLine> {
        &self.lines
    }
}

/// Encodes a message to the page as JSON, with the name of its kind.
fn message(kind: &str, body: &impl Serialize) -> String {
    serde_json::json!({ "kind": kind, "body": body }).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(log: &Log) -> Vec<&str> {
        log.lines().iter().map(|line| &*line.text).collect()
    }

    #[test]
    fn what_guards_do_again_and_again_takes_one_line_and_pushes_no_event_out() {
        let mut log = Log::default();
        log.add(0.0, "robot 3: silent");
        for step in 0..2000 {
            log.repeat(f64::from(step) * 0.05, "minimum distance", RobotId((step % 3) as u16), Some(0));
            log.repeat(f64::from(step) * 0.05, "walls", RobotId(1), Some(0));
        }
        let expected =
            ["robot 3: silent", "robots 0, 1, 2: minimum distance (2000 times)", "robot 1: walls (2000 times)"];
        assert_eq!((texts(&log), log.count()), (expected.to_vec(), 4001));
        let ids: Vec<u64> = log.lines().iter().map(|line| line.id).collect();
        assert_eq!(ids, [1, 2, 3], "the page replaces a line by the same");
        log.repeat(200.0, "walls", RobotId(1), Some(0));
        log.repeat(200.1, "walls", RobotId(1), Some(1));
        assert_eq!(texts(&log)[3..], ["robot 1: walls", "robot 1: walls"], "later, and in another episode");
    }

    #[test]
    fn of_many_lines_those_of_guards_leave_first_but_the_last_of_each_kind_stays() {
        let mut log = Log::default();
        log.repeat(0.0, "geofence", RobotId(0), None);
        (0..35).for_each(|event| log.add(f64::from(event), &format!("event {event}")));
        (0..100).for_each(|burst| log.repeat(100.0 * f64::from(burst), "walls", RobotId(1), None));
        assert_eq!(log.lines().len(), LOG_LINES);
        assert!((0..35).all(|event| texts(&log).contains(&&*format!("event {event}"))));
        assert!(texts(&log).contains(&"robot 0: geofence"), "{:?}", texts(&log));
        (0..100).for_each(|event| log.add(f64::from(event), "later"));
        assert!(texts(&log).contains(&"robot 1: walls") && !texts(&log).contains(&"event 34"));
    }
}
