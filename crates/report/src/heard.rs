//! Hosts that a host hears, directly and over hops, and how it sends, as it reports them while it runs.

use serde::{Deserialize, Serialize};

use murmurate::messages::ids::HostId;
use murmurate::net::protocol::sender::Peer;
use murmurate::net::protocol::ways::Ways;

/// Host that is heard directly on a link.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Direct {
    /// Id of the host that is heard.
    pub host: u16,
    /// Id of the link.
    pub link: u16,
    /// Time since its last datagram \[s\].
    pub age_s: f64,
    /// Share (0 to 1) of its newest 64 datagrams whose first transmission was lost.
    pub loss: f64,
    /// Whether it passes nothing on, on a mesh on which it would have had to.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub withholds: bool,
}

/// Hosts that a host hears, and how it sends.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Heard {
    /// Hosts of the team that are heard directly, on each link.
    pub direct: Vec<Direct>,
    /// Last hops of the soft state of others, and decisions of links that choose.
    #[serde(flatten)]
    pub ways: Ways,
}

impl Heard {
    /// Returns what a host hears by its links' summaries of the others; `None` if it has neither a mesh nor a link that
    /// chooses.
    pub fn of(peers: &[Peer], ways: &Ways) -> Option<Heard> {
        let team = peers.iter().filter(|peer| peer.accepted && !HostId(peer.host).is_operator());
        let direct = team.filter_map(|peer| {
            let (host, link, loss, withholds) = (peer.host, peer.link, peer.loss, peer.withholds);
            Some(Direct { host, link, age_s: peer.age_s?, loss, withholds })
        });
        (!ways.are_plain()).then(|| Heard { direct: direct.collect(), ways: ways.clone() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::net::protocol::ways::LastHop;

    #[test]
    fn what_a_host_hears_is_read_from_json_unchanged() {
        let direct = vec![Direct { host: 1, link: 0, age_s: 0.05, loss: 0.125, withholds: false }];
        let hops = Some(vec![LastHop { host: 4, by: 1, age_s: 0.25 }]);
        let heard = Heard { direct, ways: Ways { hops, ..Ways::default() } };
        let text = serde_json::to_string(&heard).expect("it is JSON");
        let said =
            r#"{"direct":[{"host":1,"link":0,"age_s":0.05,"loss":0.125}],"hops":[{"host":4,"by":1,"age_s":0.25}]}"#;
        assert_eq!(text, said);
        assert_eq!(serde_json::from_str::<Heard>(&text).expect("it is read"), heard);
    }

    #[test]
    fn a_host_with_fixed_links_and_no_mesh_reports_nothing() {
        assert_eq!(Heard::of(&[], &Ways::default()), None);
        let alone = Ways { hops: Some(Vec::new()), ..Ways::default() };
        assert_eq!(Heard::of(&[], &alone).expect("it has a mesh").direct, []);
    }
}
