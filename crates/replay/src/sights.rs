//! Converts the messages of a record to the events ([`Sight`]) from which the page computes what it shows.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde_json::Value as Json;

use murmurate::graph::inputs::Input;
use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::local::{Contacts, Sample, Truth};
use murmurate::messages::wire::{Features, Wire};
use murmurate::net::protocol::codec;
use murmurate::net::protocol::key::Key;
use murmurate::results::episode::Episode;
use murmurate::safety::guard::SafetyCounts;
use murmurate::time::Time;
use murmurate_record::chosen::Unusable;
use murmurate_record::identity::{self, Identity};
use murmurate_record::keys::RecordedKey;
use murmurate_record::reader::{Item, Message, Reader};
use murmurate_record::receipt::Receipt;
use murmurate_record::stage::{self, Stage};
use murmurate_record::tape;
use murmurate_record::topics::{RECEIPTS, RECEIVED};
use murmurate_record::truth::{self, TrueRobot};
use murmurate_view::timeline::Sight;

/// Content of a record that the live page can show: constant properties of the run, and events.
pub struct Shown {
    /// Hosts, robots, ground and walls of the run.
    pub stage: Stage,
    /// Events of the record that change what the page shows, each with its time since the start of the run (or since
    /// the first message, if the record does not state the start).
    pub sights: Vec<(Time, Sight)>,
    /// Whether the record contains which messages arrived at which host. If it does, the page can show links between
    /// robots.
    pub hears_links: bool,
    /// Whether the record contains the results of episodes.
    pub hears_results: bool,
    /// Note about what the record cannot show, and why; empty if there is nothing to note.
    pub note: String,
}

/// Keys by which arrivals in the records of a team with a key are checked: the team's key, and those of copies that
/// were shared without it, each by its host's name and incarnation.
#[derive(Default)]
pub struct Keys {
    /// Key that the user has given.
    pub of_team: Option<Key>,
    /// Keys of shared copies, which hold for one record.
    pub of_records: BTreeMap<String, Key>,
}

/// Note if no key was given.
const KEYLESS: &str = "what arrived is not known: the record is of a team with a key, which is in no record; give it \
    with --key-file";
/// Note if the key is that of another team.
const OTHER_KEY: &str = "what arrived is not known: no datagram in the record has a tag of this key";

/// Collects the events for a page while a record is read.
struct Reading<'a> {
    stage: Option<Stage>,
    /// Host whose record this is; `None` for a merged record of several hosts or the record of a simulation.
    host: Option<HostId>,
    /// Time in the record's messages that counts as 0 for the page \[ns\]: the start of the run, or the first message;
    /// `None` before it is known.
    zero: Option<u64>,
    sights: Vec<(Time, Sight)>,
    /// Hosts whose published messages are in the record, seen so far.
    published: BTreeSet<HostId>,
    /// Hosts whose turns of the event loop, with the datagrams they received, are in the record.
    taped: BTreeSet<HostId>,
    keys: &'a Keys,
    /// Hosts of a team with a key, each with the key by which its arrivals are checked, if there is one.
    keyed: BTreeMap<HostId, Option<RecordedKey>>,
    /// Numbers of datagrams of hosts with a key that had a valid tag, and that had not.
    tags: [u64; 2],
    /// Incarnation and sequence number of the newest datagram, by receiving host and sending host, by which repeated
    /// datagrams are recognized.
    newest: BTreeMap<(HostId, HostId), (u32, u32)>,
    results: bool,
    /// Whether the record has receipts of the messages of an imported run.
    receipts: bool,
}

