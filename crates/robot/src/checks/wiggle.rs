//! Drive of each robot of one host 10 cm and back: its settings, and the findings about whether it moved correctly.

use anyhow::Result;
use murmurate::actors::drive_check::{Axes, DriveCheck};
use murmurate::actors::wiggle::{Config, Driven, SPEED_M_S};
use murmurate::deploy::team::Team;
use murmurate::graph::COMMAND_VALIDITY;
use murmurate::messages::ids::RobotId;
use murmurate::registry::Registry;
use murmurate::safety::filter;
use murmurate::time::Span;

use super::finding::{Found, Subject};
use super::host_of;
use crate::{BadInput, team};
use murmurate::fitness::Fitness;

/// Period of motor commands: that of policies.
const PERIOD: Span = Span::from_millis(50);

/// Returns the configuration of the wiggle (the short drive of each robot) for the host `team.host`: its robots, their
/// guard, and the arena, which has no walls if the robots are measured by their odometry only.
pub fn config(team: &Team, registry: &Registry) -> Result<Config> {
    let scenario = team::scenario(team, registry)?;
    let host = host_of(team);
    let mut arena = scenario.arena().clone();
    if host.source.is_none() {
        // The walls are unknown in the frame of a robot's odometry.
        arena.keep_outs.clear();
    }
    let guard = filter::Settings {
        safety: team.safety,
        half_extent: arena.half_extent,
        walls: arena.keep_outs.as_slice().into(),
        movers: Default::default(),
        limit_m_s: SPEED_M_S,
        clamp: team.simulated.clamp,
        period: PERIOD,
    };
    let driven = |&robot: &u16| -> Result<Driven> {
        let (robot, driver) = (RobotId(robot), host.driver.as_ref().expect("a checked host that actuates has one"));
        let parts = registry.driver(driver, robot).map_err(|e| BadInput(e.to_string()))?;
        let limit_m_s = (parts.driver)().limits().speed_m_s;
        Ok(Driven { robot, chassis: team.deployment.chassis(robot), limit_m_s })
    };
    let robots = host.actuates.iter().map(driven).collect::<Result<_>>()?;
    Ok(Config { robots, guard, arena, valid_for: COMMAND_VALIDITY })
}

/// Returns the finding that the whole wiggle has failed, or was not run, for the reason `why`.
pub fn failed(why: &str, advice: &str) -> Found {
    (Fitness::Fail, Subject::General("wiggle".to_owned()), why.to_owned(), advice.to_owned())
}

/// Returns the finding about a robot that was to be driven, from the judgement `verdict` of its motion. `localizes` is
/// true if a source measured the motion, and not the robot's odometry.
pub fn finding(robot: RobotId, verdict: &DriveCheck, localizes: bool) -> Found {
    let (status, said, advice) = words(robot, verdict);
    let frame = if localizes || status != Fitness::Ok { "" } else { ", by its own odometry" };
    (status, Subject::General(format!("{robot}, wiggle")), format!("{said}{frame}"), advice)
}

fn names(robots: &[RobotId]) -> String {
    robots.iter().map(RobotId::to_string).collect::<Vec<_>>().join(", ")
}

fn words(robot: RobotId, verdict: &DriveCheck) -> (Fitness, String, String) {
    let fail = |said: String, advice: &str| (Fitness::Fail, said, advice.to_owned());
    match verdict {
        DriveCheck::Right(distance, off) => {
            let (cm, degrees) = (distance * 100.0, off.abs().to_degrees());
            (Fitness::Ok, format!("went {cm:.1} cm, {degrees:.0} degrees off, and back"), String::new())
        }
        DriveCheck::Unseen => fail("no reading of it: it stands".to_owned(), "see its source above"),
        DriveCheck::Unfit(why) => {
            let why = why.as_deref().map_or(String::new(), |why| format!(": {why}"));
            fail(format!("was not driven{why}"), "see its driver above")
        }
        DriveCheck::Noisy(noise) => {
            let cm = noise * 100.0;
            let said =
                format!("was not driven: it seems to move by {cm:.0} cm while it stands, too much to judge 10 cm");
            fail(said, "does it stand? else look at the tracker")
        }
        DriveCheck::NoRoom => fail(
            "was not driven: there is no room in any direction".to_owned(),
            "put it inside the scenario's ground, away from walls and other robots",
        ),
        DriveCheck::Still(others) if others.is_empty() => fail(
            "was driven, and no robot moved".to_owned(),
            "are its motors on, and is its heading measured? without one, it stands",
        ),
        DriveCheck::Still(others) => fail(
            format!("{robot} was driven, {} moved", names(others)),
            "are their addresses swapped, or their names in the tracker?",
        ),
        DriveCheck::Together(others) => {
            fail(format!("{robot} was driven, and {} moved, too", names(others)), "do they listen to one address?")
        }
        DriveCheck::Astray(axes, off) => {
            let (degrees, side) = (off.abs().to_degrees(), if *off > 0.0 { "left" } else { "right" });
            let said = format!("went {degrees:.0} degrees to the {side} of where it should{}", mistake(*axes));
            fail(said, "correct the axes of its driver, or of its source")
        }
        DriveCheck::Distance(distance) => {
            let cm = distance * 100.0;
            fail(format!("went {cm:.1} cm instead of 10 cm"), "are its speeds in m/s, and positions in m?")
        }
        DriveCheck::Held(why) => {
            fail(format!("its guard has stopped or slowed it: {why}"), "docs/safety.md has each cause")
        }
    }
}

fn mistake(axes: Axes) -> &'static str {
    match axes {
        Axes::Right => "",
        Axes::MirroredX => ", as with the sign of x wrong",
        Axes::MirroredY => ", as with the sign of y wrong",
        Axes::Reversed => ", as with both signs wrong",
        Axes::Swapped => ", as with x and y swapped",
        Axes::Left => ", as if turned a quarter to the left",
        Axes::RightTurn => ", as if turned a quarter to the right",
        Axes::SwappedReversed => ", as with x and y swapped and both signs wrong",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_finding_says_what_moved_and_by_what_it_was_measured() {
        let robot = RobotId(3);
        let of = |verdict: &DriveCheck, localizes| finding(robot, verdict, localizes);
        let (status, what, said, _) = of(&DriveCheck::Right(0.1, 0.0), true);
        assert_eq!((status, what.to_string()), (Fitness::Ok, "robot 3, wiggle".to_owned()));
        assert_eq!(said, "went 10.0 cm, 0 degrees off, and back");
        assert!(of(&DriveCheck::Right(0.1, 0.0), false).2.ends_with(", by its own odometry"));
        let (status, _, said, advice) = of(&DriveCheck::Still(vec![RobotId(4)]), true);
        assert_eq!((status, &*said), (Fitness::Fail, "robot 3 was driven, robot 4 moved"));
        assert!(advice.contains("swapped"), "{advice}");
        let (_, _, said, advice) = of(&DriveCheck::Astray(Axes::Swapped, 1.57), true);
        assert!(said.ends_with("to the left of where it should, as with x and y swapped"), "{said}");
        assert!(advice.contains("axes"), "{advice}");
    }
}
