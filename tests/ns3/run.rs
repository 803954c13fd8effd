//! One run of the channel with the load of a reference run.

use std::sync::Arc;

use murmurate::messages::geometry::Vec2;
use murmurate::net::media::radio::{Channel, Destination, Radio, RadioCounts};
use murmurate::random::{self, Seed};
use murmurate::time::{Span, Time};

/// Stations, their places and their load.
#[derive(Clone, Debug)]
pub struct Case {
    pub radio: Radio,
    pub places: Vec<[f32; 2]>,
    /// Sender and receiver of each flow of unicast; a sender without a receiver multicasts.
    pub flows: Vec<(u16, Option<u16>)>,
    /// Datagrams of a flow \[1/s\], at random (Poisson) times.
    pub load_per_s: f64,
    pub bytes: usize,
    pub warm_s: f64,
    pub seconds: f64,
    /// Distance up to which a copy of multicast is wanted \[m\].
    pub wanted_m: f32,
}

/// Mean over some seeds.
#[derive(Clone, Copy, Debug, Default)]
pub struct Measured {
    pub delivered: f64,
    pub p50_ms: f64,
    pub p90_ms: f64,
    pub p99_ms: f64,
    pub arrived_per_s: f64,
    pub transmitted_per_s: f64,
    pub retries: f64,
}

impl Case {
    /// Runs the case with the seeds from 1 on.
    pub fn mean(&self, seeds: u64) -> Measured {
        let all: Vec<Measured> = (1..=seeds).map(|seed| self.run(seed)).collect();
        let mean = |of: fn(&Measured) -> f64| all.iter().map(of).sum::<f64>() / seeds as f64;
        Measured {
            delivered: mean(|one| one.delivered),
            p50_ms: mean(|one| one.p50_ms),
            p90_ms: mean(|one| one.p90_ms),
            p99_ms: mean(|one| one.p99_ms),
            arrived_per_s: mean(|one| one.arrived_per_s),
            transmitted_per_s: mean(|one| one.transmitted_per_s),
            retries: mean(|one| one.retries),
        }
    }

    fn run(&self, seed: u64) -> Measured {
        let at = |s: f64| Time::ZERO + Span::from_secs(s);
        let stations = self.places.len() as u16;
        let mut channel: Channel<(Time, u16)> = Channel::new(self.radio.clone(), stations, &Seed::of_run(seed));
        let places: Vec<Vec2> = self.places.iter().map(|place| Vec2::from(*place)).collect();
        for (station, place) in (0..).zip(&places) {
            channel.place(station, *place);
        }
        let near = |from: u16, to: u16| {
            from != to && (places[usize::from(from)] - places[usize::from(to)]).norm() <= self.wanted_m
        };
        let end_s = self.warm_s + self.seconds;
        let mut offers: Vec<(Time, usize)> = Vec::new();
        for (flow, _) in self.flows.iter().enumerate() {
            let mut gaps = Seed::of_run(seed).child("load").stream(&format!("flow/{flow}"));
            let mut s = random::exponential(&mut gaps) / self.load_per_s;
            while s < end_s {
                offers.push((at(s), flow));
                s += random::exponential(&mut gaps) / self.load_per_s;
            }
        }
        offers.sort_unstable();
        let all: Arc<[u16]> = (0..stations).collect();
        let (mut arrived, mut wanted) = (Vec::new(), 0);
        let mut before: Option<(RadioCounts, u64)> = None;
        let retries = |channel: &Channel<(Time, u16)>| -> u64 {
            (0..stations).map(|station| channel.station_counts(station).retries).sum()
        };
        for (now, flow) in offers {
            channel.wake(now, &mut arrived);
            let (from, to) = self.flows[flow];
            if now >= at(self.warm_s) {
                before.get_or_insert_with(|| (channel.counts(now), retries(&channel)));
                wanted += to.map_or_else(|| (0..stations).filter(|&to| near(from, to)).count(), |_| 1);
            }
            let to = to.map_or_else(|| Destination::Many(Arc::clone(&all)), Destination::One);
            channel.offer(now, from, to, self.bytes, (now, from));
        }
        channel.wake(at(end_s), &mut arrived);
        let (before, retries_before) = before.unwrap_or_default();
        let (after, retries_after) = (channel.counts(at(end_s)), retries(&channel));
        channel.wake(at(end_s + 1.0), &mut arrived);
        let unicast = self.flows.iter().any(|(_, to)| to.is_some());
        let inside = |time: Time| time >= at(self.warm_s) && time < at(end_s);
        let counted = arrived.iter().filter(|one| inside(one.token.0) && (unicast || near(one.from, one.to)));
        let mut delays: Vec<f64> = counted.map(|one| 1e3 * one.at.since(one.token.0).as_secs()).collect();
        delays.sort_by(f64::total_cmp);
        let quantile = |share: f64| delays.get((share * delays.len() as f64) as usize).copied().unwrap_or(f64::NAN);
        let transmitted = (after.transmissions - before.transmissions) as f64;
        Measured {
            delivered: delays.len() as f64 / f64::from(wanted as u32),
            p50_ms: quantile(0.5),
            p90_ms: quantile(0.9),
            p99_ms: quantile(0.99),
            arrived_per_s: arrived.iter().filter(|one| inside(one.at)).count() as f64 / self.seconds,
            transmitted_per_s: transmitted / self.seconds,
            retries: (retries_after - retries_before) as f64 / transmitted.max(1.0),
        }
    }
}
