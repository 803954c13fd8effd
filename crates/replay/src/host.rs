//! Replays a host from its record: runs it again alone, with its recorded inputs.

use std::cell::{Cell, RefCell};
use std::path::Path;
use std::rc::Rc;

use data_encoding::HEXLOWER_PERMISSIVE;
use murmurate::deploy::team::Team;
use murmurate::graph::event;
use murmurate::graph::inputs::Input;
use murmurate::live::LiveHost;
use murmurate::live::links::ProcessIdentity;
use murmurate::messages::ids::HostId;
use murmurate::net::protocol::key::Key;
use murmurate::net::protocol::signatures::Signatures;
use murmurate::policy::Models;
use murmurate::random::Seed;
use murmurate::registry::Registry;
use murmurate::time::Time;
use murmurate::trial::Trial;
use murmurate_record::actions::{Commands, RobotDifference, StepDifference};
use murmurate_record::compare::{Compared, Comparison};
use murmurate_record::identity::{HostIdentity, Identity};
use murmurate_record::keys::{first_key, first_roster};
use murmurate_record::reader::{self, Messages};
use murmurate_record::share::trusted;
use murmurate_record::topics::{Stage, Topic, Topics};
use murmurate_record::{Event, Scope, tape};

use crate::ReplayError;
use crate::error::finish;

/// Access of a host to its team in a replay: how it checks the tags of datagrams.
pub struct Access {
    /// Key of the team, or a list of accepted datagrams in its place; `None` for a team without a key.
    key: Option<Key>,
    /// Whether the tags of datagrams are not checked, because the key is missing: the record has a list of the
    /// datagrams whose tag was valid.
    pub trusts: bool,
}

impl Access {
    /// Returns the access of the host `of`: with `key` if it is given, or else with the list among the files `attached`
    /// to its record. If the datagrams of the team are `confidential`, a copy with a list has them in clear, without
    /// the tags that a key would check. `None` if the team has a key, and there is neither.
    pub fn of(
        of: &HostIdentity,
        attached: &[(String, Vec<u8>)],
        key: Option<Key>,
        confidential: bool,
    ) -> Option<Access> {
        if !of.keyed {
            return Some(Access { key: None, trusts: false });
        }
        let list = match trusted(attached) {
            Some(list) if of.signed => {
                Some(list.with_signatures(Signatures::trusting()).with_trusted_rosters(first_roster(of)))
            }
            list => list,
        };
        let trusts = key.is_none() || confidential && list.is_some();
        let key = if trusts { list } else { key.map(|key| first_key(&key, of)) }?;
        Some(Access { key: Some(key.confidential_if(confidential)), trusts })
    }
}

/// Host that was built from its record and is ready to run again.
pub struct Prepared {
    identity: Identity,
    /// Reader of the record's messages, with which the replay is compared.
    messages: Messages,
    live: LiveHost,
    turns: Turns,
    trusts: bool,
}

impl Prepared {
    /// Builds the host of the record at `path` from the settings of its team and the policy that it is to run.
    /// `messages` are those of the record, from the first one on.
    pub fn new(
        (path, identity, messages): (&Path, Identity, Messages),
        (team, models): (&Team, Models),
        access: Access,
        registry: &Registry,
    ) -> Result<Prepared, ReplayError> {
        let none = || ReplayError::Unusable(format!("'{}' is not of a host", path.display()));
        let of = identity.host.as_ref().ok_or_else(none)?;
        let trial = Trial::of_host(registry, team, models)?;
        let live = LiveHost::closed(team, &trial, access.key, registry, (&process(path, of)?, &of.transports))?;
        Ok(Prepared { turns: Turns::open(path)?, identity, messages, live, trusts: access.trusts })
    }
}

fn process(path: &Path, of: &HostIdentity) -> Result<ProcessIdentity, ReplayError> {
    let damaged = || ReplayError::Unusable(format!("'{}': its seed is damaged", path.display()));
    let seed = bytes_of(&of.seed).ok_or_else(damaged)?;
    let (incarnation, operator) = (of.incarnation, HostId(0));
    Ok(ProcessIdentity { incarnation, seed: Seed::of_bytes(seed), bytes: seed, operator })
}

/// Runs a host again with its recorded inputs, and compares all messages of the replay with those in its record.
/// Calls `turned` with the time of each turn at its end.
pub fn compare(prepared: Prepared, mut turned: impl FnMut(Time)) -> Result<Compared, ReplayError> {
    let Prepared { identity, messages, live, mut turns, trusts } = prepared;
    let Some((begun, _)) = turns.next() else {
        return Ok(Compared { messages: 0, difference: None, cut: true, gap_s: None, damaged_s: None });
    };
    let topics = Topics::new(Stage::of(live.trial()), Scope::Host, identity.anchor_ns);
    let comparison = Comparison::new(messages, topics, identity.anchor_ns);
    let comparison = Rc::new(RefCell::new(if trusts { comparison.without_tags() } else { comparison }));
    comparison.borrow_mut().push(Event::Turn(begun));
    let (heard, ended) = (Rc::clone(&comparison), Rc::clone(&comparison));
    let over = Rc::new(Cell::new(false));
    let stop = Rc::clone(&over);
    live.run_again(
        begun,
        turns.take_while(move |_| !stop.get()),
        move |host, event| {
            if let Some(event) = Event::of(Scope::Host, host, event) {
                heard.borrow_mut().push(event);
            }
        },
        |_| {},
        move |now| {
            turned(now);
            ended.borrow_mut().push(Event::Turn(now));
            over.set(ended.borrow().is_over());
        },
    );
    finish(comparison)
}

