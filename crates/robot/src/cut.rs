//! The command `murmurate cut`: switches off the motors of robots that fly, in a team that is stopped, and reports
//! which are off.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::rc::Rc;
use std::time::Instant;

use anyhow::{Result, anyhow};
use murmurate::config::shown::counted;
use murmurate::graph::operator::{self, Operator};
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::Flight;
use murmurate::registry::Registry;
use murmurate::runtime::real::run_real;
use murmurate::time::{Span, Time};

use crate::output::{confirmed, print};
use crate::team;
use crate::{Ended, bad, own_name};

/// Longest time for which the order is repeated until all robots say that their motors are off.
const WAIT: Span = Span::from_millis(3000);

/// Switches off the motors of robots that fly: those in the air fall.
#[derive(clap::Args)]
#[command(
    after_help = "The team has to be stopped first ('stop'), after which robots hover and land by themselves. This is \
    for a robot that does not.\nExit codes: 0 all motors are off; 1 some are not, and are named; 2 a flag, the team \
    file or the key is wrong, or it was not confirmed."
)]
pub struct Args {
    #[command(flatten)]
    team: team::TeamArgs,
    /// Number of the only robot that is meant; without it, all that fly
    #[arg(long, value_name = "N")]
    robot: Option<u16>,
    /// Confirms it without a question
    #[arg(long)]
    yes: bool,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

/// State of the flight of each robot that is meant; `None` before it has said any.
type Flights = Rc<RefCell<BTreeMap<RobotId, Option<Flight>>>>;

/// Runs `cut`: sends the order until all robots that are meant say that they are on the ground with their motors off.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let file = args.team.read(registry)?;
    let deployment = file.deployment();
    let flies = |robot: &RobotId| deployment.flight(*robot).is_some();
    let meant = |robot: &RobotId| args.robot.is_none_or(|only| only == robot.0);
    let robots: Vec<RobotId> = RobotId::team(deployment.robots).filter(flies).filter(meant).collect();
    match (robots.is_empty(), args.robot) {
        (true, Some(robot)) => return bad(format!("--robot: there is no robot {robot} in this team that flies")),
        (true, None) => return bad("no robot of this team flies: none has a height_m".to_owned()),
        (false, _) => {}
    }
    if !args.yes && !confirm(&robots)? {
        return bad("not confirmed: nothing was sent".to_owned());
    }
    let operator: Operator = args.team.operator(&file)?;
    let flights: Flights = Rc::new(RefCell::new(robots.iter().map(|robot| (*robot, None)).collect()));
    let heard = Rc::clone(&flights);
    let off = |flights: &Flights| flights.borrow().values().all(|flight| *flight == Some(Flight::Grounded));
    run_real(
        Instant::now(),
        |clock, readers| operator::cut((clock, readers), operator, robots, heard),
        |(), now| off(&flights) || now.since(Time::ZERO) >= WAIT,
    );
    report(args, &flights)
}

/// Asks on the terminal whether the motors may be switched off. It is an error if there is no terminal.
fn confirm(robots: &[RobotId]) -> Result<bool> {
    if !std::io::stdin().is_terminal() {
        return bad("it lets robots fall: confirm it by --yes, or on a terminal".to_owned());
    }
    let numbers = list(robots.iter().map(|robot| robot.0));
    Ok(confirmed(&format!("the motors of robots {numbers} will be off at once, and those in the air fall. Sure?"))?)
}

/// Returns the numbers of robots as text.
fn list(robots: impl IntoIterator<Item = u16>) -> String {
    robots.into_iter().map(|robot| robot.to_string()).collect::<Vec<_>>().join(", ")
}

/// Prints whose motors are off. Fails with the robots whose motors are not, and what may be the matter.
fn report(args: &Args, flights: &Flights) -> Result<Ended> {
    let flights = flights.borrow();
    let of = |wanted: fn(&Option<Flight>) -> bool| -> Vec<u16> {
        flights.iter().filter(|(_, flight)| wanted(flight)).map(|(robot, _)| robot.0).collect()
    };
    let (silent, on) = (of(Option::is_none), of(|flight| flight.is_some_and(|flight| flight != Flight::Grounded)));
    if args.json {
        print(&serde_json::json!({ "robots": flights.len(), "on": on, "silent": silent }).to_string())?;
    } else {
        let off = flights.len() - silent.len() - on.len();
        print(&format!("the motors of {off} of {} are off", counted(flights.len(), "robot")))?;
    }
    let mut why = Vec::new();
    if !on.is_empty() {
        let first = format!("is the team stopped? '{} stop' comes first", own_name());
        why.push(format!("the motors of robot {} are on: {first}", list(on)));
    }
    if !silent.is_empty() {
        why.push(format!("no answer from robot {}: does its host run with this key?", list(silent)));
    }
    if why.is_empty() { Ok(Ended::Done) } else { Err(anyhow!(why.join("; "))) }
}
