//! The command `key spread`: gives a roster to a running team as an operator, and says which members have it.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::rc::Rc;
use std::time::Instant;

use anyhow::{Result, anyhow};
use murmurate::actors::network;
use murmurate::graph::event::Event;
use murmurate::graph::operator;
use murmurate::messages::ids::HostId;
use murmurate::messages::wire::{Stop, Wire};
use murmurate::net::protocol::key::Key;
use murmurate::net::protocol::roster::{self, Roster};
use murmurate::registry::Registry;
use murmurate::runtime::clock::Clock;
use murmurate::runtime::real::run_real;
use murmurate::runtime::shell::Mailbox;
use murmurate::time::{Span, Time};

use crate::output::print;
use crate::team::{self, TeamArgs};
use crate::{Ended, bad, own_name};

/// Period at which hosts are asked, with the new keys, whether they are there.
const ASK_PERIOD: Span = Span::from_millis(100);
/// Largest roster file \[bytes\].
const MOST: usize = 4096;

/// Flags of `key spread`.
#[derive(clap::Args)]
#[command(
    after_help = "Exit codes: 0 every host of the team has it; 1 some have not answered, and are named; they get it \
    from the others when they are heard again; 2 a flag, a file or the key is wrong."
)]
pub struct Spread {
    #[command(flatten)]
    team: TeamArgs,
    /// Roster, as `key revoke`, `key add` or `key rotate` has made it
    #[arg(value_name = "ROSTER")]
    roster: PathBuf,
    /// Longest time for which the hosts are waited for [s]
    #[arg(long, value_name = "SECONDS", default_value_t = 10.0)]
    wait: f64,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

impl Spread {
    /// Runs `key spread`.
    pub fn run(&self, registry: &Registry) -> Result<Ended> {
        if !(0.5..=3600.0).contains(&self.wait) {
            return bad(format!("--wait: {} is not 0.5 to 3600 seconds", self.wait));
        }
        let wait = Span::from_secs(self.wait);
        let file = self.team.read(registry)?;
        self.take(&file)?;
        let operator = self.team.operator(&file)?;
        let roster = operator.end.key.as_ref().and_then(Key::roster);
        let Roster { number, members, .. } = roster.expect("an operator with a roster has a key").clone();
        let hosts: Vec<(HostId, &str)> = file
            .hosts()
            .zip(&file.deployment().hosts)
            .map(|(host, about)| (host, &*about.name))
            .filter(|(host, _)| members.contains_key(host))
            .collect();
        let me = operator.end.me.host;
        let heard: Rc<RefCell<BTreeSet<HostId>>> = Rc::default();
        let (told, expected) = (Rc::clone(&heard), hosts.len());
        let mut ended = Time::ZERO;
        run_real(
            Instant::now(),
            move |clock, readers| {
                let network = operator::wire((clock, readers), operator, move |event| {
                    if let Event::Message(Wire::Status(status)) = event {
                        told.borrow_mut().insert(status.host);
                    }
                });
                ask(clock, &network, me);
            },
            |(), now| {
                ended = now;
                heard.borrow().len() >= expected || now.since(Time::ZERO) >= wait
            },
        );
        let (took_s, heard) = (ended.as_secs(), heard.borrow());
        let missing: Vec<&str> =
            hosts.iter().filter(|(host, _)| !heard.contains(host)).map(|(_, name)| *name).collect();
        if self.json {
            let said = serde_json::json!({
                "roster": number, "hosts": hosts.len(), "missing": missing, "took_s": took_s,
            });
            print(&said.to_string())?;
        } else {
            let have = hosts.len() - missing.len();
            print(&format!("roster {number}: {have} of {} hosts have it, after {took_s:.3} s", hosts.len()))?;
        }
        if missing.is_empty() {
            return Ok(Ended::Done);
        }
        Err(anyhow!("no answer of {}: is it off, or out of reach?", missing.join(", ")))
    }

    /// Takes the roster as this operator's own, before it is sent.
    fn take(&self, file: &murmurate::deploy::team::TeamFile) -> Result<()> {
        let access = file.operator_access().map_err(|error| self.team.wrong(&error))?;
        let path = self.roster.display();
        let sealed = match std::fs::read(&self.roster) {
            Ok(sealed) if sealed.len() <= MOST && roster::read(&sealed).is_ok() => sealed,
            Ok(_) => return bad(format!("'{path}' is no roster: name one that '{} key revoke' has made", own_name())),
            Err(error) => return bad(format!("cannot read the roster '{path}': {error}")),
        };
        let Some(key_file) = team::key_of(access.key_file.as_deref())? else {
            return bad("the team has no key, and so no rosters".to_owned());
        };
        let Some(kept) = key_file.kept() else {
            let why = "all members of this team have one key, and so no rosters: make keys with 'key new TEAM.toml'";
            return bad(why.to_owned());
        };
        match key_file.key().by_roster(&sealed) {
            Ok(_) => kept
                .write(&sealed)
                .map_err(|error| anyhow!("cannot write the roster to '{}': {error}", kept.path().display())),
            Err(roster::RosterError::Known) => Ok(()),
            Err(error) => bad(format!("the roster '{path}' is not one for this key file: {error}")),
        }
    }
}

/// Asks the hosts, through `network`, whether they are there, again and again.
fn ask(clock: &Clock, network: &Mailbox<network::In>, me: HostId) {
    network.send(network::In::Publish(Wire::Stop(Stop::ask(me))));
    let (again, network) = (clock.clone(), network.clone());
    clock.call(clock.now() + ASK_PERIOD, Box::new(move || ask(&again, &network, me)));
}
