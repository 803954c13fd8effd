//! Traffic of a comparison in real time: one thread sends datagrams from all stations at the times of a load, and
//! receives them.

use std::net::{Ipv4Addr, SocketAddrV4};
use std::os::fd::{AsFd, AsRawFd, OwnedFd};

use nix::errno::Errno;
use nix::sys::epoll::{Epoll, EpollCreateFlags, EpollEvent, EpollFlags, EpollTimeout};
use nix::sys::socket::{
    AddressFamily, IpMembershipRequest, MsgFlags, SockFlag, SockType, SockaddrIn, bind, recv, sendto, setsockopt,
    socket, sockopt,
};

use super::carrier::{Alarm, monotonic_ns, prioritize};
use super::error::{Context, Result};
use super::namespace;
use crate::file::Laboratory;
use crate::load::{Cast, DRAIN, Load, Offer, Outcome, Received};
use murmurate::time::{Span, Time};

/// Port of all stations.
const PORT: u16 = 7777;
/// Group of all stations, of the organisation-local scope (RFC 2365).
const GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 77, 9);
/// Size of a socket's receive buffer \[bytes\], so that nothing is lost there.
const BUFFER_BYTES: usize = 1 << 20;
/// Key of the timer; sockets have the number of their station.
const TIMER: u64 = u64::MAX;
/// Time until the first datagram \[ns\].
const LEAD_NS: u64 = 50_000_000;
/// Length of the beginning of a datagram, which holds its number \[bytes\].
const NUMBER_BYTES: usize = 8;

/// Sockets of all stations.
pub struct Sockets(Vec<OwnedFd>);

impl Sockets {
    /// Opens a socket in each station's namespace.
    pub fn open(lab: &Laboratory) -> Result<Sockets> {
        (0..lab.stations)
            .map(|station| namespace::inside(&lab.namespace(station), || open(lab, station)))
            .collect::<Result<_>>()
            .map(Sockets)
    }

    /// Sends the datagrams of a load. Returns when each was sent, and what became of them. `priority` is that of the
    /// thread.
    pub fn run(&self, lab: &Laboratory, load: &Load, priority: u8) -> Result<(Vec<Offer>, Outcome)> {
        // Without the priority the datagrams are sent less exactly.
        let _ = prioritize(priority);
        let mut offers = load.offers(lab);
        let to: Vec<SockaddrIn> = (0..lab.stations)
            .map(|station| {
                let address = match load.cast {
                    Cast::Unicast => lab.address((station + 1) % lab.stations),
                    Cast::Multicast => GROUP,
                };
                SockaddrIn::from(SocketAddrV4::new(address, PORT))
            })
            .collect();
        let epoll = Epoll::new(EpollCreateFlags::EPOLL_CLOEXEC).context("cannot watch sockets")?;
        for (station, socket) in self.0.iter().enumerate() {
            while recv(socket.as_raw_fd(), &mut [0; 2048], MsgFlags::MSG_DONTWAIT).is_ok() {}
            epoll.add(socket, EpollEvent::new(EpollFlags::EPOLLIN, station as u64)).context("cannot watch a socket")?;
        }
        let mut alarm = Alarm::new(&epoll, TIMER)?;
        let origin = monotonic_ns() + LEAD_NS;
        let end = origin + (load.lasts + DRAIN).as_nanos();
        let mut datagram = vec![0; load.bytes.max(NUMBER_BYTES)];
        let mut sent_at: Vec<u64> = Vec::with_capacity(offers.len());
        let mut received: Vec<Received> = Vec::new();
        let mut events = [EpollEvent::empty(); 64];
        loop {
            while let Some(offer) = offers.get(sent_at.len()).filter(|o| origin + o.at.as_nanos() <= monotonic_ns()) {
                datagram[..NUMBER_BYTES].copy_from_slice(&(sent_at.len() as u64).to_le_bytes());
                sent_at.push(monotonic_ns());
                let station = usize::from(offer.station);
                // A datagram that the kernel does not take is one that is not delivered.
                let _ = sendto(self.0[station].as_raw_fd(), &datagram, &to[station], MsgFlags::MSG_DONTWAIT);
            }
            let next = offers.get(sent_at.len()).map_or(end, |offer| origin + offer.at.as_nanos());
            if monotonic_ns() >= end {
                break;
            }
            alarm.set(next)?;
            let timeout = if next <= monotonic_ns() { EpollTimeout::ZERO } else { EpollTimeout::NONE };
            let count = match epoll.wait(&mut events, timeout) {
                Ok(count) => count,
                Err(Errno::EINTR) => 0,
                Err(error) => return Err(error).context("cannot wait for datagrams"),
            };
            for station in events[..count].iter().map(|event| event.data()).filter(|key| *key != TIMER) {
                receive(&self.0[station as usize], origin, &sent_at, &mut received);
            }
        }
        offers.truncate(sent_at.len());
        for (offer, at) in offers.iter_mut().zip(&sent_at) {
            offer.at = Time::from_nanos(at.saturating_sub(origin));
        }
        let outcome = Outcome::of(offers.len(), load.receivers(lab), load.lasts, &received);
        Ok((offers, outcome))
    }
}

/// Reads what has arrived at a socket, up to 16 datagrams, and appends them to `received`. `origin` is the beginning of
/// the load, and `sent_at` the time at which each datagram was sent \[ns\].
fn receive(socket: &OwnedFd, origin: u64, sent_at: &[u64], received: &mut Vec<Received>) {
    let mut buffer = [0; 2048];
    for _ in 0..16 {
        let Ok(length) = recv(socket.as_raw_fd(), &mut buffer, MsgFlags::MSG_DONTWAIT) else { return };
        let now = monotonic_ns();
        let number = buffer[..length].first_chunk::<NUMBER_BYTES>().map(|bytes| u64::from_le_bytes(*bytes) as usize);
        if let Some(at) = number.and_then(|number| sent_at.get(number)) {
            let (after, delay) = (now.saturating_sub(origin), now.saturating_sub(*at));
            received.push(Received { after: Span::from_nanos(after), delay: Span::from_nanos(delay) });
        }
    }
}

/// Opens the socket of a station, on the thread that is in its namespace.
fn open(lab: &Laboratory, station: u16) -> Result<OwnedFd> {
    let refused = || format!("cannot open a socket in station {station}");
    let flags = SockFlag::SOCK_NONBLOCK | SockFlag::SOCK_CLOEXEC;
    let socket = socket(AddressFamily::Inet, SockType::Datagram, flags, None).with_context(refused)?;
    let any = SockaddrIn::from(SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, PORT));
    bind(socket.as_raw_fd(), &any).with_context(refused)?;
    let join = IpMembershipRequest::new(GROUP, Some(lab.address(station)));
    setsockopt(&socket.as_fd(), sockopt::IpAddMembership, &join).with_context(refused)?;
    setsockopt(&socket.as_fd(), sockopt::IpMulticastLoop, &false).with_context(refused)?;
    // More than the machine's limit, which root may exceed.
    setsockopt(&socket.as_fd(), sockopt::RcvBufForce, &BUFFER_BYTES).with_context(refused)?;
    Ok(socket)
}
