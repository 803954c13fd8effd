//! Thread that notices when a Zenoh session has to be made again: this machine reaches the router from another address
//! or by another interface, or an address at which the session listens was away. The library itself notices a silent
//! router after two seconds, and a router refuses a session's second connection as long as it knows the first.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use murmurate::net::transport::interface::{Interface, interfaces};
use murmurate::net::transport::link_watch::LinkWatch;

/// Longest time between two looks, where the kernel tells of no change.
const LOOK: Duration = Duration::from_millis(500);

/// Addresses of an endpoint: those of this machine that a session uses for it.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Place {
    /// Address from which this machine reaches an endpoint, and the number of its interface.
    Here(IpAddr, u32),
    /// There is no route to the endpoint, or the address to listen at is not there.
    Away,
    /// An endpoint with a name, for which any change counts: all addresses of this machine, with their interfaces.
    Any(Vec<(IpAddr, u32)>),
}

impl Place {
    fn is_away(&self) -> bool {
        *self == Place::Away || *self == Place::Any(Vec::new())
    }

    /// Whether the interface with this number is used.
    fn uses(&self, removed: impl Fn(u32) -> bool) -> bool {
        match self {
            Place::Here(_, index) => removed(*index),
            Place::Away => false,
            Place::Any(all) => all.iter().any(|(_, index)| removed(*index)),
        }
    }
}

/// Endpoints of a session, such as `udp/10.0.0.1:7447`.
#[derive(Clone, Debug)]
pub(super) struct Endpoints {
    /// Endpoints that the session connects to.
    pub connect: Vec<String>,
    /// Endpoints at which it listens.
    pub listen: Vec<String>,
}

impl Endpoints {
    fn look(&self) -> Vec<Place> {
        let all = interfaces().unwrap_or_default();
        let connect = self.connect.iter().map(|endpoint| match address(endpoint) {
            Some(to) => source(to).map_or(Place::Away, |at| owned(at, &all)),
            None => Place::Any(outward(&all)),
        });
        let listen = self.listen.iter().filter_map(|endpoint| match address(endpoint) {
            // It stays open whatever happens to interfaces.
            Some(at) if at.ip().is_unspecified() => None,
            Some(at) => Some(owned(at.ip(), &all)),
            None => Some(Place::Any(outward(&all))),
        });
        connect.chain(listen).collect()
    }
}

/// Starts the thread; it sets `remake` each time that the session has to be made again, and ends once `closed` is set.
pub(super) fn watch(endpoints: Endpoints, remake: Arc<AtomicBool>, closed: Arc<AtomicBool>) -> std::io::Result<()> {
    let run = move || {
        let watch = LinkWatch::open();
        let mut used = endpoints.look();
        while !closed.load(Ordering::Relaxed) {
            let removed = watch.wait(LOOK);
            if update(&mut used, endpoints.look(), |index| removed.has(index)) {
                remake.store(true, Ordering::Relaxed);
            }
        }
    };
    thread::Builder::new().name("zenoh route".to_owned()).stack_size(256 << 10).spawn(run).map(drop)
}

/// Replaces the places `used` by those of `now`. Returns whether the session has to be made again: a place is another
/// one, was away, or its interface was `removed` and is there again. A place that is away now has to come back first.
fn update(used: &mut Vec<Place>, now: Vec<Place>, removed: impl Fn(u32) -> bool) -> bool {
    let pairs = used.iter().zip(&now);
    let again = pairs.filter(|(used, now)| !now.is_away() && (used != now || used.uses(&removed))).count() > 0;
    *used = now;
    again
}

/// Returns the IP address and port of an endpoint; `None` for a name.
fn address(endpoint: &str) -> Option<SocketAddr> {
    let (_, address) = endpoint.split_once('/')?;
    address.split(['?', '#']).next()?.parse().ok()
}

/// Returns the address from which this machine would send to `to`; `None` without a route.
fn source(to: SocketAddr) -> Option<IpAddr> {
    let any: IpAddr = if to.is_ipv6() { Ipv6Addr::UNSPECIFIED.into() } else { Ipv4Addr::UNSPECIFIED.into() };
    let socket = UdpSocket::bind((any, 0)).ok()?;
    socket.connect(to).ok()?;
    socket.local_addr().ok().map(|at| at.ip())
}

fn addresses(all: &[Interface]) -> impl Iterator<Item = (&Interface, IpAddr)> {
    all.iter().flat_map(|one| [false, true].into_iter().flat_map(move |v6| one.addresses(v6)).map(move |at| (one, at)))
}

/// Returns the place with this address of this machine.
fn owned(at: IpAddr, all: &[Interface]) -> Place {
    let own = addresses(all).find(|(_, own)| *own == at);
    match own {
        Some((interface, at)) => Place::Here(at, interface.index),
        None if at.is_loopback() => Place::Here(at, 0),
        None => Place::Away,
    }
}

fn outward(all: &[Interface]) -> Vec<(IpAddr, u32)> {
    let outward = addresses(all).filter(|(interface, _)| interface.up && !interface.loopback);
    outward.map(|(interface, at)| (at, interface.index)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_endpoint_on_this_machine_is_reached_from_its_loopback_address_and_a_name_from_any() {
        let all = |connect: &[&str], listen: &[&str]| {
            let texts = |all: &[&str]| all.iter().map(|one| (*one).to_owned()).collect();
            Endpoints { connect: texts(connect), listen: texts(listen) }.look()
        };
        let loopback = IpAddr::from([127, 0, 0, 1]);
        assert!(
            matches!(all(&["quic/127.0.0.1:1?mixed_rel=1#iface=lo"], &[])[..], [Place::Here(at, 1..)] if at == loopback)
        );
        assert!(matches!(all(&["udp/router.lan:7447"], &[])[..], [Place::Any(_)]));
        assert_eq!(all(&[], &["udp/192.0.2.77:7447"]), [Place::Away], "no machine has it (RFC 5737)");
        assert!(all(&[], &["udp/0.0.0.0:7447"]).is_empty());
    }

    #[test]
    fn a_session_is_made_again_when_its_address_is_another_or_back_and_not_when_it_goes() {
        let here = |last: u8, index| Place::Here(IpAddr::from([10, 0, 0, last]), index);
        let mut used = vec![here(1, 2), Place::Away];
        let mut step = |now: &[Place], removed: u32| update(&mut used, now.to_vec(), |index| index == removed);
        let away = Place::Away;
        assert!(!step(&[here(1, 2), away.clone()], 9), "one of two routers was never there");
        assert!(step(&[here(1, 2), away.clone()], 2), "made again within a look, with the same number");
        assert!(step(&[here(5, 2), away.clone()], 0), "another address");
        assert!(!step(&[away.clone(), away.clone()], 2), "it has to come back first");
        assert!(step(&[here(5, 3), away.clone()], 0));
        assert!(step(&[here(5, 3), here(5, 3)], 0), "the other router is reached");
    }
}
