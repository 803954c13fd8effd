//! Makes steps of the samples of a run: states of the robots at the period of a fit, each with the command in force, on
//! the axes of the arena, by episodes.

use murmurate::messages::geometry::{rotated, wrapped};

use crate::mapping::{Axes, Episodes, Frame, Mapping};
use crate::samples::{Command, Pose, Samples};

/// Largest difference of the poses' usual spacing from the period, as a share of it, with which poses are steps.
const NEAR: f64 = 0.1;
/// Longest time between two poses of one stretch, in periods.
const GAP: f64 = 1.5;

/// State of a robot at a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Time of the step \[ns\].
    pub at_ns: i64,
    /// Id of the robot.
    pub robot: u16,
    /// Position \[m\], in the arena.
    pub position: [f64; 2],
    /// Velocity \[m/s\], in the arena.
    pub velocity: [f64; 2],
    /// Heading \[rad\], in the arena; 0 if it is not known.
    pub heading: f64,
    /// Command in force \[m/s\], in the arena; zero before the first one.
    pub command: [f64; 2],
    /// Whether the robot touches something.
    pub touches: bool,
    /// Number of the episode, from 0.
    pub episode: u32,
}

/// Steps of a run, and what was left out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Steps {
    /// Steps of all robots in the order of time, then of robots.
    pub steps: Vec<Step>,
    /// Number of episodes.
    pub episodes: u32,
    /// Number of poses of a time that their robot had already.
    pub repeated: usize,
    /// Whether velocities are differences of positions.
    pub derived: bool,
    /// Whether the steps lie between the poses.
    pub resampled: bool,
}

/// Makes the steps of a run. The error names the field of the mapping that does not fit it.
pub fn of(mapping: &Mapping, samples: &mut Samples) -> Result<Steps, (&'static str, String)> {
    let period_ns = mapping.period_ns();
    let mut found = Steps::default();
    for poses in &mut samples.poses {
        let before = poses.len();
        poses.sort_by_key(|pose| pose.at_ns);
        poses.dedup_by_key(|pose| pose.at_ns);
        found.repeated += before - poses.len();
    }
    samples.commands.iter_mut().for_each(|commands| commands.sort_by_key(|command| command.at_ns));
    let Some(begin_ns) = samples.poses.iter().filter_map(|poses| poses.first()).map(|pose| pose.at_ns).min() else {
        return Err(("poses", "no robot has a pose".to_owned()));
    };
    for (robot, poses) in samples.poses.iter().enumerate() {
        let resampled = is_faster(robot, poses, mapping)?;
        found.resampled |= resampled;
        let (poses, known) = if resampled {
            (&resample(poses, begin_ns, period_ns)[..], poses.iter().all(|pose| pose.velocity.is_some()))
        } else {
            (&poses[..], poses.iter().all(|pose| pose.velocity.is_some()))
        };
        found.derived |= !known;
        let commands = samples.commands.get(robot).map_or(&[][..], |commands| commands);
        found.steps.extend(of_robot(mapping, robot as u16, (poses, known), commands, begin_ns));
    }
    found.steps.sort_by_key(|step| (step.at_ns, step.robot));
    found.episodes = numbered(&mut found.steps);
    if found.steps.is_empty() {
        return Err(("episodes", "no pose belongs to one".to_owned()));
    }
    Ok(found)
}

/// Returns whether the poses of a robot come faster than the period. The error says that they come slower.
fn is_faster(robot: usize, poses: &[Pose], mapping: &Mapping) -> Result<bool, (&'static str, String)> {
    let mut spacings: Vec<i64> = poses.windows(2).map(|pair| pair[1].at_ns - pair[0].at_ns).collect();
    if spacings.is_empty() {
        return Ok(false);
    }
    let at = spacings.len() / 2;
    let usual_s = *spacings.select_nth_unstable(at).1 as f64 / 1e9;
    if usual_s > mapping.period_s * (1.0 + NEAR) {
        let name = &mapping.names[robot];
        let why = format!("poses of robot '{name}' come every {usual_s:.4} s: the period cannot be shorter");
        return Err(("period_s", why));
    }
    Ok(usual_s < mapping.period_s * (1.0 - NEAR))
}