/// Reads from a record the content that the live page can show. Arrivals at hosts of a team with a key are checked with
/// `keys`; without one they are left out, as they may be of anybody. An error says why the file cannot be read.
pub fn read(path: &Path, keys: &Keys) -> Result<Shown, Unusable> {
    let mut reader = Reader::open(path)?;
    let mut reading = Reading {
        stage: None,
        host: None,
        zero: None,
        sights: Vec::new(),
        published: BTreeSet::new(),
        taped: BTreeSet::new(),
        keys,
        keyed: BTreeMap::new(),
        tags: [0; 2],
        newest: BTreeMap::new(),
        results: false,
        receipts: false,
    };
    while let Some(item) = reader.next_item()? {
        match item {
            Item::Metadata(name, metadata) if name == identity::METADATA => {
                let identity = Identity::of_metadata(&metadata)
                    .map_err(|error| Unusable(format!("'{}' is no record of this program: {error}", path.display())))?;
                reading.zero = Some(identity.anchor_ns);
                reading.host = identity.host.as_ref().map(|host| host.id);
                reading.note_key(&identity);
            }
            // Of a merged record: one for each host.
            Item::Metadata(name, metadata) if name.starts_with(identity::METADATA) => {
                if let Ok(identity) = Identity::of_metadata(&metadata) {
                    reading.note_key(&identity);
                }
            }
            Item::Metadata(name, metadata) if name == stage::METADATA => {
                reading.stage = Stage::of_metadata(&metadata);
            }
            Item::Message(message) => reading.take(&message),
            _ => {}
        }
    }
    let Some(stage) = reading.stage else {
        let why = format!(
            "'{}' cannot be shown: it has no metadata '{}'; records of this version have them",
            path.display(),
            stage::METADATA
        );
        return Err(Unusable(why));
    };
    let note = match (reading.keyed.values().any(Option::is_none), reading.tags) {
        (true, _) => KEYLESS,
        (false, [0, refused]) if refused > 0 => OTHER_KEY,
        _ => "",
    };
    let taped = stage.homes.iter().all(|home| reading.taped.contains(home));
    let hears_links = note.is_empty() && (taped || reading.receipts);
    let (sights, hears_results) = (reading.sights, reading.results);
    Ok(Shown { stage, sights, hears_links, hears_results, note: note.to_owned() })
}

/// Returns the message as it is needed for the live page: a latent without its features, and any other message
/// unchanged.
fn slim(message: Wire) -> Wire {
    match message {
        Wire::Latent(mut latent) => {
            latent.features = Features(Vec::new().into());
            Wire::Latent(latent)
        }
        other => other,
    }
}

