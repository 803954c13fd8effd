//! Checks that need other hosts: loopback of own datagrams, and reception from each host. Two operators of
//! this process, on every link of the host, exchange reports and receive those of all hosts.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;
use std::time::Instant;

use anyhow::{Result, anyhow};
use murmurate::deploy::Routes;
use murmurate::deploy::team::Team;
use murmurate::graph::end::HostEnd;
use murmurate::graph::event::Event;
use murmurate::graph::operator::{Operator, observe, wire};
use murmurate::messages::ids::{HostId, LinkId, RobotId};
use murmurate::messages::latch::Latch;
use murmurate::messages::wire::{Condition, Health, Kind, Phase, REVISION, Wire};
use murmurate::net::protocol::link::LinkCounts;
use murmurate::net::protocol::reliability::Setup;
use murmurate::net::protocol::sender::Peer;
use murmurate::net::protocol::ways::Ways;
use murmurate::net::transport::{Filter, Place};
use murmurate::runtime::real::run_real;
use murmurate::time::{Span, Time};

use super::finding::{Found, Subject};
use super::ways;
use crate::key;
use crate::team;
use murmurate::fitness::Fitness;
use murmurate::live::links;

/// Age of a host's last datagram below which the host is running \[s\]. Reports are sent four times a second.
const RUNNING_S: f64 = 2.0;
/// Share of lost datagrams (0 to 1) from which a warning is given: that at which the reliability mode `repeat` begins
/// to repeat (docs/wire.md).
const LOSSY: f64 = 2.0 / 64.0;

/// Results of listening to the team: findings, running hosts, and whether robots may be driven.
#[derive(Default)]
pub struct Reception {
    /// Findings about reception from each host on each link, refused datagrams, and the condition of each robot.
    pub found: Vec<Found>,
    /// Hosts of the team from which a datagram arrived within the last two seconds.
    pub hosts: BTreeSet<HostId>,
    /// Reason why no robot may be driven now; `None` if robots may be driven.
    pub hindrance: Option<String>,
}

/// Returns the reason why no robot may be driven while the team's episode is in phase `phase` and its emergency stop
/// latch is `latch`. `None` if the team stands and will not continue by itself, so robots may be driven.
pub fn hindrance(phase: Phase, latch: Latch) -> Option<String> {
    match phase {
        _ if latch.is_engaged() => Some("the emergency stop is engaged: re-arm and resume first".to_owned()),
        _ if latch.is_held() => Some("the team is held after an emergency stop: resume first".to_owned()),
        Phase::EpisodesFinished | Phase::Waiting => None,
        _ => Some("the team's state server leads an episode: end it first".to_owned()),
    }
}

/// Messages and statistics of the team received while listening: reception and delay of each host on each link,
/// counts of datagrams, the condition of each robot, and the reason, if any, why no robot may be driven.
#[derive(Default)]
struct Received {
    peers: BTreeMap<(u16, u16), Peer>,
    /// Over which hops hosts of a mesh are heard, and what links that choose have measured.
    ways: Ways,
    counts: LinkCounts,
    /// Host id of the second of the two operators. If the first one receives its answers, then
    /// datagrams that this machine sends come back to it (loopback).
    echo: u16,
    /// Condition of each robot, merged from all hosts that report it.
    robots: BTreeMap<RobotId, Condition>,
    /// Reason why no robot may be driven, from the last instruction of the state server.
    hindrance: Option<String>,
    /// Whether an instruction of the state server was received.
    led: bool,
    /// Hosts with messages of another revision than those of this program, each with its revision.
    unequal: BTreeMap<HostId, u16>,
}

impl Received {
    /// Merges a host's report on a robot into what other hosts reported about that robot: a value in `told` replaces
    /// the known one, and a missing value leaves it. The reason of a fault is dropped once the robot is ready.
    fn learn(&mut self, told: &Condition) {
        let known = self.robots.entry(told.robot).or_insert_with(|| told.clone());
        known.phase = told.phase.or(known.phase);
        known.seen = told.seen.or(known.seen);
        known.health = told.health.or(known.health);
        known.battery = told.battery.or(known.battery);
        known.temperature = told.temperature.or(known.temperature);
        known.reason = told.reason.clone().or(known.reason.take()).filter(|_| told.health != Some(Health::Ready));
    }
}

