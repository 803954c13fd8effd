//! Listing of all values in effect of a team file, each with its origin (flag, environment, file or default).

use super::fields::team_fields;
use super::layers::Origin;
use super::{TeamFile, kebab};
use crate::messages::ids::HostId;
use crate::world::{ContactRule, Sensor};

/// One line of the command `config show`: a field of a team file with its value in effect and the origin of the value.
#[derive(Clone, Debug, PartialEq)]
pub struct Shown {
    /// Key of the field, such as `link.radio.transport`.
    pub key: String,
    /// Value of the field that is in effect, as text.
    pub value: String,
    /// Origin of the value: file, environment variable, flag or default.
    pub origin: Origin,
}

impl TeamFile {
    /// Returns, as text, the default of the field `key` (a property of simulated robots), which the plant defines;
    /// `None` for other fields.
    fn plant_default(&self, key: &str) -> Option<String> {
        let (plant, scenario) = (self.registry.plant(&self.deployment.plant).ok()?, self.scenario().ok()?);
        let physics = (plant.physics)(scenario.arena());
        let contacts = || if physics.contacts == ContactRule::Judge { "judge" } else { "block" };
        let sensor = || Sensor::NAMED.iter().find(|(_, sensor)| *sensor == physics.sensor);
        match key {
            "lag_s" => Some(physics.lag_s.to_string()),
            "contacts" => Some(contacts().to_owned()),
            "wall_radius_m" => Some(physics.wall_radius_m.to_string()),
            _ => sensor().map(|(name, _)| (*name).to_owned()),
        }
    }

    /// Returns all values in effect with their origins, for one host, or for the whole team if `host` is `None`.
    pub fn values(&self, host: Option<HostId>) -> Vec<Shown> {
        let scopes = self.scopes(host);
        let mut all = Vec::new();
        let mut show = |key: String, default: Option<String>| {
            let found = self.layers.find(&scopes, &key).map(|entry| (entry.value.to_string(), entry.origin));
            if let Some((value, origin)) = found.or_else(|| default.map(|value| (value, Origin::Default))) {
                all.push(Shown { key, value, origin });
            }
        };
        let inline = self.layers.table("deployment");
        for key in team_fields() {
            let default = match key {
                "robots" => Some(self.deployment.robots.to_string()),
                "mode" => None,
                "key_file" => Some("none: frames are not authenticated".to_owned()),
                "policy" => self.scenario().ok().map(|scenario| self.registry.default_policy(&*scenario).to_owned()),
                "plant" => Some(self.deployment.plant.clone()),
                "scale" => Some(self.deployment.scale.unwrap_or(1.0).to_string()),
                "hull_m" => self.scenario().ok().map(|scenario| scenario.arena().hull_m().to_string()),
                "latent_rate_hz" => Some("that of the control steps".to_owned()),
                "lag_s" | "contacts" | "wall_radius_m" | "sensor" => self.plant_default(key),
                "sensor_delay_s" => Some("the latency of the simulated sensor".to_owned()),
                _ => None,
            };
            show(key.to_owned(), default);
        }
        for (at, link) in self.deployment.links.iter().enumerate() {
            show(format!("link.{}.transport", link.name), None);
            for field in self.transport(&scopes, link).fields {
                let default = field.default.map(|default| default(at));
                self.names_of(field)
                    .iter()
                    .for_each(|name| show(format!("link.{}.{name}", link.name), default.clone()));
            }
            for kind in &link.carries {
                show(format!("link.{}.reliability.{}", link.name, kebab(*kind)), None);
            }
        }
        // The TOML of `safety` has one line per field.
        let safety = toml::to_string(&self.safety).expect("safety is TOML");
        all.extend(safety.lines().filter_map(|line| line.split_once(" = ")).map(|(field, value)| {
            let key = format!("safety.{field}");
            let origin = self.layers.table(&key).map_or(Origin::Default, Origin::File);
            Shown { key, value: value.trim_matches('"').to_owned(), origin }
        }));
        if let Some(line) = inline {
            let value = format!("inline, mode '{}'", self.deployment.mode);
            all.push(Shown { key: "deployment".to_owned(), value, origin: Origin::File(line) });
        }
        let others = ["robot.", "host."].into_iter().filter(|_| host.is_none());
        all.extend(others.flat_map(|prefix| self.layers.below(prefix)).map(|(key, entry)| Shown {
            key: key.to_owned(),
            value: entry.value.to_string(),
            origin: entry.origin.clone(),
        }));
        all
    }
}
