//! Validation of a training's configuration: the permitted values of its fields.

use super::config::{Conditions, Config, Critic, Imitated, Policy, Ppo};
use super::network::Shape;
use murmurate::config::{ConfigError, in_range};
use murmurate::policy::hops::action::Action;

impl Config {
    /// Checks the values of all fields of the configuration. The error names the first wrong one.
    pub fn check(&self) -> Result<(), ConfigError> {
        in_range("episode_s", self.episode_s, (0.1, 3600.0))?;
        self.body.chassis().map_err(|error| error.within("body"))?;
        self.ppo.check()?;
        self.reward.check()?;
        self.conditions.check()?;
        self.expert.as_ref().map_or(Ok(()), Imitated::check)?;
        self.check_curriculum()?;
        self.check_roles()?;
        self.policies().iter().try_for_each(|(role, policy)| self.check_policy(role, policy))?;
        self.check_networks()
    }

    fn check_networks(&self) -> Result<(), ConfigError> {
        let wrong = |field: &str, reason: String| Err(ConfigError::field(field, reason));
        in_range("policy.rate_hz", self.policy.rate_hz, (20.0, 20.0))?;
        in_range("policy.hops", self.policy.hops as f64, (1.0, 8.0))?;
        if let Some(Critic { encoder, message, update }) = &self.critic {
            let fields = [("encoder", encoder, 1), ("message", message, 2), ("update", update, 0)];
            for (field, widths, least) in fields {
                if widths.len() < least || widths.iter().any(|width| !(1..=4096).contains(width)) {
                    return wrong(
                        &format!("critic.{field}"),
                        format!("{widths:?} is not {least} or more layers of 1 to 4096"),
                    );
                }
            }
        }
        let recurrent = self.policy.memory.is_some() || self.policy.hops > 1;
        let Ppo { window, lookback, .. } = self.ppo;
        if !recurrent && (window.is_some() || lookback.is_some()) {
            let why = "only policies with memory or several hops are learnt by windows; leave it out";
            return wrong(if window.is_some() { "ppo.window" } else { "ppo.lookback" }, why.to_owned());
        }
        in_range("ppo.window", window.unwrap_or(1) as f64, (1.0, 1024.0))?;
        in_range("ppo.lookback", lookback.unwrap_or(0) as f64, (0.0, 64.0))
    }

    /// Checks the policy of a role, or without a name that of all robots.
    fn check_policy(&self, role: &str, policy: &Policy) -> Result<(), ConfigError> {
        let own = |field: &str| self.roles.get(role).is_some_and(|role| role.has(field));
        // A field of a hop is that of all hops of the configuration.
        let wrong = |field: &str, reason: String| match field.split('.').find(|part| own(part)) {
            Some(part) => ConfigError::field(format!("roles.{role}.{part}"), reason),
            None => ConfigError::field(format!("policy.{field}"), reason),
        };
        let named = |text: String| match text.split_once(": ") {
            Some((field, reason)) => wrong(field, reason.to_owned()),
            None => ConfigError::field("policy", text),
        };
        if policy.message.len() < 2 {
            return Err(wrong("message", "training needs a message network of two or more layers".to_owned()));
        }
        if policy.encoder.is_empty() {
            return Err(wrong("encoder", "the encoder needs at least one layer".to_owned()));
        }
        let manifest = policy.manifest("any", Action::Velocity, Some(self.ppo.log_std_max[1])).map_err(named)?;
        Shape::of_manifest(&manifest).map_err(named).map(drop)
    }

    fn check_curriculum(&self) -> Result<(), ConfigError> {
        let wrong = |at: usize, field: &str, reason: String| {
            Err(ConfigError::field(format!("curriculum[{at}].{field}"), reason))
        };
        if self.curriculum.is_empty() {
            return Err(ConfigError::field("curriculum", "at least one stage is needed".to_owned()));
        }
        let mut start = 0.0;
        for (at, stage) in self.curriculum.iter().enumerate() {
            if stage.until.is_nan() || stage.until <= start || stage.until > 1.0 {
                return wrong(at, "until", format!("{} is not above {start} and at most 1", stage.until));
            }
            start = stage.until;
            let robots = |groups: &Vec<usize>| groups.iter().fold(0, |all: usize, group| all.saturating_add(*group));
            let team = stage.groups.first().map_or(0, robots);
            if team == 0 || stage.groups.iter().any(|groups| robots(groups) != team || groups.contains(&0)) {
                return wrong(at, "groups", format!("{:?} do not all have the same total, above 0", stage.groups));
            }
            if !(0.0..=100.0).contains(&stage.penalties) {
                return wrong(at, "penalties", format!("{} is not 0 to 100", stage.penalties));
            }
            if !(1..=20).contains(&stage.repeat) {
                return wrong(at, "repeat", format!("{} is not 1 to 20", stage.repeat));
            }
        }
        if start < 1.0 {
            return wrong(self.curriculum.len() - 1, "until", format!("the last stage must end at 1, not at {start}"));
        }
        Ok(())
    }
}

