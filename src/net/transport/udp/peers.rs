//! Addresses of the hosts of a unicast link: those of the team file, those of its names, and those from which hosts
//! have been heard since.
//!
//! A host may get another address while it runs. The others send to the address from which its last authenticated
//! datagrams came. A recording can be sent from any address, so only a datagram that proves the sender's liveness
//! changes where data goes; before, an address is a candidate, which receives only link reports (`guests.rs`). A host
//! that falls silent is sent to at its configured address as well.

use std::collections::BTreeMap;
use std::fmt;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::guests::Guests;
use crate::config::fields::{Value, host_and_port};
use crate::messages::ids::HostId;
use crate::net::protocol::link::{Guest, Standing};
use crate::net::transport::interface::within;
use crate::time::{Span, Time};

/// Time without an accepted datagram after which a host is sent to at its configured address, too, and its name is
/// resolved again.
const SILENT: Span = Span::from_millis(1000);

/// Address of a host in a team file: an IP address, or a name that is resolved while the program runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PeerAddress {
    /// IP address and port.
    At(SocketAddr),
    /// Name and port, such as `robot-2.local:7700`.
    Named(String, u16),
}

impl PeerAddress {
    /// Returns the address in a field of the type `HostAddress`.
    ///
    /// # Panics
    /// If the value is neither an address nor a name with a port.
    pub(super) fn of(value: &Value) -> PeerAddress {
        match value {
            Value::Address(at) => PeerAddress::At(*at),
            other => {
                let (name, port) = host_and_port(other.text()).expect("the field lets only names with a port through");
                // RFC 6761, section 6.3: it is the loopback address, whatever a resolver says.
                if name.trim_end_matches('.').eq_ignore_ascii_case("localhost") {
                    return PeerAddress::At(SocketAddr::from(([127, 0, 0, 1], port)));
                }
                PeerAddress::Named(name.to_owned(), port)
            }
        }
    }

    /// Returns the IP address; `None` for a name.
    pub(super) fn fixed(&self) -> Option<SocketAddr> {
        if let PeerAddress::At(at) = self { Some(*at) } else { None }
    }

    /// Returns the port.
    pub(super) fn port(&self) -> u16 {
        match self {
            PeerAddress::At(at) => at.port(),
            PeerAddress::Named(_, port) => *port,
        }
    }

    /// Whether the address is one of this machine only. A name may lead to any address.
    pub(super) fn is_loopback(&self) -> bool {
        self.fixed().is_some_and(|at| at.ip().is_loopback())
    }
}

impl fmt::Display for PeerAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            PeerAddress::At(at) => write!(f, "{at}"),
            PeerAddress::Named(name, port) => write!(f, "{name}:{port}"),
        }
    }
}

/// Whether two addresses are the same, whatever scope they have: that of one which a datagram came from is known.
fn is_same(one: SocketAddr, other: SocketAddr) -> bool {
    (one.ip(), one.port()) == (other.ip(), other.port())
}

/// Where one host of the link is.
#[derive(Clone, Debug)]
struct Peer {
    /// Address of the team file, or that of its name; `None` for a name that is not resolved yet.
    configured: Option<SocketAddr>,
    /// Address of the last accepted datagram, and its time.
    heard: Option<(SocketAddr, Time)>,
    /// Flag that makes a thread resolve the host's name again; `None` without a name.
    unknown: Option<Arc<AtomicBool>>,
}

impl Peer {
    /// Returns where datagrams go at `now`: to where the host was heard, and if that is long ago also to where it
    /// should be.
    fn addresses(&self, now: Time) -> impl Iterator<Item = SocketAddr> + use<> {
        let heard = self.heard.filter(|(_, at)| now.since(*at) < SILENT);
        let silent = heard.is_none();
        if let Some(unknown) = self.unknown.as_ref().filter(|unknown| unknown.load(Ordering::Relaxed) != silent) {
            unknown.store(silent, Ordering::Relaxed);
        }
        let last = self.heard.map(|(at, _)| at);
        let configured = self.configured.filter(|at| silent && last.is_none_or(|last| !is_same(last, *at)));
        last.into_iter().chain(configured)
    }
}

/// Addresses of the hosts of one unicast link, and of its guests.
#[derive(Clone, Debug)]
pub(super) struct Peers {
    all: BTreeMap<HostId, Peer>,
    guests: Guests,
    /// Whether hosts outside the team file are sent to; a guest itself communicates only with hosts.
    takes_guests: bool,
    /// Number of the network interface, which is the scope of addresses of the link; zero for any.
    index: u32,
}

impl Peers {
    /// Returns the addresses before any datagram. `takes_guests` says whether hosts outside the team file, such as
    /// operators, are sent to.
    pub(super) fn new(configured: impl IntoIterator<Item = (HostId, PeerAddress)>, takes_guests: bool) -> Peers {
        let peer = |at: PeerAddress| {
            let unknown = matches!(at, PeerAddress::Named(..)).then(|| Arc::new(AtomicBool::new(true)));
            Peer { configured: at.fixed(), heard: None, unknown }
        };
        let all = configured.into_iter().map(|(host, at)| (host, peer(at))).collect();
        Peers { all, guests: Guests::default(), takes_guests, index: 0 }
    }

    /// Sets the number of the network interface of the link's sockets.
    pub(super) fn set_interface(&mut self, index: u32) {
        self.index = index;
    }

    /// Returns the flag by which a host's name is resolved again; `None` for a host without a name.
    pub(super) fn unknown(&self, host: HostId) -> Option<Arc<AtomicBool>> {
        self.all.get(&host)?.unknown.clone()
    }

