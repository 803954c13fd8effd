//! Mesh of a team as its hosts report it: whom each hears directly, over how many hops, and how links that choose send.
//!
//! A host knows the neighbour by which the newest soft state of another has come, and no more of its way. So the hops
//! are counted from report to report, each of the newest soft state there; where a host on the way reports nothing,
//! they are at least so many.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

use murmurate::messages::ids::HostId;
use murmurate::time::{Span, Time};
use murmurate_report::heard::Heard;

/// Age from which on a report of a host is not used; hosts report once a second.
const REPORTED: Span = Span::from_millis(3_500);
/// Time without a datagram, or without soft state, after which a host counts as lost \[s\].
const LOST_S: f64 = 2.0;
/// Time without a word of a neighbour about another host after which the two count as apart \[s\].
const OVERHEARD_S: f64 = 6.0;
/// Largest number of pairs of robots that the page gets.
const MOST_PAIRS: usize = 6000;

/// Mesh of a team, from the reports of its hosts.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Names of the hosts, in the order of their ids.
    names: Vec<String>,
    /// Host of the state server.
    server: Option<HostId>,
    reports: BTreeMap<HostId, (Time, Heard)>,
    /// Time of the first report of the state server's host.
    led: Option<Time>,
    /// Hosts that the state server has lost, as the log has said.
    lost: BTreeSet<HostId>,
}

/// Number of hops over which the newest soft state of a robot has come.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RobotHops {
    /// Id of the robot.
    pub robot: u16,
    /// Number of hops: 0 on the same host, 1 if it is heard directly.
    pub hops: usize,
    /// Whether it may be more, since a host on the way reports nothing.
    pub at_least: bool,
    /// Time since it has come \[s\].
    pub age_s: f64,
}

/// Way in which the states of a host leave on a link that chooses.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HostSends {
    /// Name of the host.
    pub host: String,
    /// Decision, as text.
    pub how: String,
    /// Reason of the decision.
    pub why: String,
}

/// Mesh of a team for the live page.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct MeshStatus {
    /// Id of a robot whose host hears that of another directly, id of the other, and share lost \[%\].
    pub hears: Vec<(u16, u16, u8)>,
    /// Hops of the newest soft state of each robot of which some has come; empty without a mesh.
    pub hops: Vec<RobotHops>,
    /// Place at which these hops end: the state server, or this page if that does not report.
    pub to: &'static str,
    /// Ids of the robots that the state server has lost, by its own report.
    pub lost: Vec<u16>,
    /// Names of hosts that pass nothing on, as their neighbours find.
    pub withholding: Vec<String>,
    /// Ways by which the hosts send on links that choose.
    pub sends: Vec<HostSends>,
}

impl Mesh {
    /// Returns the mesh of hosts that have reported nothing yet, with their names and the host of the state server.
    pub fn new(names: Vec<String>, server: HostId) -> Mesh {
        Mesh { names, server: Some(server), ..Mesh::default() }
    }

    /// Takes the report of a host. Returns what to log: robots that the state server has lost, or hears again. `homes`
    /// has the host of each robot's agent.
    pub fn take(&mut self, now: Time, host: HostId, heard: Heard, homes: &[HostId]) -> Vec<String> {
        self.reports.insert(host, (now, heard));
        if self.server != Some(host) {
            return Vec::new();
        }
        self.led = self.led.or(Some(now));
        let lost = self.lost_hosts(now, homes);
        let robots = |hosts: &mut dyn Iterator<Item = &HostId>| {
            let hosts: BTreeSet<&HostId> = hosts.collect();
            let all = homes.iter().enumerate().filter(|(_, home)| hosts.contains(home)).map(|(at, _)| at.to_string());
            all.collect::<Vec<_>>().join(", ")
        };
        let (gone, back) = (robots(&mut lost.difference(&self.lost)), robots(&mut self.lost.difference(&lost)));
        self.lost = lost;
        let gone = (!gone.is_empty()).then(|| format!("the state server has lost robots: {gone}"));
        let back = (!back.is_empty()).then(|| format!("the state server hears robots again: {back}"));
        gone.into_iter().chain(back).collect()
    }