impl Reading<'_> {
    fn take(&mut self, message: &Message) {
        let zero = *self.zero.get_or_insert(message.at);
        let now = Time::from_nanos(message.at.saturating_sub(zero));
        match &*message.channel.topic {
            "/truth" => self.sights.push((now, Sight::Truth(truth(now, &message.data)))),
            "/episode" => {
                if let Ok(episode) = serde_json::from_slice::<Episode>(&message.data) {
                    self.results = true;
                    self.sights.push((now, Sight::Judged(episode)));
                }
            }
            "/guard" => {
                let robot = robot_of(&message.data);
                let counts = serde_json::from_slice::<SafetyCounts>(&message.data).ok();
                self.sights.extend(robot.zip(counts).map(|(robot, counts)| (now, Sight::Guard(robot, counts))));
            }
            "/hardware" => {
                let said: Json = serde_json::from_slice(&message.data).unwrap_or_default();
                let percent = said["battery"].as_u64().and_then(|percent| u8::try_from(percent).ok());
                let robot = robot_of(&message.data);
                self.sights.extend(robot.zip(percent).map(|(robot, percent)| (now, Sight::Battery(robot, percent))));
            }
            RECEIPTS => {
                let Ok(receipt) = serde_json::from_slice::<Receipt>(&message.data) else { return };
                self.receipts = true;
                let (to, from) = (HostId(receipt.to), RobotId(receipt.from));
                self.sights.push((now, Sight::Sent(to, from)));
                // By another clock it may have arrived before it was sent.
                let at = receipt.received_ns.and_then(|at| u64::try_from(at).ok());
                let at = at.map(|at| Time::from_nanos(at.saturating_sub(zero)).max(now));
                self.sights.extend(at.map(|at| (at, Sight::Arrived(to, from))));
            }
            topic => {
                if topic == RECEIVED {
                    self.message(now, &message.data);
                } else if let Some(host) = topic.strip_prefix("/wire/").and_then(|name| self.host_named(name)) {
                    self.published.insert(host);
                    self.message(now, &message.data);
                } else if let Some(host) = topic.strip_prefix("/tape/").and_then(|name| self.taped_host(name)) {
                    self.taped.insert(host);
                    self.turn(now, host, &message.data);
                }
            }
        }
    }

    /// Adds an event for the message in a datagram.
    fn message(&mut self, now: Time, datagram: &[u8]) {
        let decoded = codec::decode(datagram).ok();
        self.sights.extend(decoded.map(|(_, message)| (now, Sight::Message(slim(message)))));
    }

    /// Stores that the recorded host has a key, and the key by which its arrivals are checked.
    fn note_key(&mut self, identity: &Identity) {
        if let Some(host) = identity.host.as_ref().filter(|host| host.keyed) {
            let of_record = self.keys.of_records.get(&host.process_name());
            let key = self.keys.of_team.as_ref().or(of_record).map(|key| RecordedKey::new(key, host));
            self.keyed.entry(host.id).or_insert(None).clone_from(&key);
        }
    }

    fn host_named(&self, name: &str) -> Option<HostId> {
        let at = self.stage.as_ref()?.hosts.iter().position(|host| host == name)?;
        u16::try_from(at).ok().map(HostId)
    }

    /// Returns the host of a topic `/tape/NAME`, which has the turns of a host's event loop; `None` if it is unknown.
    /// `name` is `turn` in the record of one host, and name and incarnation of the host in a merged record.
    fn taped_host(&self, name: &str) -> Option<HostId> {
        match name {
            "turn" => self.host,
            _ => self.host_named(name.rsplit_once('-')?.0),
        }
    }

    /// Adds events for the datagrams that a host received in a turn of its event loop, given as the recorded bytes of
    /// the turn; repeated datagrams are added once.
    fn turn(&mut self, now: Time, host: HostId, data: &[u8]) {
        for input in tape::read(data).into_iter().flat_map(|turn| turn.inputs) {
            if let Some(Some(key)) = self.keyed.get_mut(&host) {
                key.follow(now, &input);
            }
            let Input::Frame(link, frame, _) = input else { continue };
            let plain = match self.keyed.get(&host) {
                None => Cow::Borrowed(&*frame),
                Some(None) => continue,
                Some(Some(key)) => {
                    let plain = key.open(&frame, link);
                    self.tags[usize::from(plain.is_none())] += 1;
                    let Some(plain) = plain else { continue };
                    plain
                }
            };
            let Ok(header) = codec::peek(&plain) else { continue };
            let number = (header.incarnation, header.sequence);
            let newest = self.newest.get(&(host, header.sender));
            if newest.is_some_and(|(incarnation, sequence)| *incarnation == number.0 && *sequence >= number.1) {
                continue;
            }
            self.newest.insert((host, header.sender), number);
            for (kind, body, _) in codec::messages(&plain) {
                let Ok(message) = codec::message(kind, body) else { break };
                let latent_of = if let Wire::Latent(latent) = &message { Some(latent.robot) } else { None };
                if !self.published.contains(&header.sender) {
                    self.sights.push((now, Sight::Message(slim(message))));
                }
                self.sights.extend(latent_of.map(|robot| (now, Sight::Arrived(host, robot))));
            }
        }
    }
}

/// Returns the robot in the field `robot` of a JSON message; `None` if there is none.
fn robot_of(data: &[u8]) -> Option<RobotId> {
    let said: Json = serde_json::from_slice(data).ok()?;
    u16::try_from(said["robot"].as_u64()?).ok().map(RobotId)
}

