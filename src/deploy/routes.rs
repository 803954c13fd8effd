//! The way of every message in a deployment: who publishes it, who takes it, which link lies between.

use std::collections::BTreeSet;

use super::{Deployment, Host};
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::wire::Kind;
use crate::net::router::{Audience, Route, Router};
use crate::world::Placement;

impl Deployment {
    /// The host that runs the robot's agent.
    pub fn agent_host(&self, robot: RobotId) -> HostId {
        self.host_where(|host| host.agents.iter().any(|robots| robots.contains(&robot.0)))
    }

    /// The host whose World holds the robot.
    pub fn world_host(&self, robot: RobotId) -> HostId {
        self.host_where(|host| host.world.contains(&robot.0))
    }

    /// The host that runs the StateServer.
    pub fn server_host(&self) -> HostId {
        self.host_where(|host| host.state_server)
    }

    fn host_where(&self, is: impl Fn(&Host) -> bool) -> HostId {
        let index = self.hosts.iter().position(is).expect("a checked deployment has a host for everything");
        HostId(u16::try_from(index).expect("hosts are counted in u16"))
    }

    /// The robots of the agent that hosts `robot`.
    pub fn companions(&self, robot: RobotId) -> &[u16] {
        let mut agents = self.hosts.iter().flat_map(|host| &host.agents);
        agents.find(|robots| robots.contains(&robot.0)).expect("a checked deployment has an agent for every robot")
    }

    /// The hosts that take a message of this kind about this robot.
    fn takers(&self, kind: Kind, robot: RobotId) -> BTreeSet<HostId> {
        let team = || RobotId::team(self.robots);
        match kind {
            Kind::Reading => BTreeSet::from([self.agent_host(robot)]),
            // Robots of one agent hear each other within its step.
            Kind::Latent => {
                let others = team().filter(|other| !self.companions(robot).contains(&other.0));
                others.map(|other| self.agent_host(other)).collect()
            }
            Kind::MotorCommand => BTreeSet::from([self.world_host(robot)]),
            Kind::Heartbeat => BTreeSet::from([self.server_host()]),
            Kind::Mode => {
                let agents = team().map(|robot| self.agent_host(robot));
                let placing = team().filter(|_| self.placement == Placement::Exact);
                agents.chain(placing.map(|robot| self.world_host(robot))).collect()
            }
        }
    }

    /// The host that publishes messages of this kind about this robot.
    fn publisher(&self, kind: Kind, robot: RobotId) -> HostId {
        match kind {
            Kind::Reading => self.world_host(robot),
            Kind::Latent | Kind::MotorCommand | Kind::Heartbeat => self.agent_host(robot),
            Kind::Mode => self.server_host(),
        }
    }

    /// Whether any message of this kind crosses hosts.
    pub(super) fn crosses(&self, kind: Kind) -> bool {
        RobotId::team(self.robots).any(|robot| {
            let from = self.publisher(kind, robot);
            self.takers(kind, robot).iter().any(|&to| to != from)
        })
    }

    /// The hosts that take messages of this kind.
    pub fn listeners(&self, kind: Kind) -> Vec<HostId> {
        let hosts: BTreeSet<HostId> = RobotId::team(self.robots).flat_map(|robot| self.takers(kind, robot)).collect();
        hosts.into_iter().collect()
    }

    /// The routing table of a host.
    pub fn router(&self, host: HostId) -> Router {
        Router::new(self.robots, |kind, robot| {
            let takers = self.takers(kind, robot);
            let mut others = takers.iter().filter(|&&taker| taker != host);
            let audience = match (others.next(), others.next()) {
                (None, _) => None,
                (Some(&only), None) => Some(Audience::Host(only)),
                _ => Some(Audience::All),
            };
            let publishes = self.publisher(kind, robot) == host;
            let leaves = audience.filter(|_| publishes).map(|audience| (self.link_of(kind), audience));
            Route { local: takers.contains(&host), leaves }
        })
    }

    fn link_of(&self, kind: Kind) -> LinkId {
        let index = self.links.iter().position(|link| link.carries.contains(&kind));
        let index = index.expect("a checked deployment has a link for every kind that crosses");
        LinkId(u16::try_from(index).expect("links are counted in u16"))
    }
}
