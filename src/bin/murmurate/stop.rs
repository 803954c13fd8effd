//! `murmurate stop`: the team's emergency stop, engaged or taken back, and who has confirmed it.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;
use std::time::Instant;

use anyhow::{Result, anyhow};
use murmurate::actors::network;
use murmurate::actors::operator::{OPERATOR, Operator, wire};
use murmurate::actors::process::Heard;
use murmurate::actors::real::run_real;
use murmurate::deploy::team::{Team, TeamFile, Transport};
use murmurate::messages::ids::{HostId, LinkId, RobotId};
use murmurate::messages::latch::Latch;
use murmurate::messages::wire::{Kind, Stop, Wire};
use murmurate::net::key::Key;
use murmurate::time::{Span, Time};

use crate::output::print;
use crate::{BadInput, Ended, links, team};

/// How often it is said.
const PERIOD: Span = Span::from_millis(20);
/// How long it is said at least: whoever comes late or has missed it hears it, too.
const AT_LEAST: Span = Span::from_millis(500);
/// How long robots have to confirm it.
const PATIENCE: Span = Span::from_millis(3000);

/// Flags of `murmurate stop`.
#[derive(clap::Args)]
#[command(
    after_help = "Exit codes: 0 every robot has confirmed it; 1 some have not, and are named; 2 a flag, the team \
    file or the key is wrong."
)]
pub struct Args {
    #[command(flatten)]
    team: team::TeamArgs,
    /// Takes the emergency stop back: robots may move again
    #[arg(long)]
    rearm: bool,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

/// What the robots have said of the stop.
#[derive(Default)]
struct Said {
    robots: BTreeMap<RobotId, Latch>,
    latest: Latch,
}

impl Said {
    fn hear(&mut self, message: &Wire) {
        match message {
            Wire::Heartbeat(beat) => {
                self.robots.insert(beat.robot, beat.latch);
                self.latest = self.latest.joined(beat.latch);
            }
            Wire::Mode(mode) => self.latest = self.latest.joined(mode.latch),
            _ => {}
        }
    }
}

/// Says it until every robot has confirmed it.
pub fn run(args: &Args) -> Result<Ended> {
    let file = args.team.read()?;
    let (team, link) = listening_post(args, &file)?;
    let key = team::key(&team)?.map(Key::new);
    let sockets = links::open(&team, OPERATOR)?.into_iter().filter(|(id, _)| *id == link).collect();
    let robots = team.deployment.robots;
    let only = team.links.iter().enumerate().map(|(at, place)| place.as_ref().filter(|_| at == usize::from(link.0)));
    let operator = Operator {
        id: OPERATOR,
        team: team.number,
        robots,
        incarnation: links::incarnation(),
        key,
        links: links::setups(&team, only),
        sockets,
        stop: Some(link),
    };
    let said = Rc::new(RefCell::new(Said::default()));
    let confirmed = |said: &Said| said.robots.values().filter(|latch| latch.is_engaged() != args.rearm).count();
    let (mut next, mut took) = (Time::ZERO, None);
    run_real(
        Instant::now(),
        |clock, readers| {
            let hear = Rc::clone(&said);
            let network = wire((clock, readers), operator, move |heard| {
                if let Heard::Message(message) = heard {
                    hear.borrow_mut().hear(message);
                }
            });
            // A turn at least so often, whatever arrives.
            for beat in 0..=PATIENCE.as_nanos() / PERIOD.as_nanos() {
                clock.call(Time::ZERO + PERIOD * beat, Box::new(|| {}));
            }
            network
        },
        |network, now| {
            let said = said.borrow();
            if confirmed(&said) == robots && took.is_none() {
                took = Some(now);
            }
            if now >= next && (took.is_none() || now.since(Time::ZERO) < AT_LEAST) {
                next = now + PERIOD;
                // A re-arm has to be later than the stop that it takes back, so that has to be known first.
                if !args.rearm {
                    network.send(network::In::Publish(Wire::Stop(Stop::engage(OPERATOR, Latch::default()))));
                } else if said.latest.is_engaged() {
                    network.send(network::In::Publish(Wire::Stop(Stop::rearm(OPERATOR, said.latest))));
                }
            }
            let waited = now.since(Time::ZERO);
            waited >= PATIENCE || (took.is_some() && waited >= AT_LEAST)
        },
    );
    let said = said.borrow();
    let missing: Vec<u16> = RobotId::team(robots)
        .filter(|robot| said.robots.get(robot).is_none_or(|latch| latch.is_engaged() == args.rearm))
        .map(|robot| robot.0)
        .collect();
    let what = if args.rearm { "are armed" } else { "stand" };
    if args.json {
        let took_s = took.map(Time::as_secs);
        let state = if args.rearm { "armed" } else { "stopped" };
        print(
            &serde_json::json!({"state": state, "robots": robots, "missing": missing, "took_s": took_s}).to_string(),
        )?;
    } else {
        print(&format!("{} of {robots} robots {what}", robots - missing.len()))?;
    }
    if missing.is_empty() {
        return Ok(Ended::Done);
    }
    let names: Vec<String> = missing.iter().map(u16::to_string).collect();
    Err(anyhow!("no word from robot {}: go and look at them", names.join(", ")))
}

/// A host whose link carries the stop, as this machine would be it, and the link.
fn listening_post(args: &Args, file: &TeamFile) -> Result<(Team, LinkId)> {
    let carries = |link: &murmurate::deploy::Link| link.carries.contains(&Kind::Stop);
    let at = file.deployment().links.iter().position(carries);
    let at = at.ok_or_else(|| BadInput("no link of this team carries 'stop'; it runs in one process".to_owned()))?;
    let hosts: Vec<HostId> = file.hosts().collect();
    for host in hosts {
        let team = args.team.for_host(file, host)?;
        match team.links[at].as_ref().map(|socket| &socket.transport) {
            Some(Transport::Multicast { .. }) => {
                return Ok((team, LinkId(u16::try_from(at).expect("links are counted in u16"))));
            }
            Some(Transport::Unicast { .. }) => {
                let name = &file.deployment().links[at].name;
                let why = format!(
                    "link '{name}' is unicast: its hosts hear nobody else; send SIGTERM to any 'murmurate host' of \
                     the team instead"
                );
                return Err(BadInput(why).into());
            }
            None => {}
        }
    }
    Err(BadInput("no host of this team listens where 'stop' is said".to_owned()).into())
}
