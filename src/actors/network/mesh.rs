//! The part of a Network that says emergency stops on, on links on which not all hosts hear each other.

use super::{Network, Out, Route};
use crate::messages::ids::{HostId, LinkId};
use crate::messages::wire::{Stop, Wire};
use crate::net::protocol::flood::{Flood, NEIGHBOUR};
use crate::net::protocol::link::LinkState;
use crate::net::protocol::router::Audience;
use crate::time::Time;

/// Links of one host that are a mesh, and what it says on.
#[derive(Debug)]
pub(super) struct Mesh {
    links: Vec<LinkId>,
    flood: Flood,
}

impl Mesh {
    /// Returns the mesh of a host on these links; `None` without links.
    pub(super) fn new(links: Vec<LinkId>) -> Option<Mesh> {
        (!links.is_empty()).then(|| Mesh { links, flood: Flood::new() })
    }

    pub(super) fn due(&self) -> Option<Time> {
        self.flood.due()
    }
}

impl Network {
    /// Takes note of the emergency stop, or its end, in a message of the host `from`.
    pub(super) fn note_latch(&mut self, now: Time, from: HostId, message: &Wire) {
        let Some(mesh) = &mut self.mesh else { return };
        // Where members have keys of their own, an operator's signature alone ends a stop.
        let signed = self.key.as_ref().is_some_and(|key| key.signatures().is_some());
        match message {
            Wire::Stop(stop) if stop.latch.is_engaged() => {
                mesh.flood.hear(now, from, stop.latch, &mut self.stream);
            }
            // A resume ends a hold and no stop.
            Wire::Stop(stop) if stop.latch.is_held() && stop.by.is_operator() && !signed => mesh.flood.end(stop.latch),
            Wire::Release(release) if release.latch.is_held() => mesh.flood.end(release.latch),
            Wire::Mode(mode) if !mode.latch.is_engaged() && !signed => mesh.flood.end(mode.latch),
            _ => {}
        }
    }

    /// Says the emergency stop on that is due.
    pub(super) fn wake_mesh(&mut self, now: Time, out: &mut Vec<Out>) {
        let (links, me) = (&self.links, self.local_header.sender);
        let Some(mesh) = &mut self.mesh else { return };
        let on_mesh = mesh.links.iter().filter_map(|link| links[usize::from(link.0)].as_ref());
        let neighbours = on_mesh.flat_map(|state: &LinkState| state.neighbours(now, NEIGHBOUR));
        let Some(latch) = mesh.flood.next(now, neighbours, &mut self.stream) else { return };
        for link in mesh.links.clone() {
            let route = Route { local: false, leaves: Some((link, Audience::All)) };
            self.send(now, route, &Wire::Stop(Stop { by: me, latch }), out);
        }
    }
}
