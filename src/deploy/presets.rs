//! Preset deployments: the modes of the paper (section IV). No other module refers to modes and their links by name.

use super::{Deployment, Host, Link, LinkMedium, Stepping, kinematic};
use crate::messages::ids::RobotId;
use crate::messages::wire::Kind;
use crate::net::protocol::reliability::Reliabilities;
use crate::safety::Switch;
use crate::world::Placement;

/// Names of the preset deployment modes.
pub const MODES: [&str; 5] = ["sim", "centralized", "offboard", "onboard-infra", "onboard-adhoc"];

impl Deployment {
    /// Returns the deployment of a mode for a team of `robots` robots; `None` if there is no mode of this name.
    pub fn preset(mode: &str, robots: usize) -> Option<Deployment> {
        use Kind::*;
        let everyone: Vec<u16> = RobotId::team(robots).map(|robot| robot.0).collect();
        let host = |name: &str| Host { name: name.to_owned(), ..Host::default() };
        let link = |name: &str, medium: LinkMedium, carries: &[Kind]| Link {
            name: name.to_owned(),
            medium,
            carries: carries.to_vec(),
            delay_s: 0.0,
            loss: 0.0,
            impairs: Vec::new(),
            reliability: Reliabilities::new(),
            range_m: None,
            mesh: false,
            auto: false,
            radio: None,
        };
        let infra = |carries: &[Kind]| link("infra", LinkMedium::AccessPoint, carries);
        let wires = |carries: &[Kind]| link("wires", LinkMedium::Cable, carries);
        let one_each = |prefix: &str| -> Vec<Host> {
            let agent = |&robot: &u16| Host { agents: vec![vec![robot]], ..host(&format!("{prefix}-{robot}")) };
            everyone.iter().map(agent).collect()
        };
        let world = Host { simulates: everyone.clone(), ..host("world") };
        let world_and_server = Host { state_server: true, ..world.clone() };
        let and = |hosts: Vec<Host>, last: Host| -> Vec<Host> { hosts.into_iter().chain([last]).collect() };
        let (hosts, links) = match mode {
            "sim" => (vec![Host { agents: vec![everyone.clone()], ..world_and_server }], Vec::new()),
            "centralized" => (
                vec![Host { agents: vec![everyone.clone()], state_server: true, ..host("pc") }, world],
                vec![infra(&[MotorCommand]), wires(&[Reading, Mode, Stop])],
            ),
            "offboard" => (
                and(one_each("agent"), world_and_server),
                vec![
                    link("loopback", LinkMedium::Loopback, &[Latent, Reading, Heartbeat, Mode, Stop]),
                    infra(&[MotorCommand]),
                ],
            ),
            "onboard-infra" => (
                and(one_each("robot"), world_and_server),
                vec![infra(&[Reading, Latent, Heartbeat, Mode, Stop]), wires(&[MotorCommand])],
            ),
            "onboard-adhoc" => (
                and(one_each("robot"), world_and_server),
                vec![
                    link("ad-hoc", LinkMedium::AdHoc, &[Latent]),
                    infra(&[Reading, Heartbeat, Mode, Stop]),
                    wires(&[MotorCommand]),
                ],
            ),
            _ => return None,
        };
        Some(of_hosts((mode, robots), hosts, links))
    }
}

/// Returns the deployment of a preset mode with these hosts and links; all else is as usual.
fn of_hosts((mode, robots): (&str, usize), hosts: Vec<Host>, links: Vec<Link>) -> Deployment {
    let training = mode == "sim";
    Deployment {
        mode: mode.to_owned(),
        robots,
        placement: if training { Placement::Exact } else { Placement::Drive },
        stepping: if training { Stepping::Lockstep } else { Stepping::Seeded },
        body: Default::default(),
        bodies: Default::default(),
        senses: Default::default(),
        roles: Default::default(),
        plant: kinematic(),
        gap_m: None,
        scale: None,
        hull_m: None,
        latent_rate_hz: None,
        witness: Switch::Off,
        hosts,
        links,
    }
}