    /// Returns the newest report of a host, unless it is too old, with the time since then \[s\].
    fn report(&self, now: Time, host: HostId) -> Option<(f64, &Heard)> {
        let (at, heard) = self.reports.get(&host)?;
        let age = now.since(*at);
        (age < REPORTED).then(|| (age.as_secs(), heard))
    }

    fn reports(&self, now: Time) -> impl Iterator<Item = (HostId, f64, &Heard)> {
        self.reports.keys().filter_map(move |host| self.report(now, *host).map(|(age_s, heard)| (*host, age_s, heard)))
    }

    /// Returns the hosts of robots that the state server has neither heard nor had soft state of for two seconds.
    fn lost_hosts(&self, now: Time, homes: &[HostId]) -> BTreeSet<HostId> {
        let Some(server) = self.server else { return BTreeSet::new() };
        let settled = self.led.is_some_and(|since| now.since(since).as_secs() >= LOST_S);
        let Some((_, heard)) = self.report(now, server).filter(|_| settled) else { return BTreeSet::new() };
        let Some(hops) = &heard.ways.hops else { return BTreeSet::new() };
        let direct = heard.direct.iter().map(|one| (one.host, one.age_s));
        let near: BTreeSet<u16> = direct
            .chain(hops.iter().map(|hop| (hop.host, hop.age_s)))
            .filter(|(_, age_s)| *age_s < LOST_S)
            .map(|(host, _)| host)
            .collect();
        homes.iter().copied().filter(|home| *home != server && !near.contains(&home.0)).collect()
    }

    /// Returns which host hears which directly, with the share lost: by its own report, else as an operator has
    /// overheard.
    fn direct(&self, now: Time) -> BTreeMap<(HostId, HostId), f64> {
        let mut all = BTreeMap::new();
        for (_, _, heard) in self.reports(now) {
            let near = heard.ways.overheard.iter().filter(|one| one.age_s < OVERHEARD_S);
            all.extend(near.map(|one| ((HostId(one.at), HostId(one.host)), one.loss)));
        }
        let own: BTreeSet<HostId> = self.reports(now).map(|(host, ..)| host).collect();
        all.retain(|(at, _), _| !own.contains(at));
        for (host, _, heard) in self.reports(now) {
            let near = heard.direct.iter().filter(|one| one.age_s < LOST_S);
            all.extend(near.map(|one| ((host, HostId(one.host)), one.loss)));
        }
        all
    }

    /// Returns over how many hops the newest soft state of the host `origin` has come to `to`, whether it may be more,
    /// and its age \[s\]. `None` if none has come, or if that is long ago.
    fn hops(
        &self,
        now: Time,
        (to, origin): (HostId, HostId),
        direct: &BTreeMap<(HostId, HostId), f64>,
    ) -> Option<(usize, bool, f64)> {
        let last = |at: HostId| {
            let (since_s, heard) = self.report(now, at)?;
            let hop = heard.ways.hops.as_ref()?.iter().find(|hop| hop.host == origin.0)?;
            Some((HostId(hop.by), hop.age_s + since_s))
        };
        let (mut by, age_s) = last(to).filter(|(_, age_s)| *age_s < REPORTED.as_secs())?;
        let mut hops = 1;
        let mut passed = BTreeSet::from([to]);
        // Reports are of different instants, so the ways of a changing mesh may lead in a circle.
        while by != origin && passed.insert(by) {
            hops += 1;
            match last(by) {
                Some((next, _)) => by = next,
                None => return Some((hops, !direct.contains_key(&(by, origin)), age_s)),
            }
        }
        Some((hops, by != origin, age_s))
    }

