//! Checks of a mesh and of links that choose: whom this machine hears directly and over hops, and which way a link
//! would take.

use std::collections::BTreeMap;

use murmurate::deploy::Deployment;
use murmurate::fitness::Fitness;
use murmurate::net::protocol::choice::{Decision, Measured};
use murmurate::net::protocol::sender::Peer;
use murmurate::net::protocol::ways::{Sending, Ways};

use super::finding::{Found, Subject};

/// Age of the newest datagram, or of soft state, from which on a host counts as not heard \[s\].
const LOST_S: f64 = 2.0;
/// Rate of states that is assumed where the deployment sets none \[1/s\]: that of the policies that are supplied.
const STATES_HZ: f64 = 20.0;

/// Way by which a host of a mesh is heard.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Reach {
    /// By its own datagrams.
    Direct,
    /// By this neighbour, over two hops or, if the flag is set, over more.
    Over(u16, bool),
    /// Not at all.
    Lost,
}

/// Returns how each host of the team, in the order of their ids, is heard on a mesh: by its link `link`, or over hops.
fn reaches(hosts: usize, link: u16, peers: &BTreeMap<(u16, u16), Peer>, ways: &Ways) -> Vec<Reach> {
    let reach = |host: u16| {
        let peer = peers.get(&(link, host));
        if peer.is_some_and(|peer| peer.age_s.is_some_and(|age_s| age_s < LOST_S)) {
            return Reach::Direct;
        }
        let hop = ways.hops.iter().flatten().find(|hop| hop.host == host && hop.age_s < LOST_S);
        let Some(hop) = hop.filter(|hop| hop.by != host) else { return Reach::Lost };
        let hears = ways.overheard.iter().any(|one| (one.at, one.host) == (hop.by, host));
        Reach::Over(hop.by, !hears)
    };
    (0..=u16::MAX).take(hosts).map(reach).collect()
}

/// Returns what replaces the finding that a host is not heard on a link: how it is heard over hops. `None` if it is
/// not.
pub fn over_hops(
    deployment: &Deployment,
    (link, host): (u16, usize),
    peers: &BTreeMap<(u16, u16), Peer>,
    ways: &Ways,
) -> Option<Found> {
    let known = deployment.links.get(usize::from(link)).filter(|known| known.mesh)?;
    let reach = reaches(deployment.hosts.len(), link, peers, ways);
    let Reach::Over(by, more) = *reach.get(host)? else { return None };
    let name = |host: usize| deployment.hosts.get(host).map_or("a host", |host| &*host.name);
    let what = Subject::Peer { link: known.name.clone(), host: name(host).to_owned() };
    let hops = if more { "three hops or more" } else { "two hops" };
    let said = format!("heard over {hops}, by '{}', and not directly", name(usize::from(by)));
    Some((Fitness::Ok, what, said, String::new()))
}

/// Returns the findings about each link of a mesh and each link that chooses.
pub fn findings(deployment: &Deployment, peers: &BTreeMap<(u16, u16), Peer>, ways: &Ways) -> Vec<Found> {
    let numbered = || (0..=u16::MAX).zip(&deployment.links);
    // Without a mesh here, none of its links is one of this machine.
    let meshes = numbered().filter(|(_, link)| link.mesh && ways.hops.is_some());
    let of_mesh = meshes.map(|(number, _)| mesh(deployment, number, peers, ways));
    let chosen = ways.sends.iter().map(|sends| way(deployment, sends, peers));
    of_mesh.chain(chosen).collect()
}

