//! Fit of a twin's path loss: how the share of messages that arrive falls with the distance between robots.
//!
//! With log-distance path loss of exponent n and Rayleigh fading, a frame arrives over the distance d with the
//! probability exp(-(d / reach)^n) (A. Goldsmith, Wireless Communications, 2005, 6.3.2): the power is exponentially
//! distributed, and its mean falls with d^n. At the distance `reach` the mean is the least power that is read, and 37 %
//! arrive. What is lost at all distances alike is fitted beside it.

use std::collections::BTreeSet;
use std::ops::Range;

use super::estimate::{Estimate, bootstrap};
use super::links::Crossing;
use murmurate::messages::ids::LinkId;
use murmurate::net::media::radio::{Fading, Powers};
use murmurate::random::Stream;

/// Distance below which the power is that at this distance \[m\].
const REFERENCE_M: f64 = 1.0;
/// Number of intervals of the distance for which messages are counted.
const BINS: usize = 40;
/// Gain of the logarithm of the likelihood, over a share that does not depend on the distance, from which on a path
/// loss is believed. By chance it is less in 999 of 1000 runs (chi-square with two degrees of freedom).
const LEAST_GAIN: f64 = 6.9;
/// Exponents that are looked for.
const EXPONENTS: Range<f64> = 1.0..8.0;

/// Path loss between robots, as fitted to the messages of a recorded run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathLoss {
    /// Exponent of the loss over distance.
    pub exponent: Estimate,
    /// Distance at which the mean power is the least that is read \[m\]; 37 % of messages arrive over it.
    pub reach_m: Estimate,
    /// Share of messages that is lost at all distances.
    pub loss: Estimate,
}

impl PathLoss {
    /// Returns powers of a radio with this path loss: fading, and a receiver that finds preambles up to the reach.
    pub fn powers(&self) -> Powers {
        let rounded = |value: f64| (10.0 * value).round() / 10.0;
        let mut powers =
            Powers { exponent: rounded(self.exponent.value), fading: Fading::Rayleigh, ..Powers::default() };
        powers.detect_dbm = rounded(powers.of_path(self.reach_m.value, 0));
        powers.sense_dbm = powers.detect_dbm;
        powers
    }
}

/// Messages at one distance \[m\]: how many were due, and how many arrived.
#[derive(Clone, Copy, Debug, Default)]
struct Bin {
    distance_m: f64,
    due: f64,
    arrived: f64,
}

/// Parameters that are looked for: exponent, logarithm of the reach, loss.
type Point = [f64; 3];

/// Fits the path loss of the first link that has one to the messages of these episodes whose ends were seen. Returns
/// `None` if the share that arrives does not fall with the distance on any link.
pub fn fit(crossings: &[Crossing], episodes: Range<u32>, stream: &mut Stream) -> Option<PathLoss> {
    let links: BTreeSet<LinkId> = crossings.iter().map(|crossing| crossing.link).collect();
    links.into_iter().find_map(|link| of_link(crossings, link, episodes.clone(), stream))
}

/// Fits the path loss of one link.
fn of_link(crossings: &[Crossing], link: LinkId, episodes: Range<u32>, stream: &Stream) -> Option<PathLoss> {
    let seen = || {
        let of_link = crossings.iter().filter(|crossing| crossing.link == link);
        let within = of_link.filter(|crossing| episodes.contains(&crossing.episode));
        within.filter_map(|crossing| Some((crossing, f64::from(crossing.distance_m?))))
    };
    let farthest_m = seen().map(|(_, distance_m)| distance_m).fold(0.0, f64::max);
    let nearest_m = seen().map(|(_, distance_m)| distance_m).fold(f64::INFINITY, f64::min);
    if farthest_m <= nearest_m {
        return None;
    }
    let width_m = (farthest_m - nearest_m) / BINS as f64;
    let mut counted = vec![[Bin::default(); BINS]; episodes.len()];
    for (crossing, distance_m) in seen() {
        let at = (((distance_m - nearest_m) / width_m) as usize).min(BINS - 1);
        let bin = &mut counted[(crossing.episode - episodes.start) as usize][at];
        bin.due += 1.0;
        bin.arrived += f64::from(u8::from(crossing.took_ns.is_some()));
    }
    let sum = |drawn: &[usize]| {
        let mut all = [Bin::default(); BINS];
        for (at, bin) in all.iter_mut().enumerate() {
            bin.distance_m = nearest_m + width_m * (at as f64 + 0.5);
            for episode in drawn {
                bin.due += counted[*episode][at].due;
                bin.arrived += counted[*episode][at].arrived;
            }
        }
        all
    };
    let all = sum(&(0..counted.len()).collect::<Vec<_>>());
    let start = search(&all, coarse(&all, farthest_m));
    let (due, arrived) = all.iter().fold((0.0, 0.0), |(due, arrived), bin| (due + bin.due, arrived + bin.arrived));
    let even = ln_likelihood_of(due, arrived, arrived / due);
    if likelihood(&all, start) - even < LEAST_GAIN {
        return None;
    }
    let of = |value: fn(Point) -> f64| {
        let mut stream = stream.clone();
        bootstrap(counted.len(), &mut stream, |drawn| Some(value(search(&sum(drawn), start))))
    };
    let exponent = of(|[exponent, ..]| exponent)?;
    let reach_m = of(|[_, ln_reach, _]| ln_reach.exp())?;
    Some(PathLoss { exponent, reach_m, loss: of(|[.., loss]| loss)? })
}

