//! Addresses of other hosts on links that send to single hosts: what the transport of a link has to know of them.

use std::collections::BTreeMap;
use std::net::SocketAddr;

use crate::messages::ids::{HostId, LinkId};
use crate::net::protocol::link::{Arrival, Guest, LinkState, Standing};
use crate::time::{Span, Time};

/// Time after which the transport of a link is told again that a host is heard at its address. It considers a host
/// silent after twice this time.
const HEARD_PERIOD: Span = Span::from_millis(500);

/// Addresses from which the hosts of a team were last accepted on links that send to single hosts, with the time at
/// which the link's transport was told.
#[derive(Debug, Default)]
pub(super) struct Addresses(BTreeMap<(LinkId, HostId), (SocketAddr, Time)>);

impl Addresses {
    /// Notes that a datagram of `heard` has arrived from `at`. Returns what the link's transport has to know. A new
    /// address counts once a datagram from there proves its sender's liveness: a recording may come from anywhere.
    fn note(&mut self, now: Time, (link, at): (LinkId, SocketAddr), heard: Arrival) -> Option<Guest> {
        let Arrival { host, standing, proves } = heard;
        let guest = |standing| Some(Guest { host, at, standing });
        if host.is_operator() || standing == Standing::Candidate {
            return guest(standing);
        }
        let known = self.0.get_mut(&(link, host));
        match known {
            Some((same, told)) if *same == at => {
                let due = now.since(*told) >= HEARD_PERIOD;
                due.then(|| *told = now).and_then(|()| guest(Standing::Accepted))
            }
            _ if !proves => guest(Standing::Candidate),
            _ => {
                self.0.insert((link, host), (at, now));
                guest(Standing::Accepted)
            }
        }
    }

    /// Notes as [`Addresses::note`] that a datagram has arrived by the link with this state, and returns what the
    /// link's transport has to know.
    pub(super) fn admit(
        &mut self,
        now: Time,
        at: (LinkId, SocketAddr),
        heard: Arrival,
        state: &mut LinkState,
    ) -> Option<Guest> {
        let guest = self.note(now, at, heard);
        // An accepted host at an address that it has not proved yet: it needs a report of this host there.
        if heard.standing == Standing::Accepted && guest.is_some_and(|guest| guest.standing == Standing::Candidate) {
            state.invite(now, heard.host);
        }
        guest
    }
}
