//! Fit of a twin's links: delay and loss of the datagrams between hosts in a recorded run.
//!
//! Loss counts first transmissions alone, so that retransmissions do not hide it. A one-way delay is known only as well
//! as the clocks: `record::merge` takes the fastest datagrams of both directions as equally long. The mean over both
//! directions of a pair is half of the way there and back, whatever the clocks say. So the delay of a link is the mean
//! over its ordered pairs of hosts of the median over their datagrams.

use std::collections::BTreeMap;
use std::ops::Range;

use super::estimate::{Estimate, bootstrap, quantile_of};
use murmurate::messages::ids::{HostId, LinkId};
use murmurate::random::Stream;

/// Outcome of one datagram of a recorded run at one host that should have received it: its delay, or that it was lost.
/// A multicast datagram has one outcome for each of its receivers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// Episode in which the datagram was sent, or before whose start it was sent during the reset.
    pub episode: u32,
    /// Link on which the datagram was sent.
    pub link: LinkId,
    /// Host that sent the datagram.
    pub from: HostId,
    /// Host that should have received the datagram.
    pub to: HostId,
    /// Time from sending to arrival \[ns\]; `None` if the first transmission of the datagram was lost.
    pub took_ns: Option<i64>,
    /// Distance between the robots of the two hosts when the datagram was sent \[m\]; `None` if it is not known.
    pub distance_m: Option<f32>,
}

/// Delay and loss of a link, as fitted to the datagrams of a recorded run, or as given by the user.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FittedLink {
    /// Number of datagrams that should have arrived, counted at each of their receivers.
    pub due: usize,
    /// Probability that a receiver loses a datagram, 0 to 1; `None` if it is not known.
    pub loss: Option<Estimate>,
    /// One-way delay \[s\], as the mean over pairs of hosts of their median delays; `None` if it is not known.
    pub delay_s: Option<Estimate>,
    /// 5 % and 95 % quantiles of the one-way delay of single datagrams \[s\]; `None` if they are not known.
    pub spread_s: Option<[f64; 2]>,
}

impl FittedLink {
    /// Returns the link without its delay, if that is below zero: then sent and received times are of clocks that
    /// differ, and messages do not go both ways.
    pub fn of_clocks(self) -> FittedLink {
        let early = self.delay_s.is_some_and(|delay_s| delay_s.value < 0.0);
        if early { FittedLink { delay_s: None, spread_s: None, ..self } } else { self }
    }
}

/// Ordered pair of hosts on a link: link, sender, receiver.
type Pair = (LinkId, HostId, HostId);

/// Datagrams of one episode: how many were due, how many arrived, and the delays for each pair of hosts \[s\].
#[derive(Default)]
struct Counted {
    due: usize,
    arrived: usize,
    delays_s: BTreeMap<Pair, Vec<f64>>,
    /// Mean over the ordered pairs of hosts of the median delay \[s\]; `None` without arrivals.
    delay_s: Option<f64>,
}

