//! Reports the condition of the robot's hardware to its Body: each change once, with the reason of a fault.

use murmurate::drivers::Out;
use murmurate::messages::wire::{Hardware, Health, Reason};

/// Reporter of the hardware condition of one robot. It suppresses repetitions.
pub(crate) struct Reporter {
    /// Health that was last reported, with its reason.
    told: Option<(Health, Option<Reason>)>,
    /// Reason why there is no connection with the robot; `None` if it is not known.
    pub(crate) unconnected: Option<Reason>,
}

impl Default for Reporter {
    fn default() -> Reporter {
        Reporter { told: None, unconnected: Reason::new("no connection yet") }
    }
}

impl Reporter {
    /// Appends the condition to `out`, with the charge of the battery \[%\], if health or reason differ from the last
    /// report. A changed charge alone is not reported.
    pub fn report(&mut self, health: Health, reason: Option<Reason>, battery: Option<u8>, out: &mut Vec<Out>) {
        let told = Some((health, reason.clone()));
        if self.told != told {
            self.told = told;
            out.push(Out::Condition(Hardware { health, battery, temperature: None, reason }));
        }
    }

    /// Reports the robot as silent for lack of a connection, with the charge of the battery \[%\], if that was not
    /// the last report.
    pub(crate) fn unconnected(&mut self, battery: Option<u8>, out: &mut Vec<Out>) {
        self.report(Health::Silent, self.unconnected.clone(), battery, out);
    }

    /// Whether the robot was last reported as silent.
    pub fn is_silent(&self) -> bool {
        self.told.as_ref().is_some_and(|(health, _)| *health == Health::Silent)
    }

    /// Forgets the last report, so that the next condition is reported even if it is the same.
    pub fn repeat(&mut self) {
        self.told = None;
    }
}
