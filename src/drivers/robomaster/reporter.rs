//! Reporter of the robot's condition: each change once, with the reason of a fault.

use super::super::Out;
use crate::messages::wire::{Hardware, Health, Reason};

/// Reporter of one robot.
pub struct Reporter {
    /// Health that was last reported, with its reason.
    told: Option<(Health, Option<Reason>)>,
    /// Reason for which there is no connection.
    pub unconnected: Option<Reason>,
}

impl Default for Reporter {
    fn default() -> Reporter {
        Reporter { told: None, unconnected: Reason::new("no connection yet") }
    }
}

impl Reporter {
    /// Reports a condition with the charge of the battery \[%\], if it is new.
    pub fn report(&mut self, health: Health, reason: Option<Reason>, battery: Option<u8>, out: &mut Vec<Out>) {
        let told = Some((health, reason.clone()));
        if self.told != told {
            self.told = told;
            out.push(Out::Condition(Hardware { health, battery, temperature: None, reason }));
        }
    }

    /// Reports that there is no connection, if that is new.
    pub fn unconnected(&mut self, battery: Option<u8>, out: &mut Vec<Out>) {
        self.report(Health::Silent, self.unconnected.clone(), battery, out);
    }

    /// Whether the robot was last reported as silent.
    pub fn is_silent(&self) -> bool {
        self.told.as_ref().is_some_and(|(health, _)| *health == Health::Silent)
    }

    /// Reports the next condition in any case.
    pub fn repeat(&mut self) {
        self.told = None;
    }
}
