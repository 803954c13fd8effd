//! Writes an imported run as a record: measured states as `/truth`, beginnings of episodes, receipts of messages, and
//! what viewers draw.

use std::collections::BTreeMap;
use std::path::Path;

use mcap::McapError;
use serde::{Deserialize, Serialize};
use serde_json::json;

use murmurate::messages::geometry::Planar;
use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::local::{Contacts, Sample, Truth};
use murmurate::scenario::{KeepOut, Scenario};
use murmurate::time::Time;
use murmurate_record::file::{Attached, Beginning, RecordError, RecordFile};
use murmurate_record::identity::Identity;
use murmurate_record::receipt::Receipt;
use murmurate_record::topics::{Stage, Topic, Topics};
use murmurate_record::{Event, Scope};

use crate::mapping::Mapping;
use crate::samples::Samples;
use crate::steps::{Step, Steps};

/// Mode of the stage of an imported record.
pub const MODE: &str = "imported";
/// Width of the free ground about the robots, if neither task nor mapping gives a ground \[m\].
const MARGIN_M: f32 = 0.5;

/// All that happens at one moment of the run.
#[derive(Default)]
struct Moment {
    /// Number of the episode that begins.
    begins: Option<u32>,
    steps: Vec<Step>,
    receipts: Vec<Receipt>,
}

/// Returns the stage of an imported run: its robots, each on a host of its own, and the ground of its task.
pub fn stage(mapping: &Mapping, steps: &Steps, scenario: Option<&dyn Scenario>) -> Stage {
    let arena = scenario.map(Scenario::arena);
    let farthest = |axis: usize| steps.steps.iter().map(|step| step.position[axis].abs() as f32).fold(0.0, f32::max);
    let used = [0, 1].map(|axis| farthest(axis) + MARGIN_M);
    let of_task = arena.map(|arena| arena.half_extent.to_array());
    let hull_m = mapping.hull_m.or(arena.map(|arena| arena.hull_m())).unwrap_or(murmurate::scenario::size::HULL_M);
    Stage {
        scenario: mapping.task.clone().unwrap_or_else(|| "none".to_owned()),
        mode: MODE.to_owned(),
        hosts: mapping.names.clone(),
        homes: (0..mapping.names.len() as u16).map(HostId).collect(),
        robots: mapping.names.len(),
        half_extent: mapping.half_extent_m.or(of_task).unwrap_or(used),
        walls: arena.iter().flat_map(|arena| arena.keep_outs.iter().map(KeepOut::solid)).collect(),
        drawn: Vec::new(),
        movers: Vec::new(),
        waypoints: Vec::new(),
        unlabelled: false,
        hull_m,
        range_m: None,
        senses: Vec::new(),
    }
}

/// Account of an import: numbers of poses and steps, and how steps were made. It is attached to the record, as
/// `import.json`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Made {
    /// Number of poses in the files.
    pub poses: usize,
    /// Number of steps that were made of them.
    pub steps: usize,
    /// Whether the steps lie between the poses.
    pub resampled: bool,
    /// Whether velocities are differences of positions.
    pub derived: bool,
}

impl Made {
    /// Name of the attached file.
    pub const FILE: &str = "import.json";
}

/// Writes the record of an imported run to the file `path`, which must not be there. `identity` is that of the record,
/// and `mapping` the name and the text of its mapping.
pub fn write(
    path: &Path,
    (mut identity, stage): (Identity, &Stage),
    mapping: (String, String),
    (steps, samples): (&Steps, &Samples),
) -> Result<(), RecordError> {
    let receipts = &samples.receipts;
    let moments = moments(steps, receipts);
    let begin_ns = moments.keys().next().copied().unwrap_or(0);
    // Files of times since a start of their own begin at the beginning of 1970.
    identity.anchor_ns = u64::try_from(begin_ns).unwrap_or(0);
    identity.imported = true;
    let shift_ns = identity.anchor_ns as i64 - begin_ns;
    let (name, text) = mapping;
    let (poses, Steps { resampled, derived, .. }) = (samples.poses.iter().map(Vec::len).sum(), steps);
    let made = json!(Made { poses, steps: steps.steps.len(), resampled: *resampled, derived: *derived });
    let attached = vec![
        Attached { name, media_type: "application/toml", content: text.into_bytes() },
        Attached { name: Made::FILE.to_owned(), media_type: "application/json", content: made.to_string().into() },
    ];
    let mut topics = Topics::new(stage.clone(), Scope::Simulation, identity.anchor_ns);
    let mut file = RecordFile::create(path, &Beginning { identity, attached }, stage)?;
    let mut result = Ok(());
    for (at_ns, moment) in moments {
        let now = Time::from_nanos((at_ns - begin_ns) as u64);
        let at = topics.time_of(now);
        let mut take = |topic: Topic, at: u64, data: &[u8]| {
            if result.is_ok() {
                result = file.write(stage, topic, at, data);
            }
        };
        if let Some(episode) = moment.begins {
            let said = json!({ "repeat": 0, "episode": episode, "phase": "running" });
            take(Topic::Episode, at, said.to_string().as_bytes());
        }
        for receipt in moment.receipts {
            let (sent_ns, received_ns) = (receipt.sent_ns + shift_ns, receipt.received_ns.map(|ns| ns + shift_ns));
            let said = json!(Receipt { sent_ns, received_ns, ..receipt });
            take(Topic::Receipts, at, said.to_string().as_bytes());
        }
        if !moment.steps.is_empty() {
            let samples = moment.steps.iter().map(|step| sample(step, now)).collect();
            topics.instant(now, &[Event::Truth(Truth { time: now, samples })], &mut take);
        }
    }
    let wrong = |error: McapError| RecordError::Write { path: path.to_owned(), reason: error.to_string() };
    result.and_then(|()| file.finish()).map_err(wrong)
}

/// Orders all that happens by its time \[ns\]. Receipts are at the time at which their message was sent.
fn moments(steps: &Steps, receipts: &[Receipt]) -> BTreeMap<i64, Moment> {
    let (mut moments, mut episode): (BTreeMap<i64, Moment>, Option<u32>) = (BTreeMap::new(), None);
    for step in &steps.steps {
        let moment = moments.entry(step.at_ns).or_default();
        if episode != Some(step.episode) {
            (moment.begins, episode) = (Some(step.episode), Some(step.episode));
        }
        moment.steps.push(*step);
    }
    for receipt in receipts {
        moments.entry(receipt.sent_ns).or_default().receipts.push(*receipt);
    }
    moments
}

fn sample(step: &Step, time: Time) -> Sample {
    let vector = |[x, y]: [f64; 2]| Vec2::new(x as f32, y as f32);
    Sample {
        robot: RobotId(step.robot),
        time,
        motion: Motion { position: vector(step.position), velocity: vector(step.velocity) },
        heading: step.heading as f32,
        yaw_rate: 0.0,
        command: vector(step.command),
        // The files do not say what was touched.
        contacts: Contacts { robot: step.touches, wall: false },
    }
}