/// Fits delay and loss of the link `link` to the datagrams of these episodes; of all links together if `link` is
/// `None`. Returns `None` if no datagram arrived.
pub fn fit(
    crossings: &[Crossing],
    link: Option<LinkId>,
    episodes: Range<u32>,
    stream: &mut Stream,
) -> Option<FittedLink> {
    let mut counted: Vec<Counted> = episodes.clone().map(|_| Counted::default()).collect();
    let of_link = |crossing: &&Crossing| link.is_none_or(|link| link == crossing.link);
    for crossing in crossings.iter().filter(of_link).filter(|crossing| episodes.contains(&crossing.episode)) {
        let counted = &mut counted[(crossing.episode - episodes.start) as usize];
        counted.due += 1;
        if let Some(took_ns) = crossing.took_ns {
            counted.arrived += 1;
            let pair = (crossing.link, crossing.from, crossing.to);
            counted.delays_s.entry(pair).or_default().push(took_ns as f64 / 1e9);
        }
    }
    let mut all = Vec::new();
    for episode in &mut counted {
        let medians = episode.delays_s.values().map(|delays| quantile_of(delays.clone(), 0.5));
        let medians: Vec<f64> = medians.flatten().collect();
        episode.delay_s = (!medians.is_empty()).then(|| medians.iter().sum::<f64>() / medians.len() as f64);
        all.extend(std::mem::take(&mut episode.delays_s).into_values().flatten());
    }
    let sum = |drawn: &[usize], of: fn(&Counted) -> usize| drawn.iter().map(|at| of(&counted[*at])).sum::<usize>();
    let loss = bootstrap(counted.len(), stream, |drawn| {
        let (due, arrived) = (sum(drawn, |episode| episode.due), sum(drawn, |episode| episode.arrived));
        (due > 0).then(|| 1.0 - arrived as f64 / due as f64)
    })?;
    let delay_s = bootstrap(counted.len(), stream, |drawn| {
        let delays: Vec<f64> = drawn.iter().filter_map(|at| counted[*at].delay_s).collect();
        (!delays.is_empty()).then(|| delays.iter().sum::<f64>() / delays.len() as f64)
    })?;
    let end = |q| quantile_of(all.clone(), q).unwrap_or(delay_s.value);
    let due = counted.iter().map(|episode| episode.due).sum();
    let spread_s = Some([end(0.05), end(0.95)]);
    Some(FittedLink { due, loss: Some(loss), delay_s: Some(delay_s), spread_s })
}

#[cfg(test)]
mod tests {
    use rand::RngExt;

    use super::*;
    use murmurate::random::Seed;

    /// Datagrams of three hosts in eight episodes, with a clock that is ahead.
    fn crossings(delay_ns: i64, loss: f64, ahead_ns: i64) -> Vec<Crossing> {
        let mut stream = Seed::of_run(2).stream("test");
        let mut all = Vec::new();
        for (episode, from, to) in (0..8).flat_map(|e| (0..3).flat_map(move |f| (0..3).map(move |t| (e, f, t)))) {
            let skew = [0, 0, ahead_ns];
            for _ in 0..if from == to { 0 } else { 300 } {
                let took = delay_ns + skew[to] - skew[from] + stream.random_range(0..400_000);
                let took_ns = (!stream.random_bool(loss)).then_some(took);
                let [from, to] = [from, to].map(|host| HostId(host as u16));
                all.push(Crossing { episode, link: LinkId(1), from, to, took_ns, distance_m: None });
            }
        }
        all
    }

    #[test]
    fn delay_and_loss_are_found_whatever_the_clocks_say() {
        for (delay_ns, loss, ahead_ns) in
            [(20_000_000, 0.16, 0), (5_000_000, 0.4, 3_000_000), (1_000_000, 0.0, -9_000_000)]
        {
            let all = crossings(delay_ns, loss, ahead_ns);
            let mut stream = Seed::of_run(1).stream("links");
            let found = fit(&all, Some(LinkId(1)), 0..4, &mut stream).unwrap();
            assert_eq!(found.due, 4 * 6 * 300);
            let value = |found: Option<Estimate>| found.expect("it was fitted").value;
            assert!((value(found.loss) - loss).abs() < 0.02, "{found:?}");
            assert!((value(found.delay_s) - delay_ns as f64 / 1e9 - 0.0002).abs() < 0.0001, "{found:?}");
            assert!(fit(&all, Some(LinkId(0)), 0..4, &mut stream).is_none());
        }
    }

    #[test]
    fn a_delay_below_zero_is_none_and_the_loss_stays() {
        let both = crossings(1_000_000, 0.1, -9_000_000);
        let one: Vec<Crossing> = both.iter().filter(|crossing| crossing.to == HostId(2)).copied().collect();
        let fitted = |all: &[Crossing]| {
            let found = fit(all, None, 0..8, &mut Seed::of_run(1).stream("links")).expect("messages arrived");
            found.of_clocks()
        };
        assert!(fitted(&both).delay_s.is_some());
        let found = fitted(&one);
        assert!((found.delay_s, found.spread_s) == (None, None) && found.loss.is_some(), "{found:?}");
    }
}
