//! A team of six machines: five robots, and one for World and StateServer, each a network namespace of its own, with
//! two networks between them. Needs root and `ip`; skips with a notice where it cannot run.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::os::fd::{AsFd, AsRawFd};
use std::process::Stdio;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};

use crate::beside;
use crate::crew::{Crew, Said, folder, report};
use crate::lab;
use crate::lab::Lab;
use murmurate::messages::wire::Kind;
use murmurate::net::protocol::codec::TAG_BYTES;
use murmurate::net::protocol::codec::{self, Content};
use murmurate::scenario::judge::Verdict;
use murmurate_report::event::HostEvent;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sched::{CloneFlags, setns};
use nix::sys::signal::Signal;
use nix::sys::socket::{AddressFamily, LinkAddr, SockFlag, SockProtocol, SockType, recvfrom, socket};

const ROBOTS: [u16; 5] = [0, 1, 2, 3, 4];
/// Networks.
const NETWORKS: [&str; 2] = ["adhoc", "infra"];
const GROUPS: [&str; 3] = ["239.255.80.1:41790", "239.255.80.2:41790", "239.255.80.3:41790"];

/// Returns the hosts, each with its networks.
fn hosts() -> Vec<(String, &'static [&'static str])> {
    let robots = ROBOTS.iter().map(|robot| (format!("robot-{robot}"), &NETWORKS[..]));
    robots.chain([("world".to_owned(), &NETWORKS[1..])]).collect()
}

/// Traffic of a network: UDP ports that were sent to, blocks by what they hold, and datagrams.
#[derive(Default)]
struct Seen {
    groups: BTreeSet<String>,
    blocks: BTreeMap<&'static str, u64>,
    datagrams: u64,
    /// Frames other than UDP, which the network itself needs.
    other: u64,
}

impl Seen {
    /// Counts an Ethernet frame.
    fn frame(&mut self, frame: &[u8]) {
        let ip = frame.get(14..).unwrap_or_default();
        let is_udp = frame.get(12..14) == Some(&[8, 0]) && ip.get(9) == Some(&17);
        let header = usize::from(ip.first().copied().unwrap_or(0) & 15) * 4;
        let Some(udp) = ip.get(header..).filter(|udp| is_udp && udp.len() >= 8) else {
            self.other += 1;
            return;
        };
        let length = usize::from(u16::from_be_bytes([udp[4], udp[5]]));
        let (to, port) = (&ip[16..20], u16::from_be_bytes([udp[2], udp[3]]));
        self.groups.insert(format!("{}.{}.{}.{}:{port}", to[0], to[1], to[2], to[3]));
        self.datagrams += 1;
        let sealed = &udp[8..length.min(udp.len())];
        let plain = &sealed[..sealed.len().saturating_sub(TAG_BYTES)];
        let mut note = |what| *self.blocks.entry(what).or_default() += 1;
        if codec::peek(plain).is_err() {
            return note("junk");
        }
        for block in codec::blocks(plain) {
            note(match block {
                Ok((Content::Message(Kind::Latent), _)) => "latent",
                Ok((Content::Message(Kind::MotorCommand), _)) => "motor command",
                Ok((Content::Message(Kind::Reading), _)) => "reading",
                Ok((Content::Message(_), _)) => "heartbeat, mode or stop",
                Ok(_) => "link",
                Err(_) => "junk",
            });
        }
    }
}

/// Captures all frames of a network until `stop` is set.
fn capture(space: &str, stop: &Arc<AtomicBool>) -> JoinHandle<Seen> {
    let (space, stop) = (File::open(format!("/run/netns/{space}")).expect("it was made"), Arc::clone(stop));
    thread::spawn(move || {
        setns(space, CloneFlags::CLONE_NEWNET).expect("root may");
        let rx = socket(AddressFamily::Packet, SockType::Raw, SockFlag::SOCK_NONBLOCK, SockProtocol::EthAll);
        let rx = rx.expect("root may");
        let (mut seen, mut buffer) = (Seen::default(), [0; 2048]);
        while !stop.load(Ordering::Relaxed) {
            let mut polled = [PollFd::new(rx.as_fd(), PollFlags::POLLIN)];
            poll(&mut polled, PollTimeout::from(200u16)).expect("it can be polled");
            while let Ok((length, _)) = recvfrom::<LinkAddr>(rx.as_raw_fd(), &mut buffer) {
                seen.frame(&buffer[..length]);
            }
        }
        seen
    })
}

/// Waits for the result of an episode from `first` on that was not aborted.
fn result_from(crew: &Crew, first: u32) -> u32 {
    crew.until("an episode ends well", |heard| match &heard.said {
        Said::Event(HostEvent::Episode(episode)) => {
            (episode.episode >= first && episode.verdict != Verdict::Aborted).then_some(episode.episode)
        }
        _ => None,
    })
}

