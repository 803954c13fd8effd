//! Checks of a link of a deployment, and what is emulated on it.

use super::{Link, LinkMedium, Stepping};
use crate::config::ConfigError;
use crate::net::media::emulator::Impairment;
use crate::time::Span;

impl Link {
    /// Checks the numbers of the link, and that it carries all kinds of messages in `impairs` and `reliability`.
    pub(super) fn check(&self) -> Result<(), ConfigError> {
        let wrong = |field: &str, reason: String| Err(ConfigError::field(field, reason));
        if !(0.0..=1.0).contains(&self.loss) {
            return wrong("link.loss", format!("{} on '{}' is not a share of 0 to 1", self.loss, self.name));
        }
        if let Some(kind) = self.impairs.iter().find(|kind| !self.carries.contains(kind)) {
            return wrong("link.impairs", format!("'{}' does not carry {kind:?}", self.name));
        }
        if let Some(kind) = self.reliability.keys().find(|kind| !self.carries.contains(kind)) {
            return wrong("link.reliability", format!("'{}' does not carry {kind:?}", self.name));
        }
        if !(0.0..=60.0).contains(&self.delay_s) {
            return wrong("link.delay_s", format!("{} on '{}' is not 0 to 60 s", self.delay_s, self.name));
        }
        if self.mesh && self.medium != LinkMedium::AdHoc {
            let why =
                format!("'{}' is no link on which robots hear each other directly: medium = \"ad-hoc\"", self.name);
            return wrong("link.mesh", why);
        }
        if let Some(range_m) = self.range_m {
            if !(0.0..f32::INFINITY).contains(&range_m) {
                return wrong("link.range_m", format!("{range_m} on '{}' is not a distance", self.name));
            }
            if self.radio.is_some() {
                let why = format!("'{}' is a radio, which has a range of its own: link.radio.range_m", self.name);
                return wrong("link.range_m", why);
            }
        }
        Ok(())
    }

    /// Returns whether the states of a team that acts at the same instants have to be spread on the link: its hosts
    /// share a radio.
    pub(crate) fn spreads(&self, stepping: Stepping) -> bool {
        stepping == Stepping::Lockstep && self.medium.topology().is_some()
    }

    /// Checks the radio of the link, if it has one.
    pub(super) fn check_radio(&self) -> Result<(), ConfigError> {
        let Some(radio) = &self.radio else { return Ok(()) };
        radio.check().map_err(|e| e.within("link.radio"))?;
        if self.medium.topology().is_none() {
            let why = format!("'{}' runs over no radio: its medium is neither access-point nor ad-hoc", self.name);
            return Err(ConfigError::field("link.radio", why));
        }
        Ok(())
    }

    /// Returns the emulated impairment of the link's frames: delay, loss, and the kinds of messages that they apply to.
    pub fn impairment(&self) -> Impairment {
        Impairment { delay: Span::from_secs(self.delay_s), loss: self.loss, kinds: self.impairs.clone() }
    }
}