impl Imitated {
    fn check(&self) -> Result<(), ConfigError> {
        for weight in self.weight {
            in_range("expert.weight", f64::from(weight), (0.0, 1000.0))?;
        }
        match self.until > 0.0 && self.until <= 1.0 {
            true => Ok(()),
            false => Err(ConfigError::field("expert.until", format!("{} is not above 0 and at most 1", self.until))),
        }
    }
}

impl Ppo {
    fn check(&self) -> Result<(), ConfigError> {
        let wrong = |field: &str, reason: String| Err(ConfigError::field(field, reason));
        let counts = [
            ("ppo.environments", self.environments, 1 << 20),
            ("ppo.decisions", self.decisions, 1 << 16),
            ("ppo.minibatch", self.minibatch, 1 << 24),
            ("ppo.epochs", self.epochs, 100),
        ];
        for (field, value, max) in counts {
            if value == 0 || value > max {
                return wrong(field, format!("{value} is not 1 to {max}"));
            }
        }
        if self.environments.saturating_mul(self.decisions) > 1 << 22 {
            return wrong(
                "ppo.decisions",
                format!("{} x {} decisions are too many", self.environments, self.decisions),
            );
        }
        if self.kl_stop.is_nan() || self.kl_stop <= 0.0 {
            return wrong("ppo.kl_stop", format!("{} is not above 0", self.kl_stop));
        }
        in_range("ppo.clip", self.clip, (1e-3, 1.0))?;
        in_range("ppo.gamma", self.gamma, (0.0, 1.0))?;
        in_range("ppo.lambda", self.lambda, (0.0, 1.0))?;
        in_range("ppo.gradient_clip", self.gradient_clip, (1e-6, 1e6))?;
        in_range("ppo.log_std", self.log_std, (-10.0, 2.0))?;
        in_range("ppo.overshoot", self.overshoot, (0.0, 1e3))?;
        for at in [0, 1] {
            in_range("ppo.learning_rate", self.learning_rate[at], (1e-9, 1.0))?;
            in_range("ppo.entropy", self.entropy[at], (0.0, 1.0))?;
            in_range("ppo.log_std_max", self.log_std_max[at], (-10.0, 2.0))?;
        }
        Ok(())
    }
}

impl Conditions {
    /// Checks the values of all fields. The error names the first wrong one.
    pub(super) fn check(&self) -> Result<(), ConfigError> {
        in_range("conditions.clean", self.clean, (0.0, 1.0))?;
        in_range("conditions.deployed", self.deployed, (0.0, 1.0))?;
        in_range("conditions.wall_radius_m", self.wall_radius_m, (1e-3, 10.0))?;
        in_range("conditions.edge_spread", self.edge_spread, (0.0, 1.0))?;
        in_range("conditions.everyone", self.everyone, (0.0, 1.0))?;
        in_range("conditions.wheels", self.wheels, (0.0, 1.0))?;
        in_range("conditions.filtered", self.filtered, (0.0, 1.0))?;
        in_range("conditions.filtered_published", self.filtered_published, (0.0, 1.0))?;
        let ranges = [
            ("conditions.lag_s", self.lag_s, 10.0),
            ("conditions.delay_s", self.delay_s, 0.5),
            ("conditions.loss", self.loss, 1.0),
            ("conditions.hold_s", self.hold_s, 0.5),
            ("conditions.range_std_m", self.range_std_m, 100.0),
            ("conditions.position_noise_m", self.position_noise_m, 10.0),
            ("conditions.velocity_noise_m_s", self.velocity_noise_m_s, 10.0),
        ];
        let filtered = self.filtered_wall_radius_m.map(|range| ("conditions.filtered_wall_radius_m", range, 10.0));
        for (field, [low, high], max) in ranges.into_iter().chain(filtered) {
            in_range(field, low, (0.0, max))?;
            in_range(field, high, (low, max))?;
        }
        Ok(())
    }
}