/// Returns who is heard directly, over hops and not at all on the link `link`, and what follows from it.
fn mesh(deployment: &Deployment, link: u16, peers: &BTreeMap<(u16, u16), Peer>, ways: &Ways) -> Found {
    let name = |host: usize| deployment.hosts.get(host).map_or("a host", |host| &*host.name);
    let what = Subject::Link { link: deployment.links[usize::from(link)].name.clone(), item: "mesh".to_owned() };
    let reach: Vec<(usize, Reach)> =
        reaches(deployment.hosts.len(), link, peers, ways).into_iter().enumerate().collect();
    let of = |wanted: fn(&Reach) -> bool| -> Vec<String> {
        reach.iter().filter(|(_, reach)| wanted(reach)).map(|(host, _)| name(*host).to_owned()).collect()
    };
    let direct = of(|reach| *reach == Reach::Direct);
    let (two, more) =
        (of(|reach| matches!(reach, Reach::Over(_, false))), of(|reach| matches!(reach, Reach::Over(_, true))));
    let lost = of(|reach| *reach == Reach::Lost);
    let parts = [("directly", &direct), ("over two hops", &two), ("over more", &more), ("not heard", &lost)];
    let said: Vec<String> = parts
        .into_iter()
        .filter(|(_, hosts)| !hosts.is_empty())
        .map(|(how, hosts)| format!("{how}: {}", hosts.join(", ")))
        .collect();
    let said = said.join("; ");
    if !lost.is_empty() {
        let advice = if direct.is_empty() {
            "start the team, and run this where one of its hosts is in reach"
        } else {
            "is it started? else put a robot between, or raise power: one that the state server does not hear stands"
        };
        return (Fitness::Warn, what, said, advice.to_owned());
    }
    let by: Vec<u16> =
        reach.iter().filter_map(|(_, reach)| if let Reach::Over(by, _) = reach { Some(*by) } else { None }).collect();
    match by.first().filter(|first| direct.len() == 1 && by.iter().all(|by| by == *first)) {
        Some(only) => {
            let only = name(usize::from(*only));
            let advice = format!("put another robot in reach: without '{only}' this machine is cut off from all");
            (Fitness::Warn, what, format!("{said}; all by '{only}' alone"), advice)
        }
        None => (Fitness::Ok, what, said, String::new()),
    }
}