/// Returns the best of some points, from which to search on.
fn coarse(bins: &[Bin], farthest_m: f64) -> Point {
    let mut best = ([3.0, farthest_m.ln(), 0.05], f64::NEG_INFINITY);
    for exponent in [1.5, 2.5, 3.5, 5.0] {
        for reach in [0.1, 0.2, 0.4, 0.7, 1.0, 1.5, 3.0] {
            for loss in [0.001, 0.05, 0.2] {
                let point = [exponent, (reach * farthest_m).ln(), loss];
                let found = likelihood(bins, point);
                if found > best.1 {
                    best = (point, found);
                }
            }
        }
    }
    best.0
}

/// Searches for the most likely parameters from `start` on: one after another, with steps that shrink.
fn search(bins: &[Bin], start: Point) -> Point {
    let (mut best, mut found) = (start, likelihood(bins, start));
    let mut steps = [0.5, 0.2, 0.05];
    for _ in 0..60 {
        let mut improved = false;
        for at in 0..3 {
            for sign in [1.0, -1.0] {
                let mut point = best;
                point[at] += sign * steps[at];
                let likely = likelihood(bins, point);
                if likely > found {
                    (best, found, improved) = (point, likely, true);
                }
            }
        }
        if !improved {
            steps.iter_mut().for_each(|step| *step *= 0.5);
        }
    }
    best
}

/// Returns the logarithm of the likelihood of what arrived; minus infinity for impossible parameters.
fn likelihood(bins: &[Bin], [exponent, ln_reach, loss]: Point) -> f64 {
    if !EXPONENTS.contains(&exponent) || !(0.0..1.0).contains(&loss) {
        return f64::NEG_INFINITY;
    }
    let of_bin = |bin: &Bin| {
        let far = bin.distance_m.max(REFERENCE_M).ln() - ln_reach;
        let share = (1.0 - loss) * (-((exponent * far).exp())).exp();
        ln_likelihood_of(bin.due, bin.arrived, share)
    };
    bins.iter().filter(|bin| bin.due > 0.0).map(of_bin).sum()
}

/// Returns the logarithm of the likelihood that `arrived` of `due` arrive, each with the probability `share`.
fn ln_likelihood_of(due: f64, arrived: f64, share: f64) -> f64 {
    let share = share.clamp(1e-9, 1.0 - 1e-9);
    arrived * share.ln() + (due - arrived) * (1.0 - share).ln()
}

#[cfg(test)]
mod tests {
    use rand::RngExt;

    use super::*;
    use murmurate::messages::ids::HostId;
    use murmurate::random::Seed;

    /// Returns messages over distances up to 40 m, of which the share arrives that `share` gives for a distance.
    fn sent(share: impl Fn(f64) -> f64) -> Vec<Crossing> {
        let mut stream = Seed::of_run(2).stream("sent");
        let mut one = |number: u32| {
            let distance_m = stream.random_range(1.0..40.0);
            let took_ns = (stream.random::<f64>() < share(distance_m)).then_some(1);
            let (link, from, to) = (LinkId(0), HostId(0), HostId(1));
            Crossing { episode: number % 20, link, from, to, took_ns, distance_m: Some(distance_m as f32) }
        };
        (0..20_000).map(&mut one).collect()
    }

    #[test]
    fn a_path_loss_is_found_with_its_interval() {
        let crossings = sent(|distance_m| 0.95 * (-(distance_m / 25.0_f64).powf(3.2)).exp());
        let found = fit(&crossings, 0..20, &mut Seed::of_run(1).stream("path")).expect("a path loss");
        let holds = |estimate: Estimate, value: f64| (estimate.ci95[0]..=estimate.ci95[1]).contains(&value);
        assert!(holds(found.exponent, 3.2) && holds(found.reach_m, 25.0) && holds(found.loss, 0.05), "{found:?}");
        assert!(found.exponent.ci95[1] - found.exponent.ci95[0] < 0.5, "{found:?}");
        let powers = found.powers();
        assert!((powers.of_path(25.0, 0) - powers.detect_dbm).abs() < 1.0, "{powers:?}");
    }

    #[test]
    fn loss_that_is_the_same_everywhere_is_no_path_loss() {
        let stream = || Seed::of_run(1).stream("path");
        assert_eq!(fit(&sent(|_| 0.8), 0..20, &mut stream()), None);
        let mut unseen = sent(|distance_m| if distance_m < 20.0 { 1.0 } else { 0.0 });
        unseen.iter_mut().for_each(|crossing| crossing.distance_m = None);
        assert_eq!(fit(&unseen, 0..20, &mut stream()), None);
    }
}
