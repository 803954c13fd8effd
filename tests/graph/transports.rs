//! Contracts of every transport of the registry, and a transport with a thread of its own.

use std::net::SocketAddr;
use std::os::fd::AsFd;
use std::path::Path;
use std::rc::Rc;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use actix::Recipient;
use murmurate::config::ConfigError;
use murmurate::config::fields::FieldType;
use murmurate::deploy::team::TeamFile;
use murmurate::edge::{self, Gate, Input, PacketSender, Seat, Worker};
use murmurate::messages::ids::HostId;
use murmurate::net::protocol::link::{Guest, Standing};
use murmurate::net::protocol::reliability::{Reliabilities, Setup};
use murmurate::net::protocol::router::Audience;
use murmurate::net::transport::{
    self, Claim, Counts, Endpoint, Field, Filter, In, LinkSettings, OpenError, Place, Transmit, Transport,
};
use murmurate::registry::Registry;
use murmurate::time::Time;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

use crate::skip::skip;

/// Longest time for a frame to arrive, and the wait for one that should not arrive \[ms\].
const PATIENCE: u16 = 5000;
const SURPLUS: u16 = 30;

/// Team file of a link with each transport, in a team of three robots and a World; and mistakes, with how
/// the error begins.
fn lines(name: &str) -> (&'static str, &'static [(&'static str, &'static str, &'static str)]) {
    match name {
        "multicast" => (
            "interface = \"lo\"\ngroup = \"239.255.77.91:47811\"",
            &[
                ("239.255.77.91:", "10.0.0.1:", "link.infra.group (line 8): 10.0.0.1 is no multicast group"),
                ("interface = \"lo\"", "", "link.infra.interface: missing"),
            ],
        ),
        "auto" => (
            "interface = \"lo\"\ngroup = \"239.255.77.92:47812\"",
            &[
                ("239.255.77.92:", "10.0.0.1:", "link.infra.group (line 8): 10.0.0.1 is no multicast group"),
                ("239.255.77.92:", "[ff02::4d75]:", "link.infra.group (line 8): ff02::4d75 is of IPv6"),
            ],
        ),
        "unicast" => (
            "interface = \"lo\"\npeers.robot-0 = \"127.0.0.1:47821\"\npeers.robot-1 = \"127.0.0.1:47822\"\n\
             peers.robot-2 = \"127.0.0.1:47823\"\npeers.world = \"127.0.0.1:47824\"",
            &[
                ("47822", "47821", "link.infra.peers.robot-1 (line 9): 127.0.0.1:47821 is where host 'robot-0'"),
                ("peers.world", "peers.nobody", "link.infra.peers.nobody (line 11): there is no host"),
                ("127.0.0.1:47824", "0.0.0.0:1", "link.infra.peers.world (line 11): 0.0.0.0 is no address"),
            ],
        ),
        "zenoh" => (
            "connect = \"udp/127.0.0.1:47831\"\n[host.robot-0.link.infra]\nmode = \"router\"\n\
             listen = \"udp/127.0.0.1:47831\"\nconnect = \"none\"",
            &[
                ("connect = \"udp/", "connect = \"tcp/", "link.infra.connect (line 7): 'tcp/127.0.0.1:47831' is a"),
                ("connect = \"udp/127.0.0.1:47831\"", "", "link.infra.connect: missing; say where a Zenoh router"),
                ("listen = \"udp/127.0.0.1:47831\"", "", "link.infra.listen: missing; a router listens somewhere"),
            ],
        ),
        "hub" => ("hub = \"one\"", &[("hub = \"one\"", "", "link.infra.hub: missing; name the hub")]),
        _ => panic!("'{name}' is new: say here what a link of it needs, and what would be wrong"),
    }
}

/// Lock of a test that opens links: other tests would receive its frames.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

fn registry() -> Registry {
    Registry::builtin().with_transport(murmurate_zenoh::ENTRY).with_transport(HUB)
}

/// Transports that this build has.
fn transports() -> Vec<transport::Entry> {
    let built = |entry: &transport::Entry| entry.name != "zenoh" || murmurate_zenoh::BUILT;
    registry().transports().iter().copied().filter(built).collect()
}

fn text(name: &str) -> String {
    let (lines, _) = lines(name);
    // A router may pass frames on to other machines, so a team with one has a key.
    let key = if name == "zenoh" { "key_file = \"team.key\"" } else { "" };
    format!(
        "team = 1\nmode = \"onboard-infra\"\nrobots = 3\n{key}\n[link.infra]\ntransport = \"{name}\"\n{lines}\n\
         [link.wires]\ninterface = \"lo\"\n"
    )
}

fn read(text: &str) -> Result<TeamFile, ConfigError> {
    let file = TeamFile::read(&registry(), text, Path::new(""), &[], &[])?;
    file.check()?;
    Ok(file)
}

/// Returns the places of the three robots' hosts on the tested link.
fn places(name: &str) -> Vec<Place> {
    let file = read(&text(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    let at = file.deployment().links.iter().position(|link| link.name == "infra").expect("the preset has it");
    let place = |host| file.for_host(HostId(host)).expect("it is sound").links[at].clone().expect("it takes part");
    (0..3).map(place).collect()
}

fn open(name: &str, places: &[Place]) -> Vec<Box<dyn Transport>> {
    let open = |(host, place): (HostId, &Place)| place.endpoint.open(host, Filter::All).expect("it can be opened");
    let mut hosts: Vec<_> = (0..).map(HostId).zip(places).map(open).collect();
    for to in 1..hosts.len() {
        let (before, after) = hosts.split_at_mut(to);
        for (from, host) in (0..).map(HostId).zip(before) {
            settle(name, (from, &mut **host), (HostId(to as u16), &mut *after[0]));
        }
    }
    hosts
}

/// Waits until two hosts hear each other, where routers first have to learn who listens.
fn settle(name: &str, (one, at_one): (HostId, &mut dyn Transport), (other, at_other): (HostId, &mut dyn Transport)) {
    if name != "zenoh" {
        return;
    }
    let until_heard = |from: &mut dyn Transport, to: HostId, at: &mut dyn Transport| {
        let heard = (0..100).any(|_| {
            say(from, Audience::Host(to), b"are you there?");
            !hear(at, 0).is_empty()
        });
        assert!(heard, "{to:?} hears nothing");
        while !hear(at, 0).is_empty() {}
    };
    until_heard(&mut *at_one, other, &mut *at_other);
    until_heard(at_other, one, at_one);
}

fn say(transport: &mut dyn Transport, audience: Audience, frame: &[u8]) {
    transport.handle(Time::ZERO, In::Transmit(Transmit { from: HostId(0), audience, frame: frame.into() }));
}

/// Receives so many frames, and those that come soon after them.
fn hear(transport: &mut dyn Transport, count: usize) -> Vec<(Option<SocketAddr>, Vec<u8>)> {
    let mut heard = Vec::new();
    loop {
        let descriptor = transport.descriptor();
        let mut watched = [PollFd::new(descriptor.as_fd(), PollFlags::POLLIN)];
        let patience = if heard.len() < count { PATIENCE } else { SURPLUS };
        match poll(&mut watched, PollTimeout::from(patience)).expect("it can be watched") {
            0 => return heard,
            _ => transport.receive(Time::ZERO, &mut |from, frame| heard.push((from, frame.to_vec()))),
        }
    }
}

fn frames(transport: &mut dyn Transport, count: usize) -> Vec<Vec<u8>> {
    hear(transport, count).into_iter().map(|(_, frame)| frame).collect()
}

#[test]
fn a_frame_to_all_arrives_once_at_each_other_host() {
    let _alone = alone();
    for entry in transports() {
        let mut hosts = open(entry.name, &places(entry.name));
        say(&mut *hosts[0], Audience::All, b"to all");
        say(&mut *hosts[0], Audience::All, b"again");
        for (host, heard) in hosts.iter_mut().zip([0, 2, 2]) {
            let frames = frames(&mut **host, heard);
            assert_eq!(frames, [&b"to all"[..], b"again"][..heard], "{}", entry.name);
        }
        assert_eq!(hosts[0].counts(), Counts::default(), "{}", entry.name);
    }
}

#[test]
fn a_frame_to_one_host_reaches_only_that_host_on_an_addressed_link() {
    let _alone = alone();
    for entry in transports() {
        let places = places(entry.name);
        let addressed = places[0].setup(&Reliabilities::new()).is_addressed();
        let mut hosts = open(entry.name, &places);
        say(&mut *hosts[0], Audience::Host(HostId(1)), b"to one");
        let others = usize::from(!addressed);
        for (host, heard) in hosts.iter_mut().zip([0, 1, others]) {
            assert_eq!(frames(&mut **host, heard).len(), heard, "{}", entry.name);
        }
    }
}

/// Gives the calling thread a network of its own, with the address 10.99.0.1 on the interface `wire`. Returns whether
/// it could.
fn alone_on_a_wire() -> bool {
    let ip = |args: &str| {
        let status = std::process::Command::new("ip").args(args.split(' ')).status();
        status.is_ok_and(|status| status.success())
    };
    nix::sched::unshare(nix::sched::CloneFlags::CLONE_NEWNET).is_ok()
        && ip("link add wire type veth peer name far")
        && ip("addr add 10.99.0.1/24 dev wire")
        && ip("link set wire up")
        && ip("link set far up")
}

#[test]
fn what_waits_for_the_addresses_of_silent_hosts_keeps_back_no_other_datagram() {
    let unsent = std::thread::spawn(|| {
        if !alone_on_a_wire() {
            skip("namespaces", "no network of its own for a thread (root and ip)");
            return 0;
        }
        let robots = 9;
        let peers = (0..robots).map(|robot| format!("peers.robot-{robot} = \"10.99.0.{}:47841\"\n", robot + 1));
        let text = format!(
            "team = 1\nmode = \"onboard-infra\"\nrobots = {robots}\nkey_file = \"team.key\"\n[link.infra]\n\
             transport = \"unicast\"\ninterface = \"wire\"\n{}peers.world = \"10.99.0.99:47841\"\n\
             [link.wires]\ninterface = \"lo\"\n",
            peers.collect::<String>()
        );
        let file = read(&text).expect("it is sound");
        let place = file.for_host(HostId(0)).expect("it is sound").links[0].clone().expect("it takes part");
        let mut transport = place.endpoint.open(HostId(0), Filter::All).expect("it can be opened");
        // Twenty seconds of states: none of the nine others is there.
        (0..400).for_each(|_| say(&mut *transport, Audience::All, &[7; 260]));
        transport.counts().unsent
    });
    assert_eq!(unsent.join().expect("the thread ends"), 0);
}

#[test]
fn a_guest_reaches_all_hosts_and_is_answered_once_admitted() {
    let _alone = alone();
    for entry in transports() {
        let places = places(entry.name);
        let mut hosts = open(entry.name, &places);
        let operator = HostId::operator(9);
        let guest = places[0].for_guest(HostId(0)).endpoint;
        assert_eq!(guest.claim(), places[1].for_guest(HostId(1)).endpoint.claim(), "{}: it is one link", entry.name);
        let mut guest = guest.open(operator, Filter::All).expect("it can be opened");
        for (host, at) in (0..).map(HostId).zip(&mut hosts) {
            settle(entry.name, (host, &mut **at), (operator, &mut *guest));
        }
        say(&mut *guest, Audience::All, b"hello");
        for host in &mut hosts {
            let heard = hear(&mut **host, 1);
            assert_eq!(heard.len(), 1, "{}", entry.name);
            if let Some(at) = heard[0].0 {
                let admitted = Guest { host: operator, at, standing: Standing::Accepted };
                host.handle(Time::ZERO, In::Admit(admitted));
            }
        }
        say(&mut *hosts[1], Audience::All, b"welcome");
        assert_eq!(frames(&mut *guest, 1), [b"welcome"], "{}", entry.name);
    }
}

#[test]
fn mistakes_in_a_team_file_are_refused_by_their_field() {
    for entry in registry().transports() {
        let sound = text(entry.name);
        for (from, to, start) in lines(entry.name).1 {
            assert!(sound.contains(from), "{from}");
            let error = read(&sound.replacen(from, to, 1)).expect_err("it is refused").to_string();
            // A missing field leaves its line empty.
            assert!(error.starts_with(start), "{}: {error}", entry.name);
        }
        let transport = format!("transport = \"{}\"", entry.name);
        let with = |line: &str| read(&sound.replace(&transport, line)).expect_err("it is refused").to_string();
        let error = with(&format!("{transport}\ncolour = \"red\""));
        assert!(error.starts_with("link.infra.colour (line 7): there is no such field"), "{error}");
        let error = with("transport = \"pigeon\"");
        let there = "there is no transport 'pigeon'; there are: multicast, unicast, auto, zenoh, hub";
        assert!(error.contains(there), "{error}");
    }
}

#[test]
fn fields_of_one_name_take_the_same_values_in_all_transports() {
    let mut all = Registry::builtin().with_transport(murmurate_zenoh::ENTRY);
    for entry in transport::REGISTRY.iter().chain([&murmurate_zenoh::ENTRY]) {
        // A copy under another name is accepted only if its fields agree with all others.
        let name = Box::leak(format!("{}-copy", entry.name).into_boxed_str());
        all = all.with_transport(transport::Entry { name, ..*entry });
    }
    assert_eq!(all.transports().len(), 2 * (transport::REGISTRY.len() + 1));
}

#[test]
fn a_transport_that_is_not_built_in_names_its_feature() {
    if murmurate_zenoh::BUILT {
        return;
    }
    let place = &places("zenoh")[1];
    let Err(OpenError::Wrong(why)) = place.endpoint.open(HostId(1), Filter::All) else { panic!("it is not built in") };
    assert!(why.contains("built without Zenoh") && why.contains("--features zenoh"), "{why}");
}

/// Transport that works on its own thread, as an asynchronous library does: hosts of this process exchange frames
/// through named hubs.
const HUB: transport::Entry = transport::Entry {
    name: "hub",
    about: "a thread for each host of this process",
    fields: &[Field::new("hub", FieldType::Text)],
    read: |settings: &LinkSettings| {
        let name = settings.need("hub", || "; name the hub".to_owned())?.text().to_owned();
        Ok(Arc::new(Hub { name }))
    },
};

/// Members of each hub.
static MEMBERS: Mutex<Vec<(Hub, HostId, PacketSender)>> = Mutex::new(Vec::new());

#[derive(Clone, Debug, PartialEq, Eq)]
struct Hub {
    name: String,
}

impl Endpoint for Hub {
    fn open(&self, host: HostId, _: Filter) -> Result<Box<dyn Transport>, OpenError> {
        let worker = Box::new(Member { hub: self.clone(), host });
        let (gate, _) = edge::start(worker, "hub").map_err(|error| OpenError::NotNow(error.to_string()))?;
        Ok(Box::new(Line { gate, counts: Counts::default() }))
    }

    fn for_guest(&self, _: HostId) -> Arc<dyn Endpoint> {
        Arc::new(self.clone())
    }

    fn setup(&self, reliability: Reliabilities) -> Setup {
        Setup::unicast(reliability)
    }

    fn is_local(&self) -> bool {
        true
    }

    fn claim(&self) -> Claim {
        Claim { field: "hub", what: self.name.clone(), on: String::new() }
    }

    fn restricted_to(&self, _: &[HostId]) -> Arc<dyn Endpoint> {
        Arc::new(self.clone())
    }
}

/// Host of a hub: an actor that passes on its packets, each with its audience in front.
struct Member {
    hub: Hub,
    host: HostId,
}

impl Worker for Member {
    fn start(self: Box<Self>, seat: Seat) -> Recipient<Input> {
        let mut members = MEMBERS.lock().unwrap_or_else(PoisonError::into_inner);
        members.retain(|(_, _, sender)| !sender.is_closed());
        members.push((self.hub.clone(), self.host, seat.sender()));
        drop(members);
        seat.serve(move || move |packet| self.pass_on(&packet))
    }
}

impl Member {
    fn pass_on(&self, packet: &[u8]) {
        let to = u16::from_le_bytes([packet[0], packet[1]]);
        let members = MEMBERS.lock().unwrap_or_else(PoisonError::into_inner);
        let others = members.iter().filter(|(hub, host, _)| *hub == self.hub && *host != self.host);
        for (_, _, sender) in others.filter(|(_, other, _)| to == u16::MAX || other.0 == to) {
            sender.send(packet[2..].into());
        }
    }
}

struct Line {
    gate: Gate,
    counts: Counts,
}

impl Transport for Line {
    fn descriptor(&self) -> Rc<dyn AsFd> {
        Rc::new(self.gate.bell())
    }

    fn receive(&mut self, _: Time, take: &mut dyn FnMut(Option<SocketAddr>, &[u8])) {
        self.gate.take(|packet| take(None, &packet));
        (self.counts.unsent, self.counts.dropped) = self.gate.dropped();
    }

    fn handle(&mut self, _: Time, input: In) {
        if let In::Transmit(Transmit { audience, frame, .. }) = input {
            let to = if let Audience::Host(host) = audience { host.0 } else { u16::MAX };
            self.gate.send([&to.to_le_bytes()[..], &frame].concat().into());
        }
    }

    fn counts(&self) -> Counts {
        self.counts
    }
}