/// Decodes a recorded message with the true states of all simulated robots at a time.
fn truth(time: Time, data: &[u8]) -> Truth {
    let sample = |of: TrueRobot| Sample {
        robot: RobotId(u16::try_from(of.robot).unwrap_or(u16::MAX)),
        time,
        motion: Motion {
            position: Vec2::new(of.x as f32, of.y as f32),
            velocity: Vec2::new(of.velocity_x as f32, of.velocity_y as f32),
        },
        heading: of.heading as f32,
        yaw_rate: of.yaw_rate as f32,
        command: Vec2::new(of.command_x as f32, of.command_y as f32),
        contacts: Contacts { robot: of.touches_robot, wall: of.touches_wall },
    };
    Truth { time, samples: truth::robots(data).map(sample).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::messages::ids::LinkId;
    use murmurate::messages::phase::Phase;
    use murmurate::messages::round::Round;
    use murmurate::messages::wire::Latent;
    use murmurate::net::protocol::codec::{Flags, Header};
    use murmurate::trial::Trial;
    use murmurate_record::file::{Beginning, RecordFile};
    use murmurate_record::identity::HostIdentity;
    use murmurate_record::topics::Topics;
    use murmurate_record::{Event, Scope};

    /// A record of host 0 of a team with the key `key`, at which three latents of robot 1 have arrived, sent by host 1.
    fn recorded(folder: &Path, key: &Key) -> std::path::PathBuf {
        let trial = Trial::preset("offboard", "passage").unwrap();
        let stage = Stage::of(&trial);
        let mut identity = Identity::here("1f", vec!["host".to_owned()], "");
        let name = stage.hosts[0].clone();
        let (seed, transports) = ("00".repeat(32), vec![1; 2]);
        let host = HostIdentity {
            name,
            id: HostId(0),
            incarnation: 5,
            seed,
            transports,
            keyed: true,
            signed: false,
            roster: String::new(),
        };
        identity.host = Some(host);
        let path = folder.join("host.mcap");
        let mut file = RecordFile::create(&path, &Beginning { identity, attached: Vec::new() }, &stage).unwrap();
        let mut topics = Topics::new(Stage::of(&trial), Scope::Host, 0);
        for sequence in 0..3u32 {
            let header = Header { flags: Flags::default(), team: 1, sender: HostId(1), incarnation: 9, sequence };
            let features = Features(vec![0.5; 4].into());
            let round = Round { term: 1, episode: 0 };
            let latent = Latent {
                robot: RobotId(1),
                round,
                phase: Phase::Running,
                motion: Motion::default(),
                features,
                part: None,
            };
            let mut datagram = codec::encode(&header, &Wire::Latent(latent)).unwrap().to_vec();
            key.seal(&mut datagram, LinkId(0), None);
            let events = [Event::Input(Input::Frame(LinkId(0), datagram.into(), None))];
            let now = Time::from_nanos(u64::from(sequence + 1) * 50_000_000);
            topics.instant(now, &events, &mut |topic, at, bytes| file.write(&stage, topic, at, bytes).unwrap());
        }
        file.finish().unwrap();
        path
    }

    #[test]
    fn arrivals_at_a_host_with_a_key_are_seen_with_the_key_and_otherwise_said_to_be_unknown() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = recorded(folder.path(), &Key::new([7; 32]));
        let seen = |keys: &Keys| {
            let shown = read(&path, keys).unwrap();
            let arrived =
                shown.sights.iter().filter(|(_, sight)| matches!(sight, Sight::Arrived(HostId(0), RobotId(1))));
            (arrived.count(), shown.hears_links, shown.note)
        };
        let (arrived, _, note) = seen(&Keys { of_team: Some(Key::new([7; 32])), ..Keys::default() });
        assert_eq!((arrived, &*note), (3, ""));
        let (arrived, links, note) = seen(&Keys::default());
        assert!(arrived == 0 && !links && note.contains("--key-file"), "{note}");
        let (arrived, links, note) = seen(&Keys { of_team: Some(Key::new([8; 32])), ..Keys::default() });
        assert!(arrived == 0 && !links && note.contains("no datagram"), "{note}");
    }
}