/// Checks the traffic of the two networks: of each link its kinds of messages, to its own group.
fn each_network_has_its_own(adhoc: &Seen, infra: &Seen) {
    let told = |name: &str, seen: &Seen| {
        let Seen { groups, blocks, datagrams, other } = seen;
        report(&format!("{name}: {datagrams} datagrams to {groups:?} hold {blocks:?}; other frames: {other}"));
    };
    told("ad-hoc", adhoc);
    told("infra", infra);
    let held = |seen: &Seen| seen.blocks.keys().copied().collect::<Vec<_>>();
    assert_eq!(held(adhoc), ["latent", "link"]);
    assert_eq!(held(infra), ["heartbeat, mode or stop", "link", "motor command", "reading"]);
    assert_eq!(adhoc.groups.iter().collect::<Vec<_>>(), [GROUPS[0]]);
    assert_eq!(infra.groups.iter().collect::<Vec<_>>(), [GROUPS[1], GROUPS[2]]);
}

#[test]
fn six_machines_on_two_networks_run_and_survive_partition_leave_and_rejoin() {
    let _beside = beside();
    let on = |networks: &[&str]| networks.iter().map(|to| ((*to).to_owned(), (*to).to_owned())).collect();
    let machines = hosts().into_iter().map(|(host, networks)| (host, on(networks))).collect();
    let Some(lab) = Lab::build("murm", machines) else { return };
    let links = ["ad-hoc", "infra", "wires"].iter().zip(["adhoc", "infra", "infra"]).zip(GROUPS);
    let links: String = links
        .map(|((link, interface), group)| format!("[link.{link}]\ninterface = \"{interface}\"\ngroup = \"{group}\"\n"))
        .collect();
    let head = "team = 790\nkey_file = \"team.key\"\nmode = \"onboard-adhoc\"\nepisodes = 10000\n";
    let (_folder, file) = folder(&(head.to_owned() + &links));
    let stop = Arc::new(AtomicBool::new(false));
    let captures = NETWORKS.map(|network| capture(&lab.space(network), &stop));
    let spaces: BTreeMap<String, String> =
        hosts().into_iter().map(|(host, _)| (host.clone(), lab.space(&host))).collect();
    let mut crew = Crew::new(move |host| {
        let mut command = lab::on(&spaces[host], env!("CARGO_BIN_EXE_murmurate"));
        command.args(["host", &file, "--host", host, "--json"]).stdin(Stdio::null());
        if host == "world" {
            command.args(["--trajectories", "/dev/stdout"]);
        }
        command
    });
    let names: Vec<String> = hosts().into_iter().map(|(host, _)| host).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();

    // The last robot starts late.
    let early: Vec<&str> = names.iter().copied().filter(|host| *host != "robot-4").collect();
    early.iter().for_each(|host| crew.start(host));
    crew.ready(&early);
    crew.start("robot-4");
    let episode = result_from(&crew, 0);
    report(&format!("a late robot has joined, and episode {episode} has its result"));

    let running = crew.runs_after(Some(episode), &ROBOTS);
    let space = lab.space("robot-1");
    assert!(lab.ip(&["-n", &space, "link", "set", "infra", "down"]));
    let steps = |crew: &Crew, robot: u16, count: u32| {
        let (mut steps, mut driven) = (0, 0);
        crew.row("the World steps", |row, _| {
            if row.robot == robot {
                steps += 1;
                driven += u32::from(row.is_driven());
            }
            (steps == count).then_some(driven)
        })
    };
    let driven = steps(&crew, 1, 40);
    assert!(lab.ip(&["-n", &space, "link", "set", "infra", "up"]));
    // Four steps are 200 ms; one may be under way.
    assert!(driven <= 6, "a robot that hears nothing was driven in {driven} steps of 40");
    let next = crew.runs_after(Some(running), &ROBOTS);
    let episode = result_from(&crew, next);
    report(&format!("cut off for 2 s, driven in {driven} steps of 40; then episode {episode} has its result"));

    let running = crew.runs_after(Some(episode), &ROBOTS);
    crew.signal("robot-2", Signal::SIGKILL);
    let driven = steps(&crew, 2, 40);
    assert!(driven <= 6, "a robot that has left was driven in {driven} steps of 40");
    assert_eq!(crew.ended("robot-2"), None);
    crew.start("robot-2");
    let next = crew.runs_after(Some(running), &ROBOTS);
    let episode = result_from(&crew, next);
    report(&format!("left and back under its own name; then episode {episode} has its result"));

    for host in &names {
        crew.signal(host, Signal::SIGTERM);
    }
    for host in &names {
        assert_eq!(crew.ended(host), Some(0), "{host} ends cleanly");
    }
    stop.store(true, Ordering::Relaxed);
    let [adhoc, infra] = captures.map(|capture| capture.join().expect("it has heard all"));
    each_network_has_its_own(&adhoc, &infra);
}