/// Returns the poses at each period from `begin_ns` on, between those that are next to each other in time.
fn resample(poses: &[Pose], begin_ns: i64, period_ns: i64) -> Vec<Pose> {
    let mut between = Vec::new();
    for pair in poses.windows(2) {
        let (one, other) = (pair[0], pair[1]);
        let took_ns = other.at_ns - one.at_ns;
        if took_ns as f64 > GAP * period_ns as f64 || one.label != other.label {
            continue;
        }
        let first = (one.at_ns - begin_ns).div_euclid(period_ns) + i64::from((one.at_ns - begin_ns) % period_ns != 0);
        let mut at_ns = begin_ns + first * period_ns;
        while at_ns < other.at_ns {
            let part = (at_ns - one.at_ns) as f64 / took_ns as f64;
            let mix = |one: [f64; 2], other: [f64; 2]| [0, 1].map(|axis| one[axis] + part * (other[axis] - one[axis]));
            between.push(Pose {
                at_ns,
                position: mix(one.position, other.position),
                yaw: one.yaw.zip(other.yaw).map(|(one, other)| one + part * wrapped(other - one)),
                velocity: one.velocity.zip(other.velocity).map(|(one, other)| mix(one, other)),
                touches: one.touches || other.touches,
                label: one.label,
            });
            at_ns += period_ns;
        }
    }
    between
}

/// Returns the steps of one robot. `known` says whether its poses have velocities; otherwise they are the differences
/// of its positions, and the first pose of a stretch is no step.
fn of_robot(
    mapping: &Mapping,
    robot: u16,
    (poses, known): (&[Pose], bool),
    commands: &[Command],
    begin_ns: i64,
) -> Vec<Step> {
    let gap_ns = (GAP * mapping.period_ns() as f64) as i64;
    let (mut steps, mut before, mut in_force): (Vec<Step>, Option<Pose>, usize) = (Vec::new(), None, 0);
    for pose in poses {
        let last = before.replace(*pose).filter(|last| pose.at_ns - last.at_ns < gap_ns);
        let velocity = match (pose.velocity.filter(|_| known), last) {
            (Some(velocity), _) => velocity,
            (None, Some(last)) => {
                let took_s = (pose.at_ns - last.at_ns) as f64 / 1e9;
                [0, 1].map(|axis| (pose.position[axis] - last.position[axis]) / took_s)
            }
            (None, None) => continue,
        };
        while commands.get(in_force).is_some_and(|command| command.at_ns <= pose.at_ns) {
            in_force += 1;
        }
        let Some(episode) = episode(&mapping.episodes, pose, begin_ns) else { continue };
        let command = in_force.checked_sub(1).map_or([0.0; 2], |at| commands[at].velocity);
        let turn = if mapping.command_frame == Some(Frame::Body) { pose.yaw } else { Some(0.0) };
        let Some(turn) = turn else { continue };
        let Axes { turn_rad, move_m } = mapping.axes;
        let turned = |angle: f64, [x, y]: [f64; 2]| <[f64; 2]>::from(rotated(angle, x, y));
        let position = turned(turn_rad, pose.position);
        steps.push(Step {
            at_ns: pose.at_ns,
            robot,
            position: [0, 1].map(|axis| position[axis] + move_m[axis]),
            velocity: turned(turn_rad, velocity),
            heading: wrapped(pose.yaw.unwrap_or(0.0) + if pose.yaw.is_some() { turn_rad } else { 0.0 }),
            command: turned(turn_rad + turn, command),
            touches: pose.touches,
            episode,
        });
    }
    steps
}

/// Returns the number of the episode of a pose, which may have gaps; `None` if it is of none.
fn episode(episodes: &Episodes, pose: &Pose, begin_ns: i64) -> Option<u32> {
    let since_s = (pose.at_ns - begin_ns) as f64 / 1e9;
    match episodes {
        Episodes::Every(length_s) => Some((since_s / length_s) as u32),
        Episodes::Column(_) => pose.label,
        Episodes::Spans(spans) => {
            let at = spans.iter().position(|[begin, end]| (*begin..*end).contains(&since_s))?;
            u32::try_from(at).ok()
        }
    }
}

/// Numbers the episodes anew in the order of time, so that there are no gaps: a robot may bring the value of an episode
/// late, and then belongs to the one that runs. Returns their number.
fn numbered(steps: &mut [Step]) -> u32 {
    let (mut count, mut seen): (u32, std::collections::BTreeMap<u32, u32>) = (0, std::collections::BTreeMap::new());
    for step in steps {
        let number = *seen.entry(step.episode).or_insert_with(|| {
            count += 1;
            count - 1
        });
        // Episodes are told apart by the time at which they begin.
        step.episode = number.max(count - 1);
    }
    count
}