/// Listens to the team for `seconds` \[s\], and returns findings, running hosts and any reason why no robot may be
/// driven. `teams` has the configuration of each host of this machine, whose links are used; `all` has that of each
/// host of the team.
pub fn listen(teams: &[Team], all: &[Team], seconds: f64) -> Result<Reception> {
    let first = &teams[0];
    let place = |at: usize| teams.iter().find_map(|team| Some(team.links[at].as_ref()?.for_guest(team.host)));
    let places: Vec<Option<Place>> = (0..first.links.len()).map(place).collect();
    let names: Vec<&str> = first.deployment.links.iter().map(|link| &*link.name).collect();
    if places.iter().all(Option::is_none) {
        return Ok(Reception::default());
    }
    if let Some(found) = only_a_host(first)? {
        return Ok(Reception { found: vec![found], ..Reception::default() });
    }
    let setups = links::of_operator(&first.deployment, places.iter().map(Option::as_ref));
    let mut found = Vec::new();
    let received = hear(first, &places, &setups, seconds)?;
    for (at, name) in names.iter().enumerate().filter(|(at, _)| places[*at].is_some()) {
        let link = u16::try_from(at).expect("links are counted in u16");
        // On a unicast link operators do not receive each other's datagrams.
        let open = setups[at].as_ref().is_some_and(|setup| !setup.is_addressed());
        found.extend(open.then(|| loop_back(name, received.peers.get(&(link, received.echo)))));
        for (number, host) in first.deployment.hosts.iter().enumerate() {
            let uses = all.iter().any(|team| usize::from(team.host.0) == number && team.links[at].is_some());
            let peer = received.peers.get(&(link, u16::try_from(number).expect("hosts are counted in u16")));
            let over = || ways::over_hops(&first.deployment, (link, number), &received.peers, &received.ways);
            if uses || peer.is_some() {
                found.push(over().unwrap_or_else(|| about(name, &host.name, peer)));
            }
        }
    }
    found.extend(ways::findings(&first.deployment, &received.peers, &received.ways));
    found.extend(received.counts.key_trouble().map(|trouble| {
        let what = Subject::General("key".to_owned());
        (Fitness::Fail, what, trouble.to_owned(), "give this machine and all hosts the same key".to_owned())
    }));
    found.extend(refusals(&received.counts));
    found.extend(received.unequal.iter().map(|(host, revision)| {
        let named = first.deployment.hosts.get(usize::from(host.0)).map_or("a host", |host| &*host.name);
        let said =
            format!("'{named}' has messages of revision {revision}, this program of {REVISION}: the team stands");
        let what = Subject::General("version".to_owned());
        (Fitness::Fail, what, said, "install one version of this program on all hosts".to_owned())
    }));
    // If no robot is reported, the findings about hosts say enough.
    if !received.robots.is_empty() {
        found.extend(
            RobotId::team(first.deployment.robots).map(|robot| about_robot(robot, received.robots.get(&robot))),
        );
    }
    let running = |peer: &&Peer| peer.age_s.is_some_and(|age_s| age_s < RUNNING_S) && !HostId(peer.host).is_operator();
    let hosts: BTreeSet<HostId> = received.peers.values().filter(running).map(|peer| HostId(peer.host)).collect();
    // A state server that has just started sends nothing before its first episode.
    let begins = !received.led && hosts.contains(&Routes::of(&first.deployment).server_host());
    let begins =
        begins.then(|| "the host of the state server is running, and will begin an episode: end it".to_owned());
    Ok(Reception { found, hosts, hindrance: received.hindrance.or(begins) })
}

/// Returns the finding that this machine cannot listen, if its key file is a host's own: that host may be running.
fn only_a_host(team: &Team) -> Result<Option<Found>> {
    let file = team.key_file.as_deref().map(key::read).transpose()?;
    let member = file.as_ref().and_then(key::KeyFile::member).filter(|(number, _)| !number.is_operator());
    Ok(member.map(|(_, name)| {
        let said = format!("not listened to: the key file of '{name}' is a host's, and an operator listens");
        let advice = "run this on a machine with an operator's key file, or name one with --key-file";
        (Fitness::Warn, Subject::General("team".to_owned()), said, advice.to_owned())
    }))
}

