//! Reports of hosts for the state of a team: whom they hear, how they send, and who is a member.

use super::mesh::Mesh;
use super::team_view::TeamView;
use murmurate::graph::event::Event;
use murmurate::messages::ids::HostId;
use murmurate::time::Time;
use murmurate_report::heard::Heard;

impl TeamView {
    /// Returns the view of a team whose hosts may be a mesh, with the names of its hosts and that of the state server.
    pub fn on_mesh(mut self, hosts: Vec<String>, server: HostId) -> TeamView {
        self.mesh = Mesh::new(hosts, server);
        self
    }

    /// Updates the state with an event at a host that is no message: whom the host hears, or the roster in force.
    pub fn take_event(&mut self, now: Time, host: HostId, event: Event) {
        match event {
            Event::Peers(peers, ways) => {
                Heard::of(peers, ways).into_iter().for_each(|heard| self.heard(now, host, heard));
            }
            Event::Members(roster) => self.members(now, &roster.members.keys().copied().collect()),
            _ => {}
        }
    }

    /// Updates the state with whom a host hears, and how it sends. The log names robots that the state server has lost.
    pub fn heard(&mut self, now: Time, host: HostId, heard: Heard) {
        let lines = self.mesh.take(now, host, heard, &self.homes);
        lines.iter().for_each(|line| self.note(now, line));
    }
}
