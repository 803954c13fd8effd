//! Rate at which the robots of a deployment broadcast, apart from that of their control steps.

use crate::config::ConfigError;
use crate::time::Span;

use super::{Deployment, ImpairError, Routes};
use crate::messages::wire::Kind;

/// Smallest and largest rate at which a robot broadcasts latents \[Hz\].
pub const LATENT_RATE_HZ: [f64; 2] = [0.1, 1000.0];

impl Deployment {
    /// Checks that robots broadcast at a possible rate.
    pub(super) fn check_latent_rate(&self) -> Result<(), ConfigError> {
        let [least, most] = LATENT_RATE_HZ;
        match self.latent_rate_hz.filter(|rate_hz| !(least..=most).contains(rate_hz)) {
            None => Ok(()),
            Some(rate_hz) => Err(ConfigError::field("latent_rate_hz", format!("{rate_hz} is not {least} to {most}"))),
        }
    }

    /// Sets the rate at which a robot broadcasts latents \[Hz\]. Fails if no latent crosses a link, or if the rate is
    /// invalid.
    pub fn with_latent_rate(self, rate_hz: f64) -> Result<Deployment, ImpairError> {
        if !Routes::of(&self).crosses(Kind::Latent) {
            return Err(ImpairError::NothingCrosses { mode: self.mode, kinds: "latent" });
        }
        let deployment = Deployment { latent_rate_hz: Some(rate_hz), ..self };
        deployment.check()?;
        Ok(deployment)
    }

    /// Returns the mean time between two latents of a robot; zero if it broadcasts one in every control step.
    pub fn between_latents(&self) -> Span {
        self.latent_rate_hz.map_or(Span::ZERO, |rate_hz| Span::from_secs(1.0 / rate_hz))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_is_kept_in_its_file_and_an_impossible_one_is_refused() {
        let preset = Deployment::preset("onboard-adhoc", 2).expect("a preset");
        assert_eq!(preset.between_latents(), Span::ZERO, "in every step");
        assert!(!preset.to_toml().contains("latent_rate_hz"));
        let text = Deployment { latent_rate_hz: Some(8.0), ..preset.clone() }.to_toml();
        assert_eq!(Deployment::from_toml(&text).map(|read| read.between_latents()), Ok(Span::from_millis(125)));
        let alone = Deployment::preset("sim", 2).expect("a preset").with_latent_rate(8.0);
        assert!(matches!(alone, Err(ImpairError::NothingCrosses { .. })), "one agent has all robots");
        for rate_hz in [0.0, -1.0, 2000.0, f64::NAN] {
            let error = Deployment { latent_rate_hz: Some(rate_hz), ..preset.clone() }.check().unwrap_err();
            assert!(error.to_string().starts_with(&format!("latent_rate_hz: {rate_hz} is not 0.1 to 1000")), "{error}");
        }
    }
}