    /// Returns the mesh for the page at the time `now`; `None` if no host has reported any. `homes` has the host of
    /// each robot's agent.
    pub fn status(&self, now: Time, homes: &[HostId]) -> Option<MeshStatus> {
        let page = self.reports(now).map(|(host, ..)| host).find(|host| host.is_operator());
        let direct = self.direct(now);
        let server = self.server.filter(|server| self.report(now, *server).is_some());
        let (to, name) = match (server, page) {
            (Some(server), _) => (server, "the state server"),
            (None, Some(page)) => (page, "this page"),
            (None, None) => (self.reports(now).next()?.0, "one host"),
        };
        let numbered = || (0..=u16::MAX).zip(homes.iter().copied());
        let pairs = numbered().flat_map(|one| numbered().map(move |other| (one, other)));
        let hears = pairs.filter_map(|((one, at), (other, host))| {
            let loss = direct.get(&(at, host)).filter(|_| at != host)?;
            Some((one, other, (100.0 * loss).round() as u8))
        });
        let hops = numbered().filter_map(|(robot, home)| {
            if home == to {
                let on_mesh = self.report(now, to)?.1.ways.hops.is_some();
                return on_mesh.then_some(RobotHops { robot, hops: 0, at_least: false, age_s: 0.0 });
            }
            let (hops, at_least, age_s) = self.hops(now, (to, home), &direct)?;
            Some(RobotHops { robot, hops, at_least, age_s })
        });
        let withholding = self.reports(now).flat_map(|(.., heard)| &heard.direct).filter(|one| one.withholds);
        let withholding: BTreeSet<u16> = withholding.map(|one| one.host).collect();
        let sends = self.reports(now).filter(|(host, ..)| !host.is_operator()).flat_map(|(host, _, heard)| {
            let said = heard.ways.sends.iter();
            said.map(move |sends| HostSends { host: self.name(host), how: sends.in_words(), why: sends.why.clone() })
        });
        Some(MeshStatus {
            hears: hears.take(MOST_PAIRS).collect(),
            hops: hops.collect(),
            to: name,
            lost: numbered().filter(|(_, home)| self.lost.contains(home)).map(|(robot, _)| robot).collect(),
            withholding: withholding.into_iter().map(|host| self.name(HostId(host))).collect(),
            sends: sends.collect(),
        })
    }

