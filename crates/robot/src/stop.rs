//! The commands `murmurate stop` and `murmurate resume`: engage or re-arm the team's emergency stop, end the hold after
//! it, and report which robots have confirmed.

use std::cell::RefCell;
use std::rc::Rc;
use std::time::{Duration, Instant};

use anyhow::{Result, anyhow};
use murmurate::actors::order::{Order, OrderKind, PERIOD, Unconfirmed};
use murmurate::config::shown::{self, counted};
use murmurate::deploy::team::TeamFile;
use murmurate::graph::operator::{self, Operator};
use murmurate::live::links::LinkError;
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::Hindrance;
use murmurate::registry::Registry;
use murmurate::runtime::real::run_real;
use murmurate::time::{Span, Time};

use crate::output::{print, talk};
use crate::own_name;
use crate::team;
use crate::{Ended, bad};

/// Shortest time for which the command repeats its order (stop, re-arm or resume), so that hosts that start late or
/// have missed it receive it.
const AT_LEAST: Span = Span::from_millis(500);
/// Default of the longest time that the command waits for all robots to confirm its order \[s\].
const WAIT_S: f64 = 3.0;
/// Longest wait that a user may ask for \[s\].
const LONGEST_WAIT_S: f64 = 60.0;

/// Time between two attempts to join the team.
const RETRY: Duration = Duration::from_millis(100);

/// Engages a team's emergency stop, or takes it back with --rearm.
#[derive(clap::Args)]
#[command(after_help = "Runs on any machine that reaches the link which carries 'stop'; no other link is opened.\n\
    Exit codes: 0 every robot has confirmed it; 1 some have not, and are named; 2 a flag, the team file or the key is \
    wrong.")]
pub struct Args {
    #[command(flatten)]
    team: team::TeamArgs,
    /// Re-arms after an emergency stop; robots stand still until 'murmurate resume'
    #[arg(long)]
    rearm: bool,
    #[command(flatten)]
    wait: Wait,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

/// How long an order is repeated to a team.
#[derive(clap::Args)]
struct Wait {
    /// Longest time for which the order is repeated, until every robot has confirmed it, 0.5 to 60 [s]; for links that
    /// lose much or come about late, such as Zenoh's
    #[arg(long, value_name = "SECONDS", default_value_t = WAIT_S)]
    wait: f64,
}

impl Wait {
    fn span(&self) -> Result<Span> {
        let (least, most) = (AT_LEAST.as_secs(), LONGEST_WAIT_S);
        match (least..=most).contains(&self.wait) {
            true => Ok(Span::from_secs(self.wait)),
            false => bad(format!("--wait: {} is not {least} to {most} seconds", self.wait)),
        }
    }
}

/// Lets a team go on that was stopped and re-armed: the next episode begins.
#[derive(clap::Args)]
#[command(
    after_help = "Exit codes: 0 the team goes on; 1 it does not, and why; 2 a flag, the team file or the key is \
    wrong."
)]
pub struct ResumeArgs {
    #[command(flatten)]
    team: team::TeamArgs,
    #[command(flatten)]
    wait: Wait,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

/// Runs `stop`: engages the team's emergency stop, or re-arms it if `--rearm` is given, and prints which robots have
/// confirmed.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let kind = if args.rearm { OrderKind::Rearm } else { OrderKind::Stop };
    Asked { team: &args.team, kind, wait: args.wait.span()?, json: args.json }.run(registry)
}

/// Runs `resume`: lets a team go on that was re-armed after an emergency stop, and prints which robots have confirmed.
pub fn resume(args: &ResumeArgs, registry: &Registry) -> Result<Ended> {
    Asked { team: &args.team, kind: OrderKind::Resume, wait: args.wait.span()?, json: args.json }.run(registry)
}

/// Order of the user to a team: emergency stop, re-arm or resume.
struct Asked<'a> {
    team: &'a team::TeamArgs,
    kind: OrderKind,
    wait: Span,
    json: bool,
}

