//! The way of every message in a deployment: who publishes it, who takes it, which link lies between. Reckoned
//! once for a whole deployment, since a large team has many ways.

use std::collections::BTreeSet;

use super::Deployment;
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::wire::{KINDS, Kind};
use crate::net::router::{Audience, Route, Router};

/// Who runs what in a checked deployment, and the ways of all messages.
#[derive(Clone, Debug)]
pub struct Routes {
    robots: usize,
    hosts: usize,
    /// By robot: the host of its agent, the robots of that agent in the order of their ids, the host of its world.
    agent_host: Vec<HostId>,
    companions: Vec<Vec<RobotId>>,
    world_host: Vec<HostId>,
    server_host: HostId,
    /// By kind, then by robot: the hosts that take a message, in order.
    takers: Vec<Vec<HostId>>,
    /// By kind: the link that carries it.
    links: Vec<Option<LinkId>>,
}

impl Routes {
    /// The ways of a deployment. Panics if a robot has no agent or no world, which `Deployment::check` excludes.
    pub fn of(deployment: &Deployment) -> Routes {
        let robots = deployment.robots;
        let number = |index: usize| u16::try_from(index).expect("a checked deployment has few hosts and links");
        let (mut agent_host, mut world_host) = (vec![None; robots], vec![None; robots]);
        let mut companions = vec![Vec::new(); robots];
        for (index, host) in deployment.hosts.iter().enumerate() {
            for agent in &host.agents {
                let mut ids: Vec<RobotId> = agent.iter().copied().map(RobotId).collect();
                ids.sort();
                for robot in &ids {
                    agent_host[robot.index()] = Some(HostId(number(index)));
                    companions[robot.index()] = ids.clone();
                }
            }
            for robot in &host.world {
                world_host[usize::from(*robot)] = Some(HostId(number(index)));
            }
        }
        let found = |hosts: Vec<Option<HostId>>| -> Vec<HostId> {
            hosts.into_iter().map(|host| host.expect("a checked deployment has a host for everything")).collect()
        };
        let server = deployment.hosts.iter().position(|host| host.state_server);
        let link_of = |kind: Kind| deployment.links.iter().position(|link| link.carries.contains(&kind));
        let mut routes = Routes {
            robots,
            hosts: deployment.hosts.len(),
            agent_host: found(agent_host),
            companions,
            world_host: found(world_host),
            server_host: HostId(number(server.expect("a checked deployment has a state server"))),
            takers: Vec::new(),
            links: KINDS.iter().map(|&kind| link_of(kind).map(|index| LinkId(number(index)))).collect(),
        };
        let told: BTreeSet<HostId> = routes.agent_host.iter().chain(&routes.world_host).copied().collect();
        routes.takers = KINDS
            .iter()
            .flat_map(|&kind| RobotId::team(robots).map(move |robot| (kind, robot)))
            .map(|(kind, robot)| routes.takers_of(kind, robot, &told))
            .collect();
        routes
    }

    fn takers_of(&self, kind: Kind, robot: RobotId, told: &BTreeSet<HostId>) -> Vec<HostId> {
        match kind {
            Kind::Reading => vec![self.agent_host(robot)],
            Kind::Latent => {
                // Robots of one agent hear each other within its step.
                let own = self.companions(robot);
                let others = RobotId::team(self.robots).filter(|other| own.binary_search(other).is_err());
                others.map(|other| self.agent_host(other)).collect::<BTreeSet<_>>().into_iter().collect()
            }
            Kind::MotorCommand => vec![self.world_host(robot)],
            Kind::Heartbeat => vec![self.server_host],
            Kind::Mode => told.iter().copied().collect(),
            // Those who move, and the one who leads them.
            Kind::Stop => {
                let hosts: BTreeSet<HostId> = self.agent_host.iter().chain([&self.server_host]).copied().collect();
                hosts.into_iter().collect()
            }
        }
    }

    /// The host that runs the robot's agent.
    pub fn agent_host(&self, robot: RobotId) -> HostId {
        self.agent_host[robot.index()]
    }

    /// The host whose World holds the robot.
    pub fn world_host(&self, robot: RobotId) -> HostId {
        self.world_host[robot.index()]
    }

    /// The host that runs the StateServer.
    pub fn server_host(&self) -> HostId {
        self.server_host
    }

    /// The robots of the agent that hosts `robot`, itself among them, in the order of their ids.
    pub fn companions(&self, robot: RobotId) -> &[RobotId] {
        &self.companions[robot.index()]
    }

    fn takers(&self, kind: Kind, robot: RobotId) -> &[HostId] {
        &self.takers[kind as usize * self.robots + robot.index()]
    }

    /// The host that publishes messages of this kind about this robot; `None` if any may.
    fn publisher(&self, kind: Kind, robot: RobotId) -> Option<HostId> {
        match kind {
            Kind::Reading => Some(self.world_host(robot)),
            Kind::Latent | Kind::MotorCommand | Kind::Heartbeat => Some(self.agent_host(robot)),
            Kind::Mode => Some(self.server_host),
            Kind::Stop => None,
        }
    }

    /// Whether any message of this kind crosses hosts.
    pub fn crosses(&self, kind: Kind) -> bool {
        RobotId::team(self.robots).any(|robot| {
            let from = self.publisher(kind, robot);
            // What any host may say crosses as soon as there are two.
            self.hosts > 1 && self.takers(kind, robot).iter().any(|&to| Some(to) != from)
        })
    }

    /// Whether the host sends any message of this kind to another, or takes one from another.
    pub fn exchanges(&self, host: HostId, kind: Kind) -> bool {
        RobotId::team(self.robots).any(|robot| {
            let (from, takers) = (self.publisher(kind, robot), self.takers(kind, robot));
            let says = from.is_none_or(|from| from == host) && takers.iter().any(|&to| to != host);
            says || (from != Some(host) && takers.binary_search(&host).is_ok())
        })
    }

    /// The hosts that take messages of this kind.
    pub fn listeners(&self, kind: Kind) -> Vec<HostId> {
        let all = RobotId::team(self.robots).flat_map(|robot| self.takers(kind, robot));
        all.copied().collect::<BTreeSet<HostId>>().into_iter().collect()
    }

    /// The routing table of a host.
    pub fn router(&self, host: HostId) -> Router {
        Router::new(self.robots, |kind, robot| {
            let takers = self.takers(kind, robot);
            let local = takers.binary_search(&host).is_ok();
            let mut others = takers.iter().filter(|&&taker| taker != host);
            let audience = match (others.next(), others.next()) {
                (None, _) => None,
                (Some(&only), None) => Some(Audience::Host(only)),
                _ => Some(Audience::All),
            };
            let publishes = self.publisher(kind, robot).is_none_or(|publisher| publisher == host);
            let link = || self.links[kind as usize].expect("a checked deployment has a link for all that crosses");
            Route { local, leaves: audience.filter(|_| publishes).map(|audience| (link(), audience)) }
        })
    }
}