/// Opens the sockets of an operator (a host outside the deployment) on all links of the host `team.host`, so that it
/// can listen to the team; `None` if that host uses no link.
pub fn operator(team: &Team) -> Result<Option<Operator>> {
    let places: Vec<Option<Place>> =
        team.links.iter().map(|place| place.as_ref().map(|place| place.for_guest(team.host))).collect();
    if places.iter().all(Option::is_none) {
        return Ok(None);
    }
    let setups = links::of_operator(&team.deployment, places.iter().map(Option::as_ref));
    open(team, &places, &setups).map(Some)
}

fn open(team: &Team, places: &[Option<Place>], setups: &[Option<Setup>]) -> Result<Operator> {
    // Observers' messages use the link of the emergency stop.
    let carries = team.deployment.links.iter().position(|link| link.carries.contains(&Kind::Stop));
    let post = carries.filter(|at| places[*at].is_some());
    let post = post.map(|at| LinkId(u16::try_from(at).expect("links are counted in u16")));
    let mut identity = links::ProcessIdentity::draw()?;
    let file = team.key_file.as_deref().map(key::read).transpose()?;
    let keep = file.as_ref().and_then(team::keep_of);
    let key = file.map(|file| file.operator_key(team.number, &mut identity)).transpose()?;
    let key = key.map(|key| key.confidential_if(team.confidential));
    let mut transports = Vec::new();
    for (at, place) in places.iter().enumerate() {
        let Some(place) = place else { continue };
        let open = place.endpoint.open(identity.operator, Filter::All).map_err(|e| anyhow!("link {at}: {e}"))?;
        transports.push((LinkId(u16::try_from(at).expect("links are counted in u16")), open));
    }
    let me = identity.operator_of(team.number);
    Ok(Operator {
        end: HostEnd { me, key, seed: identity.seed, links: setups.to_vec(), keep, transports },
        robots: team.deployment.robots,
        publishers: Routes::of(&team.deployment).publishers(),
        stop: post,
    })
}

fn hear(team: &Team, places: &[Option<Place>], setups: &[Option<Setup>], seconds: f64) -> Result<Received> {
    let (listener, echo) = (open(team, places, setups)?, open(team, places, setups)?);
    let (answers, observer) = (echo.end.me.host.0, listener.end.me.host);
    let received = Rc::new(RefCell::new(Received::default()));
    let until = Time::ZERO + Span::from_secs(seconds);
    run_real(
        Instant::now(),
        |clock, readers| {
            let heard = Rc::clone(&received);
            let listener = wire((clock, readers), listener, move |said| match said {
                Event::Peers(peers, ways) => {
                    let mut heard = heard.borrow_mut();
                    heard.peers = peers.iter().map(|p| ((p.link, p.host), p.clone())).collect();
                    heard.ways = ways.clone();
                }
                Event::Counts(counts) => heard.borrow_mut().counts = *counts,
                Event::Message(Wire::Telemetry(telemetry)) => {
                    telemetry.robots.iter().for_each(|told| heard.borrow_mut().learn(told));
                    if telemetry.revision != REVISION {
                        heard.borrow_mut().unequal.insert(telemetry.host, telemetry.revision);
                    }
                }
                Event::Message(Wire::Mode(mode)) => {
                    let mut heard = heard.borrow_mut();
                    (heard.hindrance, heard.led) = (hindrance(mode.phase, mode.latch), true);
                }
                // All others are of this process itself, or do not show how the team is.
                _ => {}
            });
            let echo = wire((clock, readers), echo, |_| {});
            observe(clock, &listener, observer);
            clock.call(until, Box::new(|| {}));
            (listener, echo)
        },
        |_, now| now >= until,
    );
    Ok(Received { echo: answers, ..received.take() })
}

fn loop_back(link: &str, echo: Option<&Peer>) -> Found {
    let what = Subject::Link { link: link.to_owned(), item: "loop-back".to_owned() };
    match echo.map(|peer| (peer.round_trip_s, peer.age_s)) {
        Some((Some(round_trip_s), _)) => {
            (Fitness::Ok, what, format!("there and back in {:.2} ms", round_trip_s * 1e3), String::new())
        }
        Some((None, Some(_))) => {
            (Fitness::Warn, what, "heard, but no answer has come back yet".to_owned(), "listen longer".to_owned())
        }
        _ => {
            let advice = "does a firewall drop UDP to the group? see 'nft list ruleset' or 'iptables -L'";
            (Fitness::Fail, what, "what this machine sends does not come back to it".to_owned(), advice.to_owned())
        }
    }
}