impl Asked<'_> {
    fn run(&self, registry: &Registry) -> Result<Ended> {
        let file = self.team.read(registry)?;
        let operator = self.operator(&file)?;
        let robots = operator.robots;
        let order = Rc::new(RefCell::new(Order::new(operator.end.me.host, self.kind, robots)));
        run_real(
            Instant::now(),
            |clock, readers| {
                operator::command((clock, readers), operator, &order);
                // Timers that make the event loop check the end of the wait at least this often.
                for beat in 0..=self.wait.as_nanos() / PERIOD.as_nanos() {
                    clock.call(Time::ZERO + PERIOD * beat, Box::new(|| {}));
                }
            },
            |(), now| {
                let waited = now.since(Time::ZERO);
                waited >= self.wait || (order.borrow().confirmed_at().is_some() && waited >= AT_LEAST)
            },
        );
        let order = order.borrow();
        self.report(&order, robots)
    }

    /// Joins the team as an operator. While no network interface is fit, it tries again for as long as the user would
    /// wait for an answer, and says so once.
    fn operator(&self, file: &TeamFile) -> Result<Operator> {
        let begun = Instant::now();
        let mut said = false;
        loop {
            match self.team.operator(file) {
                Err(error)
                    if matches!(error.downcast_ref(), Some(LinkError::NotNow(_)))
                        && begun.elapsed().as_secs_f64() < self.wait.as_secs() =>
                {
                    if !std::mem::replace(&mut said, true) {
                        talk(&format!("nothing is sent yet, trying for {} s: {error}", self.wait.as_secs()));
                    }
                    std::thread::park_timeout(RETRY);
                }
                opened => return opened,
            }
        }
    }

    /// Prints how many robots have confirmed the order. Fails with the reason if not all have.
    fn report(&self, order: &Order, robots: usize) -> Result<Ended> {
        let unconfirmed = order.unconfirmed();
        let took_s = order.confirmed_at().map(Time::as_secs);
        let state = order.latch().map_or("unknown", |latch| latch.word());
        if self.json {
            let missing: Vec<u16> = unconfirmed.iter().map(|(robot, _)| robot.0).collect();
            let said = serde_json::json!({
                "state": state, "robots": robots, "missing": missing, "took_s": took_s, "why": self.why(order),
            });
            print(&said.to_string())?;
        } else {
            let what = match self.kind {
                OrderKind::Stop => "stand",
                OrderKind::Rearm => "are re-armed",
                OrderKind::Hold => "are held",
                OrderKind::Resume => "may move",
            };
            let took = took_s.map_or_else(String::new, |s| format!(", confirmed after {s:.3} s"));
            let robots_all = counted(robots, "robot");
            print(&format!("{} of {robots_all} {what}{took}", robots - unconfirmed.len()))?;
            if self.kind == OrderKind::Rearm && took_s.is_some() && state == "held" {
                let file = shown::value(self.team.path().display());
                print(&format!("the team is held: '{} resume {file}' starts the next episode", own_name()))?;
            }
        }
        match self.why(order) {
            None => Ok(Ended::Done),
            Some(why) => Err(anyhow!(why)),
        }
    }

    /// Returns what may be the matter if robots say nothing: that their hosts have another key than this command, or
    /// that nothing of the team is heard here. `None` if others are heard and no datagram has another key.
    fn unheard(&self, order: &Order) -> Option<String> {
        let links = order.links();
        if let Some(trouble) = links.key_trouble() {
            return Some(trouble.to_owned());
        }
        if links.other_key + links.untagged + links.keyed + links.confidential > 0 {
            return Some("some hosts of this team have another key than the others, or none".to_owned());
        }
        let advice = "nothing of this team is heard: is this machine on its network, and has it the key of its hosts? \
                      compare the fingerprints that 'doctor' shows";
        (links.accepted == 0).then(|| advice.to_owned())
    }

    /// Returns the reason why the order is not confirmed by all, with the robots concerned; `None` if it is.
    fn why(&self, order: &Order) -> Option<String> {
        if order.confirmed_at().is_some() {
            return None;
        }
        let names = |all: &[(RobotId, Unconfirmed)], of: &[Unconfirmed]| -> String {
            let robots = all.iter().filter(|(_, reason)| of.contains(reason)).map(|(robot, _)| robot.0.to_string());
            robots.collect::<Vec<_>>().join(", ")
        };
        let unconfirmed = order.unconfirmed();
        if order.is_superseded() {
            let state = order.latch().map_or("unknown", |latch| latch.word());
            return Some(format!(
                "overtaken: another operator or host has changed the latch meanwhile; the team is now {state}"
            ));
        }
        let silent = names(&unconfirmed, &[Unconfirmed::Silent]);
        let mut why = Vec::new();
        if self.kind == OrderKind::Resume {
            match order.latch() {
                Some(latch) if latch.is_engaged() => {
                    let first = format!("'{} stop --rearm' takes that back first", own_name());
                    why.push(format!("refused: the team is stopped; {first}"));
                }
                _ if !order.hindrances().is_empty() => {
                    let of = |(robot, hindrance): &(RobotId, Hindrance)| match hindrance {
                        Hindrance::Missing => format!("{robot} is missing"),
                        Hindrance::Left => format!("the host of {robot} has left"),
                        Hindrance::Latched => format!("{robot} is still latched"),
                        Hindrance::Unequal => {
                            format!("the host of {robot} has another version of the program: install one on all")
                        }
                        Hindrance::Policy => {
                            format!("{robot} runs another policy: give all hosts the same policy file")
                        }
                        Hindrance::Task => {
                            format!("the host of {robot} has another task file: give all hosts the same")
                        }
                        Hindrance::Other => format!("{robot}, for a reason that only a later version knows"),
                    };
                    let all: Vec<String> = order.hindrances().iter().map(of).collect();
                    why.push(format!("refused: {}", all.join(", ")));
                }
                _ => {}
            }
        }
        if !silent.is_empty() {
            why.push(format!("no answer from robot {silent}: look at the robot"));
            why.extend(self.unheard(order));
        }
        let (bodies, controllers) = (
            names(&unconfirmed, &[Unconfirmed::Body, Unconfirmed::Both]),
            names(&unconfirmed, &[Unconfirmed::Controller]),
        );
        if !bodies.is_empty() && self.kind == OrderKind::Stop {
            why.push(format!("the motors of robot {bodies} have not confirmed: look at the robot"));
        }
        if !controllers.is_empty() && self.kind == OrderKind::Stop {
            why.push(format!("robot {controllers} stands, but its controller has not confirmed"));
        }
        if self.kind != OrderKind::Stop && order.leading().is_none() {
            why.push("no answer from the state server: is its host running?".to_owned());
        }
        if why.is_empty() {
            why.push(format!(
                "robot {} has not followed yet: try again",
                names(&unconfirmed, &[Unconfirmed::Both, Unconfirmed::Body, Unconfirmed::Controller])
            ));
        }
        Some(why.join("; "))
    }
}