/// Returns which way a link that chooses would take with the hosts that are heard, by the pairs and the loss that were
/// measured while listening.
fn way(deployment: &Deployment, sends: &Sending, peers: &BTreeMap<(u16, u16), Peer>) -> Found {
    let known = &deployment.links[usize::from(sends.link)];
    let what = Subject::Link { link: known.name.clone(), item: "way".to_owned() };
    let near =
        peers.iter().filter(|((link, host), _)| *link == sends.link && usize::from(*host) < deployment.hosts.len());
    let near = near.filter(|(_, peer)| peer.age_s.is_some_and(|age_s| age_s < LOST_S));
    let loss: Vec<f64> = near.map(|(_, peer)| peer.reported_loss).collect();
    if loss.is_empty() {
        let advice = "start the other hosts, and listen again: --listen 10 measures a dozen pairs of frames".to_owned();
        return (
            Fitness::Warn,
            what,
            "unknown: it is chosen by what other hosts send, and none is heard".to_owned(),
            advice,
        );
    }
    // A host that runs here is one of those that are heard.
    let hosts = (loss.len() + 1).min(deployment.hosts.len());
    let states_hz = deployment.latent_rate_hz.unwrap_or(STATES_HZ);
    let (multicast_s, unicast_s) = (sends.multicast_s, sends.unicast_s);
    let measured = Measured { hosts, states_hz, loss, multicast_s, unicast_s, congested: sends.congested };
    let decided = Decision::first(measured).told(murmurate::messages::ids::LinkId(sends.link));
    let ms = |time_s: Option<f64>| time_s.map_or("unknown".to_owned(), |time_s| format!("{:.2} ms", 1e3 * time_s));
    let said = format!(
        "{}: {}; loss {:.0} %, frames of {} by multicast and {} by unicast",
        decided.in_words(),
        decided.why,
        100.0 * decided.loss,
        ms(multicast_s),
        ms(unicast_s)
    );
    match decided.sent_hz < states_hz {
        true => {
            (Fitness::Warn, what, said, "raise the rate of multicast (docs/wifi.md), or send fewer states".to_owned())
        }
        false => (Fitness::Ok, what, said, String::new()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::deploy::team::TeamFile;
    use murmurate::net::protocol::ways::{LastHop, Overheard};

    fn deployment() -> Deployment {
        let text = std::fs::read_to_string("../../teams/mesh.toml").expect("the team is there");
        let file = TeamFile::read(&crate::registry(), &text, std::path::Path::new(""), &[], &[]).expect("it is sound");
        file.deployment().clone()
    }

    /// Peers of a machine that hears these hosts directly on link 0.
    fn peers(near: &[u16]) -> BTreeMap<(u16, u16), Peer> {
        let peer = |host: u16| Peer::heard(0, host, 0.05, 0.16);
        near.iter().map(|host| ((0, *host), peer(*host))).collect()
    }

    fn hop(host: u16, by: u16) -> LastHop {
        LastHop { host, by, age_s: 0.2 }
    }

    #[test]
    fn hosts_are_named_by_how_far_they_are() {
        let hops = vec![hop(0, 0), hop(1, 1), hop(2, 1), hop(3, 1), LastHop { age_s: 9.0, ..hop(4, 1) }];
        let overheard = vec![Overheard { at: 1, host: 2, loss: 0.0, age_s: 0.5 }];
        let ways = Ways { hops: Some(hops), overheard, sends: Vec::new() };
        let (deployment, peers) = (deployment(), peers(&[0, 1]));
        let found = findings(&deployment, &peers, &ways);
        let [(status, what, said, advice)] = &found[..] else { panic!("one finding: {found:?}") };
        let expected = "directly: robot-0, robot-1; over two hops: robot-2; over more: robot-3; not heard: robot-4";
        assert_eq!((*status, &*what.to_string(), &**said), (Fitness::Warn, "link ad-hoc, mesh", expected));
        assert!(advice.contains("put a robot between"), "{advice}");
        let (status, _, said, _) = over_hops(&deployment, (0, 3), &peers, &ways).expect("it is heard over hops");
        assert_eq!((status, &*said), (Fitness::Ok, "heard over three hops or more, by 'robot-1', and not directly"));
        assert_eq!(over_hops(&deployment, (0, 4), &peers, &ways), None, "that is long ago");
        assert_eq!(over_hops(&deployment, (1, 3), &peers, &ways), None, "no mesh");
    }

    #[test]
    fn a_machine_that_hears_all_by_one_neighbour_is_told_so() {
        let ways = |hops| Ways { hops: Some(hops), ..Ways::default() };
        let found = mesh(&deployment(), 0, &peers(&[1]), &ways([0, 2, 3, 4].map(|host| hop(host, 1)).to_vec()));
        assert!(found.0 == Fitness::Warn && found.2.ends_with("all by 'robot-1' alone"), "{found:?}");
        let found = mesh(&deployment(), 0, &peers(&[0, 1, 2, 3, 4]), &ways(Vec::new()));
        assert_eq!((found.0, &*found.2), (Fitness::Ok, "directly: robot-0, robot-1, robot-2, robot-3, robot-4"));
        let found = mesh(&deployment(), 0, &peers(&[]), &ways(Vec::new()));
        assert!(found.3.starts_with("start the team"), "{found:?}");
    }

    #[test]
    fn a_link_that_chooses_says_which_way_and_why_or_that_it_needs_others() {
        let empty = Measured::default();
        let start = Decision::first(empty).told(murmurate::messages::ids::LinkId(0));
        let found = way(&deployment(), &start, &peers(&[]));
        assert!(found.0 == Fitness::Warn && found.3.contains("start the other hosts"), "{found:?}");
        let sends = Sending { multicast_s: Some(0.118e-3), unicast_s: Some(0.11e-3), ..start.clone() };
        let found = way(&deployment(), &sends, &peers(&[0, 1, 2, 3, 4]));
        let said = "2.9 transmissions by multicast, 20.0 Hz, load 5 %: unicast would take 1.6 times the time of the \
                    medium; \
                    loss 16 %, frames of 0.12 ms by multicast and 0.11 ms by unicast";
        assert_eq!((found.0, &*found.2), (Fitness::Ok, said));
        let slow = Sending { multicast_s: Some(60e-3), ..start };
        let found = way(&deployment(), &slow, &peers(&[0, 1, 2, 3, 4]));
        assert!(found.0 == Fitness::Warn && found.3.contains("rate of multicast"), "{found:?}");
    }
}
