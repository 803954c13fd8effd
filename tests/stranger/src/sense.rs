//! The sense `crowd`: how many other robots are within a radius.

use murmurate::config::ConfigError;
use murmurate::edge::Settings;
use murmurate::messages::ids::RobotId;
use murmurate::observation::Unit;
use murmurate::senses::{Entry, In, Layout, Out, Parts, Sense};
use murmurate::time::Time;
use serde::Deserialize;

/// Entry in a registry.
pub const CROWD: Entry =
    Entry { name: "crowd", about: "how many other robots are within a radius", example: "radius_m = 1.5", make };

/// Settings in a deployment.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    /// Radius within which robots are counted \[m\].
    radius_m: f32,
}

fn make(settings: &Settings, _: RobotId) -> Result<Parts, ConfigError> {
    let Config { radius_m } = settings.read()?;
    if !(radius_m > 0.0 && radius_m.is_finite()) {
        return Err(ConfigError::field(format!("{}.radius_m", settings.name), "it is not above zero"));
    }
    let layout = Layout { shape: vec![1], unit: Unit::One, sweep: None };
    Ok(Parts { layout, sense: Box::new(move |site| Box::new(Crowd { robot: site.robot, radius_m })), worker: None })
}

/// Sense of one robot.
struct Crowd {
    robot: RobotId,
    radius_m: f32,
}

impl Sense for Crowd {
    fn take(&mut self, _: Time, input: In, out: &mut Vec<Out>) {
        let In::Scene(scene) = input else { return };
        let Some(own) = scene.robots.iter().find(|standing| standing.robot == self.robot) else { return };
        let near = scene.robots.iter().filter(|other| (other.centre - own.centre).norm() <= self.radius_m);
        // The robot itself is one of those.
        let others = near.count() - 1;
        out.push(Out::Values { stamp_ns: scene.time.as_nanos(), values: vec![others as f32] });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_keeps_the_contract_of_senses() {
        murmurate::senses::contract::check(&CROWD).expect("it keeps the contract");
    }
}
