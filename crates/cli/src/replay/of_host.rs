//! Replays a host from its record: runs it again alone, with its recorded inputs.

use std::cell::{Cell, RefCell};
use std::path::Path;
use std::rc::Rc;

use anyhow::Result;

use super::{Args, Files, finish};
use murmurate::deploy::team::Team;
use murmurate::graph::event;
use murmurate::graph::inputs::Input;
use murmurate::live::LiveHost;
use murmurate::live::links::ProcessIdentity;
use murmurate::messages::ids::HostId;
use murmurate::net::protocol::key::Key;
use murmurate::random::Seed;
use murmurate::registry::Registry;
use murmurate::time::Time;
use murmurate::trial::Trial;
use murmurate_record::compare::{Compared, Comparison};
use murmurate_record::identity::{HostIdentity, Identity};
use murmurate_record::reader::{self, Messages, Opened};
use murmurate_record::share::trusted;
use murmurate_record::topics::{Stage, Topic, Topics};
use murmurate_record::{Event, Scope, tape};
use murmurate_robot::output::talk;
use murmurate_robot::{BadInput, bad, host, key, output, team};

/// Host that was built from its record and is ready to run again.
pub struct Prepared {
    /// Identity of the record: program, arguments, host and seed of the recorded run.
    pub identity: Identity,
    /// Reader of the record's messages, with which the replay is compared.
    pub messages: Messages,
    /// Name of the policy that the host runs.
    pub policy: String,
    live: LiveHost,
    turns: Turns,
    /// Whether the tags of datagrams are not checked, because the key is missing: the record has a list of the
    /// datagrams whose tag was valid.
    trusts: bool,
}

/// Builds a host from its record for a replay, with the attached files `files`. The tags of datagrams are checked with
/// the team's key, or replaced by the record's list of valid ones. The flag `--policy` replaces the policy.
pub fn prepare(args: &Args, (path, opened): (&Path, Opened), files: &Files, registry: &Registry) -> Result<Prepared> {
    let Opened { identity, messages, attached } = opened;
    let of = identity.host.clone().expect("the caller has seen a host");
    let policy = args.policy.as_deref().or(files.policy());
    let confined = files.confine(args.policy.as_deref());
    let team = team_of(&identity, files, registry, |team_args| {
        team_args.set.extend(policy.map(|policy| format!("policy={}", policy.display())));
    })?;
    let list = trusted(&attached).filter(|_| args.key_file.is_none());
    let trusts = list.is_some();
    let key = match list {
        _ if !of.keyed => None,
        Some(list) => Some(list),
        // Not where the record says: it may be of somebody else.
        None => args.key_file.as_deref().map(key::read).transpose()?.map(Key::new),
    };
    if of.keyed && key.is_none() {
        return bad(keyless(path));
    }
    if trusts {
        talk(&format!("warning: '{}': no tag is checked; what its list says of them is trusted", path.display()));
    }
    let policy = team::policy(&team, registry)?;
    drop(confined);
    let trial = Trial::of_host(registry, &team, policy.model).map_err(|error| BadInput(error.to_string()))?;
    let live = LiveHost::closed(&team, &trial, key, registry, (&process(path, &of)?, &of.transports))?;
    Ok(Prepared { turns: Turns::open(path)?, identity, messages, policy: policy.name, live, trusts })
}

/// Returns the configuration of the team as the recorded host had it, from the files and arguments in its record.
/// `change` may first change the flags that override fields of the team file.
pub fn team_of(
    identity: &Identity,
    files: &Files,
    registry: &Registry,
    change: impl FnOnce(&mut team::TeamArgs),
) -> Result<Team> {
    let mut team_args = host::of_record(&files.in_place(&identity.arguments))?;
    change(&mut team_args);
    let folder = identity.arguments.iter().find_map(|argument| {
        let named = files.team_file().is_some_and(|name| name == argument);
        named.then(|| Path::new(argument).parent().unwrap_or(Path::new("")).to_owned())
    });
    let file = team_args.read_as_of(registry, folder.as_deref(), &identity.variables)?;
    let name = identity.host.as_ref().map_or("", |host| &host.name);
    let id = file.host_named(name).map_err(|error| BadInput(error.to_string()))?;
    team_args.for_host(&file, id)
}

fn process(path: &Path, of: &HostIdentity) -> Result<ProcessIdentity> {
    let seed = bytes_of(&of.seed).ok_or_else(|| BadInput(format!("'{}': its seed is damaged", path.display())))?;
    let (incarnation, operator) = (of.incarnation, HostId(0));
    Ok(ProcessIdentity { incarnation, seed: Seed::of_bytes(seed), bytes: seed, operator })
}

fn keyless(path: &Path) -> String {
    format!("'{}' is of a team with a key, which is in no record: give it with --key-file", path.display())
}

/// Runs a host again with its recorded inputs, and compares all messages of the replay with those in its record.
pub fn compare(prepared: Prepared) -> Result<Compared> {
    let Prepared { identity, messages, live, mut turns, trusts, .. } = prepared;
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
            output::stamp_as_recorded(Some(now));
            ended.borrow_mut().push(Event::Turn(now));
            over.set(ended.borrow().is_over());
        },
    );
    output::stamp_as_recorded(None);
    finish(comparison)
}

/// Runs the host `live` again with its recorded inputs `turns`. Calls `take` for each datagram that the host publishes,
/// with the time since the start of the run and the datagram's bytes.
pub fn published(live: LiveHost, mut turns: Turns, take: impl FnMut(Time, &[u8]) + 'static) {
    let Some((begun, _)) = turns.next() else { return };
    let now = Rc::new(Cell::new(begun));
    let (time, take) = (Rc::clone(&now), RefCell::new(take));
    // A datagram needs the time of its turn, which is only passed on at the end of the turn.
    let turns = turns.inspect(move |(at, _)| {
        time.set(*at);
        output::stamp_as_recorded(Some(*at));
    });
    let heard = move |_, event: event::Event| {
        if let event::Event::Published(frame) = event {
            (take.borrow_mut())(now.get(), frame);
        }
    };
    live.run_again(begun, turns, heard, |_| {}, |_| {});
    output::stamp_as_recorded(None);
}

impl Prepared {
    /// Returns the parts of this host: identity and messages of its record, the host, and its recorded turns.
    pub fn into_parts(self) -> (Identity, Messages, LiveHost, Turns) {
        (self.identity, self.messages, self.live, self.turns)
    }
}

/// Iterator over the recorded turns of a host's event loop: the time since the start of the run, and the inputs, of
/// each turn.
pub struct Turns {
    messages: Messages,
    last: Time,
}

impl Turns {
    fn open(path: &Path) -> Result<Turns> {
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
    let digits = hexadecimal.as_bytes().chunks(2);
    let bytes: Option<Vec<u8>> =
        digits.map(|two| u8::from_str_radix(std::str::from_utf8(two).ok()?, 16).ok()).collect();
    bytes?.try_into().ok()
}
