//! The command `murmurate place`: tells the host that measures a robot where the robot stands, and prints its answer.

use std::cell::Cell;
use std::rc::Rc;
use std::time::Instant;

use anyhow::{Result, anyhow};
use murmurate::graph::operator;
use murmurate::messages::geometry::{MAX_HEADING, MAX_SIZE, Pose, Vec2, wrapped};
use murmurate::messages::ids::RobotId;
use murmurate::messages::place::{Place, PlaceAnswer, Placed};
use murmurate::registry::Registry;
use murmurate::runtime::real::run_real;
use murmurate::time::{Span, Time};

use crate::output::print;
use crate::team;
use crate::{Ended, bad};

/// Longest time for which the statement is repeated until the robot's host has answered.
const WAIT: Span = Span::from_millis(3000);
/// Largest heading that a user may give \[rad\]: a full turn, with room for rounding.
const TURN_RAD: f64 = 7.0;

/// Says where a robot stands whose pose has jumped, or whose odometry has begun anew.
#[derive(clap::Args)]
#[command(after_help = "Runs on any machine that reaches the link which carries 'stop'; no other link is opened.\n\
    Exit codes: 0 the robot's host has taken it over; 1 it has refused it, or has not answered, and why; 2 a flag, the \
    team file or the key is wrong.")]
pub struct Args {
    #[command(flatten)]
    team: team::TeamArgs,
    /// Number of the robot, which has to stand
    #[arg(long, value_name = "N")]
    robot: u16,
    /// Position of the robot's centre in the world frame [m]
    #[arg(long, num_args = 2, value_names = ["X", "Y"], allow_negative_numbers = true, required = true)]
    at: Vec<f64>,
    /// Heading of the robot, counter-clockwise from the x axis [rad]
    #[arg(long, value_name = "H", allow_negative_numbers = true)]
    heading: f64,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

impl Args {
    /// Returns the pose that the flags give. An error names the flag.
    fn pose(&self) -> Result<Pose> {
        let [x, y] = self.at[..] else { return bad("--at: give two numbers, X and Y".to_owned()) };
        if !(x.abs() <= f64::from(MAX_SIZE) && y.abs() <= f64::from(MAX_SIZE)) {
            return bad(format!("--at: {x} {y} is not within 100 km of the origin"));
        }
        if !(-TURN_RAD..=TURN_RAD).contains(&self.heading) {
            return bad(format!("--heading: {} is no angle in radians, -{TURN_RAD} to {TURN_RAD}", self.heading));
        }
        let heading = (wrapped(self.heading) as f32).clamp(-MAX_HEADING, MAX_HEADING);
        Ok(Pose { position: Vec2::new(x as f32, y as f32), heading: Some(heading) })
    }
}

/// Runs `place`: sends where the robot stands until the host that measures it has answered, and prints the answer.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let pose = args.pose()?;
    let file = args.team.read(registry)?;
    let deployment = file.deployment();
    let robot = RobotId(args.robot);
    let measures = deployment.hosts.iter().find(|host| host.localizes.contains(&robot.0));
    let Some(host) = measures.map(|host| host.name.clone()) else {
        let why = match robot.index() < deployment.robots {
            true => format!("--robot: {robot} is simulated: its World knows where it is"),
            false => format!("--robot: there is no robot {}; the team has 0 to {}", robot.0, deployment.robots - 1),
        };
        return bad(why);
    };
    let operator = args.team.operator(&file)?;
    let me = operator.end.me;
    let place = Place { by: me.host, number: me.incarnation, robot, pose };
    let answer: Rc<Cell<Option<Placed>>> = Rc::default();
    let heard = Rc::clone(&answer);
    run_real(
        Instant::now(),
        |clock, readers| operator::place((clock, readers), operator, place, &heard),
        |(), now| answer.get().is_some() || now.since(Time::ZERO) >= WAIT,
    );
    report(args, &host, answer.get())
}

/// Prints the answer of the host `host` about the robot. Fails with the reason if the statement has not taken effect.
fn report(args: &Args, host: &str, answer: Option<Placed>) -> Result<Ended> {
    let (robot, why) = (RobotId(args.robot), why(args.robot, host, answer));
    let taken = answer.filter(|answer| answer.verdict.is_taken());
    if args.json {
        let measured = answer
            .and_then(|answer| answer.measured)
            .map(|pose| serde_json::json!({ "x": pose.position.x, "y": pose.position.y, "heading": pose.heading }));
        let verdict = answer.map(|answer| answer.verdict.word());
        let said = serde_json::json!({
            "robot": robot.0, "placed": taken.is_some(), "answer": verdict, "measured": measured, "why": why,
        });
        print(&said.to_string())?;
    } else if let Some(answer) = taken {
        let at = format!("{} {}, heading {}", args.at[0], args.at[1], args.heading);
        print(&match answer.verdict {
            PlaceAnswer::Aligned => format!("{robot} is at {at}: host '{host}' counts from there until it ends"),
            _ => format!("{robot} is at {at}: the source of host '{host}' agrees"),
        })?;
    }
    why.map_or(Ok(Ended::Done), |why| Err(anyhow!(why)))
}

/// Returns the reason why the statement about robot `robot` has not taken effect; `None` if it has.
fn why(robot: u16, host: &str, answer: Option<Placed>) -> Option<String> {
    let Some(Placed { verdict, measured, .. }) = answer else {
        return Some(format!(
            "host '{host}', which measures robot {robot}, does not answer: does it run with this key, is its link up?"
        ));
    };
    let seen = measured.map_or_else(String::new, |pose| {
        let heading = pose.heading.map_or_else(String::new, |heading| format!(", heading {heading:.2}"));
        format!(" at {:.2} {:.2}{heading}", pose.position.x, pose.position.y)
    });
    match verdict {
        PlaceAnswer::Aligned | PlaceAnswer::Agrees => None,
        PlaceAnswer::Moves => {
            Some(format!("refused: robot {robot} moves; stop it, wait half a second, then look again"))
        }
        PlaceAnswer::Unmeasured => Some(format!(
            "refused: host '{host}' has measured nothing of robot {robot} for a second: see its source and its driver"
        )),
        PlaceAnswer::Other => {
            Some(format!("refused by host '{host}' for a reason that only a later version knows: see its log"))
        }
        PlaceAnswer::Differs => Some(format!(
            "refused: the source of host '{host}' measures robot {robot}{seen}; correct the source, or look again"
        )),
    }
}