fn about(link: &str, host: &str, peer: Option<&Peer>) -> Found {
    let what = Subject::Peer { link: link.to_owned(), host: host.to_owned() };
    if peer.is_some_and(|peer| peer.is_former) {
        let said = "heard, and refused: it speaks the wire of the version before this one".to_owned();
        return (Fitness::Fail, what, said, "install one version of this program on all hosts".to_owned());
    }
    let Some((peer, age_s)) = peer.and_then(|peer| Some((peer, peer.age_s?))) else {
        let advice = "is it started, on this network, with this group and this key? run doctor there, too";
        return (Fitness::Warn, what, "not heard".to_owned(), advice.to_owned());
    };
    let clock = match (peer.round_trip_s, peer.uncertainty_s) {
        (Some(round_trip_s), Some(uncertainty_s)) => {
            format!("there and back in {:.2} ms, \u{b1} {:.2} ms", round_trip_s * 1e3, uncertainty_s * 1e3)
        }
        _ => "it has not answered yet".to_owned(),
    };
    let (loss, told, age_ms) = (peer.loss * 100.0, peer.reported_loss * 100.0, age_s * 1e3);
    let said = format!("heard {age_ms:.0} ms ago, loss {loss:.0} % of its, {told:.0} % of ours; {clock}");
    if peer.duplicate_ids > 0 {
        let advice = "two hosts have its name: stop one of them".to_owned();
        return (Fitness::Fail, what, format!("a second live host speaks as it; {said}"), advice);
    }
    if !peer.accepted {
        let advice = "does it hear this machine? run doctor there, too".to_owned();
        return (Fitness::Warn, what, format!("heard, but it has not shown that it has received us; {said}"), advice);
    }
    if peer.loss >= LOSSY {
        let advice = "look at the radio, or choose reliability = { latent = \"repeat\" }".to_owned();
        return (Fitness::Warn, what, said, advice);
    }
    (Fitness::Ok, what, said, String::new())
}

/// Returns the finding about a robot from what its hosts report; fields without a report are unknown.
fn about_robot(robot: RobotId, known: Option<&Condition>) -> Found {
    let what = Subject::General(format!("robot {}", robot.0));
    let Some(known) = known else {
        let advice = "are the hosts of its agent and of its motors running?".to_owned();
        return (Fitness::Warn, what, "nothing is known of it".to_owned(), advice);
    };
    let place = known.seen.map_or("place unknown".to_owned(), |seen| {
        let heading = seen.pose.heading.map_or("unknown".to_owned(), |heading| format!("{heading:.2} rad"));
        let at = seen.pose.position;
        format!("at ({:.2}, {:.2}) m, heading {heading}, measured {} ms ago", at.x, at.y, seen.age_ms)
    });
    let phase = known.phase.map_or("phase unknown", phase_name);
    let health = match known.health {
        None => "health unknown",
        Some(Health::Ready) => "ready",
        Some(Health::Faulty) => "faulty",
        Some(Health::Silent) => "its hardware does not answer",
        Some(Health::Other) => "its hardware is in a state that only a later version knows",
    };
    let battery = known.battery.map_or(String::new(), |battery| format!(", battery {battery} %"));
    let temperature = known.temperature.map_or(String::new(), |temperature| format!(", {temperature}"));
    let reason = known.reason.as_ref().map_or(String::new(), |reason| format!(": {reason}"));
    let said = format!("{place}; {phase}; {health}{reason}{battery}{temperature}");
    match known.health {
        Some(Health::Faulty | Health::Silent | Health::Other) => {
            (Fitness::Fail, what, said, "look at the robot: its driver says that something is wrong".to_owned())
        }
        _ => (Fitness::Ok, what, said, String::new()),
    }
}

fn phase_name(phase: Phase) -> &'static str {
    match phase {
        Phase::NeedReset => "stands",
        Phase::Resetting => "drives to its start",
        Phase::FinishedResetting => "is at its start",
        Phase::Running => "runs",
        Phase::FinishedRunning => "has reached its goal",
        Phase::AbortRunning => "stands, the episode has failed",
        Phase::EpisodesFinished => "stands, all episodes are over",
        Phase::Waiting => "stands, the team waits",
        Phase::Other => "stands, in a phase that only a later version knows",
    }
}

