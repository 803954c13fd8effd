//! Stations of a field that are so close that all sense and read each other: while they are, the field is one domain.

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
            Some(together) if !self.close => {
                let Some(free_at) = together.idle_since(now) else { return };
                self.together = None;
                self.views.fill(View::new(free_at));
                (0..self.views.len()).for_each(|station| self.plan(traffic, station));
            }
            None if self.close => {
                let Some(free_at) = self.idle_for_all() else { return };
                self.together = Some(Domain::idle_from(free_at));
                (0..self.views.len()).for_each(|station| self.turns.set(station, None));
            }
            _ => {}
        }
    }

    /// Returns whether all stations sense and read each other, at one power and at fixed rates.
    fn are_close(&self, traffic: &Traffic<T>) -> bool {
        let radio = &traffic.radio;
        if radio.powers.is_some() || radio.adaptation != Adaptation::Fixed {
            return false;
        }
        let mut located = self.places.iter().flatten();
        let Some(first) = located.next() else { return true };
        let (least, most) = located.fold((*first, *first), |(least, most), at| (least.inf(at), most.sup(at)));
        let reach_m = [radio.range_m, radio.sense_m].into_iter().flatten().fold(f32::INFINITY, f32::min);
        // No two are farther apart than opposite corners of what contains all.
        (most - least).norm_squared() <= reach_m * reach_m
    }

    /// Returns the time from which all stations count slots, if nothing is on the air or about to be.
    fn idle_for_all(&self) -> Option<Time> {
        let first = self.views.first()?;
        let alike = |view: &View| view.free_at == first.free_at && !view.unread;
        (self.events.is_empty() && self.views.iter().all(alike)).then_some(first.free_at)
    }
}