/// Runs a host again with its recorded inputs, and returns by how much its actions differ from the recorded ones: at
/// each step, and for each robot. Calls `turned` with the time of each turn at its beginning.
pub fn actions(
    prepared: Prepared,
    turned: impl FnMut(Time),
) -> Result<(Vec<StepDifference>, Vec<RobotDifference>), ReplayError> {
    let Prepared { identity, messages, live, turns, .. } = prepared;
    let recorded = Commands::read(messages, identity.anchor_ns)?;
    let replayed = Rc::new(RefCell::new(Commands::default()));
    let taken = Rc::clone(&replayed);
    published(live, turns, turned, move |now, datagram| taken.borrow_mut().take(now.as_nanos(), datagram));
    let replayed = replayed.borrow();
    Ok(recorded.beside(&replayed))
}

/// Runs the host `live` again with its recorded inputs `turns`. Calls `turned` with the time of each turn at its
/// beginning, and `take` for each datagram that the host publishes, with the time and the datagram's bytes.
fn published(live: LiveHost, mut turns: Turns, mut turned: impl FnMut(Time), take: impl FnMut(Time, &[u8]) + 'static) {
    let Some((begun, _)) = turns.next() else { return };
    let now = Rc::new(Cell::new(begun));
    let (time, take) = (Rc::clone(&now), RefCell::new(take));
    // A datagram needs the time of its turn, which is only passed on at the end of the turn.
    let turns = turns.inspect(move |(at, _)| {
        time.set(*at);
        turned(*at);
    });
    let heard = move |_, event: event::Event| {
        if let event::Event::Published(frame) = event {
            (take.borrow_mut())(now.get(), frame);
        }
    };
    live.run_again(begun, turns, heard, |_| {}, |_| {});
}

/// Iterator over the recorded turns of a host's event loop: the time since the start of the run, and the inputs, of
/// each turn.
struct Turns {
    messages: Messages,
    last: Time,
}

impl Turns {
    fn open(path: &Path) -> Result<Turns, ReplayError> {
        Ok(Turns { messages: reader::messages(path)?.1, last: Time::ZERO })
    }
}

impl Iterator for Turns {
    type Item = (Time, Vec<Input>);

    fn next(&mut self) -> Option<Self::Item> {
        // Damage in the middle of the file is reported by the comparison, which reads the same bytes.
        while let Ok(Some(message)) = self.messages.next_message() {
            if self.messages.gaps() > 0 {
                return None;
            }
            if message.channel.encoding == Topic::Turn.encoding() {
                // Time does not run backwards in a record of ours.
                let turn = tape::read(&message.data).filter(|turn| turn.now >= self.last)?;
                self.last = turn.now;
                return Some((turn.now, turn.inputs));
            }
        }
        None
    }
}

fn bytes_of(hexadecimal: &str) -> Option<[u8; 32]> {
    HEXLOWER_PERMISSIVE.decode(hexadecimal.as_bytes()).ok()?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate_record::share::ACCEPTED;

    fn identity(keyed: bool) -> HostIdentity {
        let (name, transports) = ("a".to_owned(), vec![1]);
        HostIdentity {
            name,
            id: HostId(0),
            incarnation: 5,
            seed: "07".repeat(32),
            transports,
            keyed,
            signed: false,
            roster: String::new(),
        }
    }

    #[test]
    fn a_replay_of_a_team_with_a_key_needs_it_or_the_list_in_its_place() {
        let list = [(ACCEPTED.to_owned(), vec![1; 16])];
        let of = |keyed, list: &[_], key, confidential| Access::of(&identity(keyed), list, key, confidential);
        let key = || Some(Key::new([7; 32]));
        let open = of(false, &list, None, false).unwrap();
        assert!(open.key.is_none() && !open.trusts);
        assert!(of(true, &[], None, false).is_none());
        assert!(of(true, &list, None, false).unwrap().trusts);
        assert!(!of(true, &list, key(), false).unwrap().trusts, "the key is better");
        assert!(of(true, &list, key(), true).unwrap().trusts, "what is decrypted has no tag");
        assert!(of(true, &[], key(), true).unwrap().key.unwrap().is_confidential());
    }

    #[test]
    fn a_process_is_that_of_the_record_or_its_seed_is_damaged() {
        let path = Path::new("a.mcap");
        assert_eq!(process(path, &identity(true)).unwrap().bytes, [7; 32]);
        let mut damaged = identity(true);
        damaged.seed.truncate(62);
        let error = process(path, &damaged).err().unwrap();
        assert_eq!(error.to_string(), "'a.mcap': its seed is damaged");
    }
}