/// Returns warnings about datagrams that were refused because of a wrong key, another version of the wire format, or an
/// invalid content: each indicates a mistake in the team's setup. Causes without a refused datagram give none.
fn refusals(counts: &LinkCounts) -> Vec<Found> {
    let unknown = counts.auth.saturating_sub(counts.other_key + counts.untagged + counts.keyed + counts.confidential);
    let compare = "compare the fingerprints that doctor shows on every host";
    let all = [
        (counts.other_key, "of this team with another key than the one here", compare),
        (counts.untagged, "of this team without a key, and there is one here", "give every host the same key_file"),
        (
            counts.keyed,
            "of this team with a key, and there is none here",
            "name the team's key by key_file or --key-file",
        ),
        (
            counts.confidential,
            "of this team that are encrypted, and those of this machine are not, or the reverse",
            "give every host the same 'confidential' in the team file",
        ),
        (unknown, "with another key or none", compare),
        (counts.version, "of another version of the wire", "install one version of this program on all hosts"),
        (counts.malformed, "that are no messages", "find out who else sends to these groups, or choose others"),
    ];
    let found = |(count, what, advice): (u64, &str, &str)| {
        let said = format!("{count} datagrams {what}");
        (Fitness::Warn, Subject::General("refused".to_owned()), said, advice.to_owned())
    };
    all.into_iter().filter(|(count, ..)| *count > 0).map(found).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_robot_is_driven_beside_a_team_that_is_stopped_or_in_an_episode() {
        let clear = Latch::default();
        for phase in [Phase::NeedReset, Phase::Resetting, Phase::Running, Phase::AbortRunning] {
            assert!(hindrance(phase, clear).is_some_and(|why| why.contains("episode")), "{phase:?}");
        }
        for phase in [Phase::Waiting, Phase::EpisodesFinished] {
            assert_eq!(hindrance(phase, clear), None);
            assert!(hindrance(phase, Latch::engaged(1)).is_some_and(|why| why.contains("stop is engaged")));
            assert!(hindrance(phase, Latch::held(2)).is_some_and(|why| why.contains("held")));
        }
    }

    #[test]
    fn who_is_not_heard_is_a_warning_and_a_lost_loop_back_a_failure() {
        let (status, what, said, advice) = about("infra", "world", None);
        assert_eq!(
            (status, what.to_string(), &*said),
            (Fitness::Warn, "link infra, host world".to_owned(), "not heard")
        );
        assert!(advice.contains("is it started"), "{advice}");
        let (status, what, _, advice) = loop_back("infra", None);
        assert_eq!((status, what.to_string()), (Fitness::Fail, "link infra, loop-back".to_owned()));
        assert!(advice.contains("firewall"), "{advice}");
    }

    #[test]
    fn a_robot_is_as_its_hosts_report_it_together() {
        let robot = RobotId(2);
        assert_eq!(about_robot(robot, None).0, Fitness::Warn);
        let mut received = Received::default();
        let none = Condition {
            robot,
            phase: None,
            seen: None,
            health: None,
            battery: None,
            temperature: None,
            reason: None,
            guard: None,
            link_age_ms: None,
            suspect: None,
        };
        received.learn(&Condition { phase: Some(Phase::Running), ..none.clone() });
        received.learn(&Condition { health: Some(Health::Faulty), battery: Some(40), ..none.clone() });
        let (status, _, said, _) = about_robot(robot, received.robots.get(&robot));
        assert_eq!((status, &*said), (Fitness::Fail, "place unknown; runs; faulty, battery 40 %"));
        received.learn(&Condition { health: Some(Health::Ready), ..none });
        let (status, _, said, _) = about_robot(robot, received.robots.get(&robot));
        assert_eq!((status, &*said), (Fitness::Ok, "place unknown; runs; ready, battery 40 %"));
    }

    #[test]
    fn refused_datagrams_are_warnings_by_their_cause() {
        let none = LinkCounts::default();
        let counts = LinkCounts { auth: 8, other_key: 2, untagged: 4, confidential: 1, malformed: 1, ..none };
        let said: Vec<String> = refusals(&counts).into_iter().map(|(_, _, said, _)| said).collect();
        assert_eq!(said.len(), 5, "{said:?}");
        assert!(said[0].starts_with("2 datagrams of this team with another key"), "{said:?}");
        assert!(
            said[2].contains("encrypted") && said[3].starts_with("1 datagrams with another key or none"),
            "the rest of those without a tag: {said:?}"
        );
    }
}
