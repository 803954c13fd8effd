//! Stations of a field that are so close that all sense and read each other: while they are, the field is one domain.
//! With powers it is one up to the next instant at which two begin: which frame is read then differs by receiver. An
//! acknowledgement whose stations part while it is on the air is not lost.

use super::{Field, places};
use crate::net::media::radio::Adaptation;
use crate::net::media::radio::domain::Domain;
use crate::net::media::radio::traffic::Traffic;
use crate::net::media::radio::view::View;
use crate::time::Time;

impl<T: Clone> Field<T> {
    /// Takes up where stations are now. If all are close, and the medium is idle for all of them alike, they share a
    /// domain from now on; if some are not, and it is idle, each has its own view again.
    pub(super) fn gather_or_part(&mut self, traffic: &Traffic<T>, now: Time) {
        if !self.placed {
            self.links.moved();
            self.places.clear();
            self.places.extend(places(traffic));
            self.close = self.are_close(traffic);
            self.placed = true;
        }
        match &self.together {
            Some(together) if !self.close || self.collide(together, traffic, now) => {
                let Some(free_at) = together.idle_since(now) else { return };
                self.together = None;
                self.views.fill(View::new(free_at));
                (0..self.views.len()).for_each(|station| self.plan(traffic, station));
            }
            None if self.close => {
                let Some(free_at) = self.idle_for_all() else { return };
                let together = Domain::idle_from(free_at);
                if self.collide(&together, traffic, now) {
                    return;
                }
                self.together = Some(together);
                (0..self.views.len()).for_each(|station| self.turns.set(station, None));
            }
            _ => {}
        }
    }

    /// Returns whether stations that are close begin at one instant, so that their powers matter.
    fn collide(&self, together: &Domain, traffic: &Traffic<T>, now: Time) -> bool {
        traffic.radio.powers.is_some() && together.collides_at(traffic, now)
    }

    /// Returns whether all stations sense and read each other without doubt, at fixed rates.
    fn are_close(&self, traffic: &Traffic<T>) -> bool {
        let radio = &traffic.radio;
        if radio.adaptation != Adaptation::Fixed {
            return false;
        }
        let mut located = self.places.iter().flatten();
        let first = located.next().copied().unwrap_or_default();
        let (least, most) = located.fold((first, first), |(least, most), at| (least.inf(at), most.sup(at)));
        // No two are farther apart than opposite corners of what contains all.
        let power = self.links.least_power(radio, (most - least).norm_squared());
        power.is_some_and(|power| self.thresholds.is_clear(power))
    }

    /// Returns the time from which all stations count slots, if nothing is on the air or about to be.
    fn idle_for_all(&self) -> Option<Time> {
        let first = self.views.first()?;
        let alike = |view: &View| view.free_at == first.free_at && !view.unread;
        (self.events.is_empty() && self.views.iter().all(alike)).then_some(first.free_at)
    }
}