    fn name(&self, host: HostId) -> String {
        self.names.get(usize::from(host.0)).cloned().unwrap_or_else(|| format!("host {}", host.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::net::protocol::ways::{LastHop, Overheard, Sending, Ways};
    use murmurate_report::heard::Direct;

    fn at(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    /// Report of a host of a line of five, which hears its two neighbours: the newest soft state of all comes by these.
    fn in_line(host: u16) -> Heard {
        let near = [host.checked_sub(1), Some(host + 1).filter(|next| *next < 5)].into_iter().flatten();
        let direct = near.map(|host| Direct { host, link: 0, age_s: 0.04, loss: 0.25, withholds: false }).collect();
        let others = (0..5).filter(|other| *other != host);
        let by = |other| if other < host { host - 1 } else { host + 1 };
        let hops = others.map(|other| LastHop { host: other, by: by(other), age_s: 0.1 }).collect();
        Heard { direct, ways: Ways { hops: Some(hops), ..Ways::default() } }
    }

    fn line() -> (Mesh, Vec<HostId>) {
        let names = (0..5).map(|host| format!("robot-{host}")).collect();
        (Mesh::new(names, HostId(0)), (0..5).map(HostId).collect())
    }

    fn hops(status: &MeshStatus) -> Vec<(u16, usize, bool)> {
        status.hops.iter().map(|one| (one.robot, one.hops, one.at_least)).collect()
    }

    #[test]
    fn hops_are_counted_from_report_to_report() {
        let (mut mesh, homes) = line();
        assert_eq!(mesh.status(at(0), &homes), None, "nothing is made up");
        for host in 0..5 {
            assert!(mesh.take(at(0), HostId(host), in_line(host), &homes).is_empty());
        }
        let status = mesh.status(at(500), &homes).expect("all have reported");
        assert_eq!(hops(&status), (0..5).map(|robot| (robot, usize::from(robot), false)).collect::<Vec<_>>());
        assert_eq!(status.hears[..3], [(0, 1, 25), (1, 0, 25), (1, 2, 25)]);
        assert_eq!((status.hears.len(), status.to), (8, "the state server"));
    }

    #[test]
    fn where_a_host_on_the_way_reports_nothing_hops_are_a_lower_bound() {
        let (mut mesh, homes) = line();
        for host in [0, 1] {
            mesh.take(at(0), HostId(host), in_line(host), &homes);
        }
        let status = mesh.status(at(0), &homes).expect("two have reported");
        let expected = vec![(0, 0, false), (1, 1, false), (2, 2, false), (3, 3, true), (4, 3, true)];
        assert_eq!(hops(&status), expected);
    }

    #[test]
    fn an_operator_alone_counts_by_what_it_overhears() {
        let (mut mesh, homes) = line();
        let overheard = vec![Overheard { at: 1, host: 2, loss: 0.0, age_s: 1.0 }];
        let ways = Ways { overheard, ..in_line(0).ways };
        let operator = HostId::operator(3);
        mesh.take(at(0), operator, Heard { ways, ..in_line(0) }, &homes);
        let status = mesh.status(at(0), &homes).expect("the operator hears");
        let near = vec![(1, 1, false), (2, 2, false), (3, 2, true), (4, 2, true)];
        assert_eq!((hops(&status), status.to), (near, "this page"));
        assert_eq!(status.hears, [(1, 2, 0)]);
    }

    #[test]
    fn robots_that_the_state_server_has_lost_are_named_once_and_when_they_are_back() {
        let (mut mesh, homes) = line();
        assert!(mesh.take(at(0), HostId(0), Heard { direct: Vec::new(), ..in_line(0) }, &homes).is_empty());
        let mut split = in_line(0);
        split.ways.hops.iter_mut().flatten().filter(|hop| hop.host > 2).for_each(|hop| hop.age_s = 2.5);
        let said = mesh.take(at(2000), HostId(0), split.clone(), &homes);
        assert_eq!(said, ["the state server has lost robots: 3, 4"]);
        assert!(mesh.take(at(3000), HostId(0), split, &homes).is_empty());
        assert_eq!(mesh.status(at(3000), &homes).expect("it reports").lost, [3, 4]);
        let said = mesh.take(at(4000), HostId(0), in_line(0), &homes);
        assert_eq!(said, ["the state server hears robots again: 3, 4"]);
    }

    #[test]
    fn a_state_server_that_hears_no_host_has_lost_all_and_old_reports_do_not_count() {
        let (mut mesh, homes) = line();
        let alone = || Heard { direct: Vec::new(), ways: Ways { hops: Some(Vec::new()), ..Ways::default() } };
        assert!(mesh.take(at(0), HostId(0), alone(), &homes).is_empty(), "it has just begun");
        assert_eq!(mesh.take(at(2000), HostId(0), alone(), &homes), ["the state server has lost robots: 1, 2, 3, 4"]);
        assert_eq!(mesh.status(at(9000), &homes), None);
    }

    #[test]
    fn reports_of_different_instants_may_lead_in_a_circle() {
        let (mut mesh, homes) = line();
        let by = |by| Heard {
            direct: Vec::new(),
            ways: Ways { hops: Some(vec![LastHop { host: 4, by, age_s: 0.1 }]), ..Ways::default() },
        };
        mesh.take(at(0), HostId(0), by(1), &homes);
        mesh.take(at(0), HostId(1), by(2), &homes);
        mesh.take(at(0), HostId(2), by(1), &homes);
        let status = mesh.status(at(0), &homes).expect("they have reported");
        assert_eq!(hops(&status), [(0, 0, false), (4, 3, true)]);
    }

    #[test]
    fn decisions_and_hosts_that_pass_nothing_on_are_named() {
        let (mut mesh, homes) = line();
        let mut heard = in_line(1);
        heard.direct[0].withholds = true;
        heard.ways.hops = None;
        let text = r#"{"link":0,"way":"unicast","copies":1.0,"states_hz":20.0,"sent_hz":20.0,"hosts":5,"loss":0.0,
            "load":0.05,"multicast_s":null,"unicast_s":null,"congested":false,"slot":null,"age_s":null,"why":"so"}"#;
        heard.ways.sends = vec![serde_json::from_str::<Sending>(text).expect("a decision")];
        mesh.take(at(0), HostId(1), heard, &homes);
        let status = mesh.status(at(0), &homes).expect("it has reported");
        let how = "unicast to each host, 20.0 Hz, load 5 %".to_owned();
        assert_eq!(status.sends, [HostSends { host: "robot-1".to_owned(), how, why: "so".to_owned() }]);
        assert_eq!(
            (status.withholding, hops(&mesh.status(at(0), &homes).expect("the same"))),
            (vec!["robot-0".to_owned()], vec![])
        );
    }
}
