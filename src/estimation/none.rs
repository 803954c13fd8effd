//! No estimation: the last reading is the estimate, as in the published system.

use super::{Estimator, Settings};
use crate::messages::geometry::Motion;
use crate::messages::wire::Reading;
use crate::time::Time;

#[derive(Debug, Default)]
struct Last(Option<Motion>);

/// Makes an estimator that returns the last reading unchanged, and has received none yet. It has no settings.
pub fn make(_: &Settings) -> Box<dyn Estimator> {
    Box::<Last>::default()
}

impl Estimator for Last {
    fn take(&mut self, _: Time, reading: &Reading) {
        self.0 = Some(reading.motion());
    }

    fn at(&self, _: Time) -> Option<Motion> {
        self.0
    }
}