    /// Sets the address to which a host's name was resolved.
    pub(super) fn resolved(&mut self, host: HostId, at: SocketAddr) {
        if let Some(peer) = self.all.get_mut(&host) {
            peer.configured = Some(at);
        }
    }

    /// Records the address `guest.at` of a host, from which a datagram has arrived at `now`. Returns whether data goes
    /// to another address than before.
    pub(super) fn admit(&mut self, now: Time, guest: Guest) -> bool {
        let Some(peer) = self.all.get_mut(&guest.host) else {
            if self.takes_guests {
                self.guests.admit(now, guest);
            }
            return false;
        };
        let before = peer.heard.map(|(at, _)| at).or(peer.configured);
        match guest.standing {
            Standing::Accepted => {
                self.guests.forget(guest.host, guest.at);
                peer.heard = Some((guest.at, now));
                before.is_some_and(|before| !is_same(before, guest.at))
            }
            // Where data goes already, reports go, too.
            Standing::Candidate if peer.addresses(now).any(|at| is_same(at, guest.at)) => false,
            Standing::Candidate => {
                self.guests.admit(now, guest);
                false
            }
        }
    }

    /// Returns where a datagram to one host goes; nowhere for an unknown one.
    pub(super) fn of(&self, now: Time, host: HostId) -> Vec<SocketAddr> {
        let index = self.index;
        let peer = self.all.get(&host).map(|peer| peer.addresses(now).map(|at| within(at, index)).collect());
        peer.unwrap_or_else(|| self.guests.find(now, host).into_iter().collect())
    }

    /// Returns where a datagram to all hosts goes.
    pub(super) fn all(&mut self, now: Time) -> impl Iterator<Item = SocketAddr> {
        let index = self.index;
        let hosts = self.all.values().flat_map(move |peer| peer.addresses(now)).map(move |at| within(at, index));
        hosts.chain(self.guests.accepted(now))
    }

    /// Returns further addresses that only link reports are sent to: of hosts and guests that have not proved their
    /// liveness from there.
    pub(super) fn candidates(&mut self, now: Time) -> impl Iterator<Item = SocketAddr> {
        self.guests.candidates(now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOST: HostId = HostId(2);

    fn at(port: u16) -> SocketAddr {
        SocketAddr::from(([127, 0, 0, 1], port))
    }

    fn ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    fn heard(port: u16, standing: Standing) -> Guest {
        Guest { host: HOST, at: at(port), standing }
    }

    fn peers() -> Peers {
        Peers::new([(HOST, PeerAddress::At(at(1)))], true)
    }

    #[test]
    fn a_host_is_sent_to_where_it_was_last_accepted_and_after_a_second_of_silence_also_where_it_should_be() {
        let mut peers = peers();
        assert_eq!(peers.of(ms(0), HOST), [at(1)]);
        assert!(!peers.admit(ms(0), heard(1, Standing::Accepted)));
        assert!(peers.admit(ms(100), heard(9, Standing::Accepted)), "it has moved");
        assert_eq!((peers.of(ms(1099), HOST), peers.all(ms(1099)).collect()), (vec![at(9)], vec![at(9)]));
        assert_eq!(peers.of(ms(1100), HOST), [at(9), at(1)]);
        assert!(peers.admit(ms(1200), heard(1, Standing::Accepted)), "it is back");
        assert_eq!(peers.of(ms(9000), HOST), [at(1)], "one address is sent to once");
    }

    #[test]
    fn an_address_without_a_proof_of_liveness_gets_reports_and_no_data() {
        let mut peers = peers();
        assert!(!peers.admit(ms(0), heard(9, Standing::Candidate)));
        assert_eq!(peers.of(ms(0), HOST), [at(1)]);
        assert_eq!(peers.candidates(ms(0)).collect::<Vec<_>>(), [at(9)]);
        assert!(!peers.admit(ms(0), heard(1, Standing::Candidate)), "it gets them anyway");
        assert_eq!(peers.candidates(ms(0)).count(), 1);
        peers.admit(ms(1), heard(9, Standing::Accepted));
        assert_eq!((peers.of(ms(1), HOST), peers.candidates(ms(1)).count()), (vec![at(9)], 0));
    }

    #[test]
    fn a_name_is_resolved_again_while_its_host_is_silent_and_not_while_it_is_heard() {
        let mut peers = Peers::new([(HOST, PeerAddress::Named("robot-2.local".to_owned(), 7700))], true);
        let unknown = peers.unknown(HOST).expect("it has a name");
        assert!(peers.of(ms(0), HOST).is_empty() && unknown.load(Ordering::Relaxed), "it is nowhere yet");
        peers.resolved(HOST, at(1));
        assert_eq!(peers.of(ms(1), HOST), [at(1)]);
        peers.admit(ms(1), heard(1, Standing::Accepted));
        assert!(peers.of(ms(1000), HOST) == [at(1)] && !unknown.load(Ordering::Relaxed));
        assert!(peers.all(ms(1001)).count() == 1 && unknown.load(Ordering::Relaxed), "silent for a second");
        peers.resolved(HOST, at(5));
        assert_eq!(peers.of(ms(1200), HOST), [at(1), at(5)]);
    }

    #[test]
    fn localhost_is_this_machine_and_any_other_name_may_be_anywhere() {
        let read = |text: &str| PeerAddress::of(&Value::Text(text.to_owned()));
        assert_eq!(read("localhost:7"), PeerAddress::At(at(7)));
        assert!(read("LocalHost.:7").is_loopback() && !read("robot:7").is_loopback());
        assert_eq!(read("robot:7").to_string(), "robot:7");
    }
}
