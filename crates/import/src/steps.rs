//! Makes steps of the samples of a run: states of the robots at the period of a fit, each with the command in force, on
//! the axes of the arena, by episodes.

use murmurate::messages::geometry::{rotated, wrapped};

use crate::mapping::{Axes, Episodes, Frame, Mapping};
use crate::samples::{Command, Pose, Samples};

/// Largest difference of the poses' usual spacing from the period, as a share of it, with which poses are steps.
const NEAR: f64 = 0.02;
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
    /// Number of poses without a velocity, of robots most of whose poses have one.
    pub unmeasured: usize,
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
        let measured = poses.iter().filter(|pose| pose.velocity.is_some()).count();
        if 2 * measured > poses.len() {
            found.unmeasured += poses.len() - measured;
            poses.retain(|pose| pose.velocity.is_some());
        }
    }
    samples.commands.iter_mut().for_each(|commands| commands.sort_by_key(|command| command.at_ns));
    let Some(begin_ns) = samples.poses.iter().filter_map(|poses| poses.first()).map(|pose| pose.at_ns).min() else {
        return Err(("poses", "no robot has a pose".to_owned()));
    };
    let cuts = Cuts { episodes: &mapping.episodes, begin_ns, changes_ns: changes(&samples.poses) };
    for (robot, poses) in samples.poses.iter().enumerate() {
        let resampled = is_faster(robot, poses, mapping)?;
        found.resampled |= resampled;
        let (poses, known) = if resampled {
            (&resample(poses, &cuts, period_ns)[..], poses.iter().all(|pose| pose.velocity.is_some()))
        } else {
            (&poses[..], poses.iter().all(|pose| pose.velocity.is_some()))
        };
        found.derived |= !known;
        let commands = samples.commands.get(robot).map_or(&[][..], |commands| commands);
        found.steps.extend(of_robot(mapping, robot as u16, (poses, known), commands, &cuts));
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

/// Returns the poses at each period from the first one on, between those that are next to each other in time.
fn resample(poses: &[Pose], cuts: &Cuts, period_ns: i64) -> Vec<Pose> {
    let (mut between, begin_ns) = (Vec::new(), cuts.begin_ns);
    for pair in poses.windows(2) {
        let (one, other) = (pair[0], pair[1]);
        let took_ns = other.at_ns - one.at_ns;
        if took_ns as f64 > GAP * period_ns as f64 || !cuts.joins(&one, &other) {
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
    cuts: &Cuts,
) -> Vec<Step> {
    let gap_ns = (GAP * mapping.period_ns() as f64) as i64;
    let (mut steps, mut before, mut in_force): (Vec<Step>, Option<Pose>, usize) = (Vec::new(), None, 0);
    for pose in poses {
        let near = |last: &Pose| pose.at_ns - last.at_ns < gap_ns && cuts.joins(last, pose);
        let last = before.replace(*pose).filter(near);
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
        let Some(episode) = cuts.episode(pose) else { continue };
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

/// Division of a run into episodes, by its mapping and its times.
struct Cuts<'a> {
    episodes: &'a Episodes,
    /// Time of the first pose \[ns\].
    begin_ns: i64,
    /// Times at which the column of episodes changes \[ns\].
    changes_ns: Vec<i64>,
}

impl Cuts<'_> {
    /// Returns the number of the episode of a pose, which may have gaps; `None` if it is of none.
    fn episode(&self, pose: &Pose) -> Option<u32> {
        let since_s = (pose.at_ns - self.begin_ns) as f64 / 1e9;
        match self.episodes {
            Episodes::Every(length_s) => Some((since_s / length_s) as u32),
            // A robot may bring the value of an episode late, and then belongs to the one that runs.
            Episodes::Column(_) => {
                let begun = self.changes_ns.partition_point(|change_ns| *change_ns <= pose.at_ns);
                pose.label.and(u32::try_from(begun).ok()?.checked_sub(1))
            }
            Episodes::Spans(spans) => {
                let at = spans.iter().position(|[begin, end]| (*begin..*end).contains(&since_s))?;
                u32::try_from(at).ok()
            }
        }
    }

    /// Whether a robot drove from one pose to the other. Between two episodes it may have been carried; pieces of equal
    /// length are of one run.
    fn joins(&self, one: &Pose, other: &Pose) -> bool {
        matches!(self.episodes, Episodes::Every(_))
            || (one.label == other.label && self.episode(one) == self.episode(other))
    }
}

/// Returns the times at which the column of episodes changes \[ns\], in order: a robot brings a value that is not its
/// last one, nor that of the episode that runs. An episode ends when the column is empty for all robots.
fn changes(poses: &[Vec<Pose>]) -> Vec<i64> {
    let mut brought: Vec<(i64, usize, Option<u32>)> = Vec::new();
    for (robot, poses) in poses.iter().enumerate() {
        let first = poses.first().map(|pose| (pose.at_ns, robot, pose.label));
        let changed = poses.windows(2).filter(|pair| pair[0].label != pair[1].label);
        brought.extend(first.into_iter().chain(changed.map(|pair| (pair[1].at_ns, robot, pair[1].label))));
    }
    brought.sort_unstable();
    let (mut runs, mut changes_ns): (Option<u32>, Vec<i64>) = (None, Vec::new());
    let (mut labels, mut inside): (Vec<Option<u32>>, usize) = (vec![None; poses.len()], 0);
    for (at_ns, robot, label) in brought {
        inside = inside + usize::from(label.is_some()) - usize::from(labels[robot].is_some());
        labels[robot] = label;
        if label.is_some() && label != runs {
            runs = label;
            changes_ns.push(at_ns);
        }
        if inside == 0 {
            runs = None;
        }
    }
    changes_ns
}

/// Numbers the episodes anew in the order of time, so that there are no gaps. Returns their number.
fn numbered(steps: &mut [Step]) -> u32 {
    let (mut count, mut last) = (0, None);
    for step in steps {
        if last != Some(step.episode) {
            (count, last) = (count + 1, Some(step.episode));
        }
        step.episode = count - 1;
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;

    const MAPPING: &str = "format = \"csv\"\npath = \"run.csv\"\nrobots = 2\nperiod_s = 0.1\n\
        episodes = \"episode\"\n[poses]\ntime = \"t\"\nrobot = \"robot\"\nx = \"x\"\ny = \"y\"\n";

    fn mapping(text: &str) -> Mapping {
        Mapping::of_text(text).expect("it is sound")
    }

    /// Poses every `spacing_ms` \[ms\] of one robot that drives along x with 1 m/s, and is 100 m farther at each change
    /// of its labels.
    fn poses(labels: &[Option<u32>], spacing_ms: i64) -> Vec<Pose> {
        let mut moved_m = 0.0;
        let mut before = labels[0];
        let pose = |(label, at): (&Option<u32>, i64)| {
            if std::mem::replace(&mut before, *label) != *label {
                moved_m += 100.0;
            }
            let at_ns = at * spacing_ms * 1_000_000;
            Pose { at_ns, position: [moved_m + at_ns as f64 / 1e9, 0.0], label: *label, ..Pose::default() }
        };
        labels.iter().zip(0..).map(pose).collect()
    }

    fn steps(mapping: &Mapping, poses: Vec<Vec<Pose>>) -> Steps {
        let mut samples = Samples::of(poses.len());
        samples.poses = poses;
        of(mapping, &mut samples).expect("it is sound")
    }

    fn labels(parts: &[(Option<u32>, usize)]) -> Vec<Option<u32>> {
        parts.iter().flat_map(|(label, count)| std::iter::repeat_n(*label, *count)).collect()
    }

    #[test]
    fn a_robot_that_was_carried_between_two_episodes_did_not_drive_there() {
        for spacing_ms in [100, 30] {
            for (own, text) in [
                (labels(&[(Some(0), 21), (Some(1), 20)]), MAPPING.to_owned()),
                (labels(&[(Some(0), 20), (None, 1), (Some(1), 20)]), MAPPING.to_owned()),
            ] {
                let found = steps(&mapping(&text), vec![poses(&own, spacing_ms), Vec::new()]);
                let fast = found.steps.iter().find(|step| (step.velocity[0] - 1.0).abs() > 1e-6);
                assert_eq!((fast, found.episodes), (None, 2), "{spacing_ms}");
            }
        }
        let own = labels(&[(Some(0), 21), (Some(1), 20)]);
        let spans = MAPPING.replace("\"episode\"", "[[0.0, 2.05], [2.05, 9.0]]");
        let carried = poses(&own, 100).into_iter().map(|pose| Pose { label: Some(0), ..pose }).collect();
        let found = steps(&mapping(&spans), vec![carried, Vec::new()]);
        assert!(found.steps.iter().all(|step| (step.velocity[0] - 1.0).abs() < 1e-6), "{:?}", found.steps);
    }

    #[test]
    fn each_change_of_the_column_of_episodes_begins_one() {
        let again = labels(&[(Some(0), 10), (Some(1), 10), (Some(0), 10), (None, 5), (Some(0), 10)]);
        // The other brings each value two poses late. The first pose of an episode has no velocity.
        let late = [&[Some(0); 2][..], &again[..again.len() - 2]].concat();
        let found = steps(&mapping(MAPPING), vec![poses(&again, 100), poses(&late, 100)]);
        assert_eq!(found.episodes, 4);
        let begins: Vec<i64> = (0..4)
            .map(|episode| found.steps.iter().find(|step| step.episode == episode).expect("it has steps").at_ns)
            .collect();
        assert_eq!(begins, [1, 11, 21, 36].map(|at| at * 100_000_000));
    }

    #[test]
    fn poses_that_come_slower_than_the_period_are_refused_and_faster_ones_resampled() {
        let own = labels(&[(Some(0), 40)]);
        let mut samples = Samples::of(2);
        samples.poses[0] = poses(&own, 109);
        let (field, why) = of(&mapping(MAPPING), &mut samples).expect_err("it is slow");
        assert!(field == "period_s" && why.contains("0.1090"), "{why}");
        for (spacing_ms, resampled) in [(95, true), (99, false), (101, false)] {
            assert_eq!(steps(&mapping(MAPPING), vec![poses(&own, spacing_ms), Vec::new()]).resampled, resampled);
        }
    }

    #[test]
    fn one_pose_without_a_velocity_is_left_out_and_the_others_keep_theirs() {
        let mut own = poses(&labels(&[(Some(0), 40)]), 100);
        own.iter_mut().for_each(|pose| pose.velocity = Some([2.0, 0.0]));
        own[7].velocity = None;
        let found = steps(&mapping(MAPPING), vec![own, Vec::new()]);
        assert_eq!((found.unmeasured, found.derived, found.steps.len()), (1, false, 39));
        assert!(found.steps.iter().all(|step| step.velocity == [2.0, 0.0]));
    }
}
