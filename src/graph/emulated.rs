//! Emulated links of a run in one process: an actor for each, which carries datagrams between the Networks of its
//! hosts.

use std::f32::consts::SQRT_2;
use std::rc::Rc;

use tracing::info_span;

use crate::actors::network;
use crate::deploy::{Host, Link, Routes};
use crate::graph::agents::parts_of;
use crate::graph::event::Event;
use crate::graph::process::Graph;
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::wire::Kind;
use crate::net::media::emulator::LinkEmulator;
use crate::net::media::ether::{self, Ether};
use crate::net::media::radio_link::RadioLink;
use crate::net::media::reach::Reach;
use crate::net::protocol::codec;
use crate::net::protocol::reliability::Reliability;
use crate::net::transport;
use crate::runtime::clock::Clock;
use crate::runtime::shell::{Mailbox, start};
use crate::trial::Trial;

/// Largest team whose latents are carried everywhere: the work for all is little there.
const FEW: usize = 64;
/// Distance \[m\] beyond all that is computed, up to which latents are carried.
const MARGIN_M: f32 = 0.5;
/// Largest speed along a diagonal, in the limit of the speed along each axis.
const FASTEST_AXES: f32 = SQRT_2;
/// Number of standard deviations by which a measurement is taken to be wrong at most, along a diagonal.
const FAR_DEVIATIONS: f32 = 8.0 * SQRT_2;

/// Reception of datagrams on emulated links.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Reception {
    /// Hosts take datagrams as they arrive.
    AtOnce,
    /// As `AtOnce`, and datagrams to all reach every host, whatever they contain, as on real links.
    Shared,
    /// Hosts take latents when they next do something else, as of their arrival. It gives the same run, and each host
    /// takes many together: those of a large team do not fit into a processor's caches at once.
    Left,
}

/// Starts the emulated links.
pub(super) fn wire_links(clock: &Clock, trial: &Trial, graph: &Graph, reception: Reception) {
    let shared = reception == Reception::Shared;
    if reception == Reception::Left {
        RobotId::team(trial.deployment.robots).for_each(|robot| {
            graph.caches[robot.index()].runs_after(&graph.network_of(graph.routes.agent_host(robot)));
        });
    }
    let everyone: Vec<HostId> = (0..).map(HostId).take(trial.deployment.hosts.len()).collect();
    let first_robot = |host: &Host| host.agents.concat().into_iter().min();
    let robots_of: Rc<[Option<u16>]> = trial.deployment.hosts.iter().map(first_robot).collect();
    let walls: Rc<[_]> = trial.scenario.arena().keep_outs.iter().map(|block| block.solid().rim()).collect();
    for (index, link) in trial.deployment.links.iter().enumerate() {
        let walls = Rc::clone(&walls);
        let id = LinkId(u16::try_from(index).expect("links are counted in u16"));
        let routes = graph.routes.clone();
        let (impairment, faults) = (link.impairment(), trial.faults.of_link(&link.name));
        let (seed, name) = (trial.streams(), link.name.clone());
        let (radio, range_m, robots_of) = (link.radio.clone(), link.range_m, Rc::clone(&robots_of));
        let everyone = shared.then(|| everyone.clone());
        let users_m = users_m(trial, link).filter(|_| !shared);
        let make = move |incarnation| {
            let stream = seed.stream(&format!("link/{name}/{incarnation}"));
            let emulator = LinkEmulator::new(impairment.clone(), faults.clone(), stream);
            let air = || seed.child(&format!("link/{name}/radio/{incarnation}"));
            let radio_link =
                radio.clone().map(|radio| RadioLink::new(radio, &robots_of, &air()).walled(walls.to_vec()));
            let reach = range_m.map(|range_m| Reach::new(range_m, &robots_of));
            let listens = |kind| everyone.clone().unwrap_or_else(|| routes.listeners(kind));
            let users = users_m.map(|users_m| Reach::new(users_m, &robots_of));
            Ether::new(emulator, radio_link, reach, listens).with_users(users)
        };
        let leaves = reception == Reception::Left && only_remembers(trial, link, &graph.routes);
        let (networks, events) = (graph.networks.clone(), Rc::clone(&graph.events));
        // The counts of a medium are of no host; the one that judges reports them.
        let judge = trial.deployment.judge();
        start(clock, &graph.media[index], info_span!("ether", link = link.name), make, move |out| match out {
            ether::Out::Arrive(to, frame) => {
                events.emit(to, Event::Arrived(id, &frame));
                let network = &networks[usize::from(to.0)];
                if leaves && codec::is_only(&frame, Kind::Latent) {
                    network.leave(network::In::Frame(id, frame, None));
                } else {
                    network.send(network::In::Frame(id, frame, None));
                }
            }
            ether::Out::Counts(counts) => events.emit(judge, Event::Radio(id, &counts)),
        });
    }
}

/// Returns whether hosts do nothing upon latents that arrive on a link but remember them: they neither ask for lost
/// ones, nor join parts, nor hold them against readings, nor fail.
fn only_remembers(trial: &Trial, link: &Link, routes: &Routes) -> bool {
    let plain = link.reliability.values().all(|one| *one == Reliability::BestEffort);
    let witnessed = RobotId::team(trial.deployment.robots).any(|robot| routes.is_witnessed(robot));
    plain && !witnessed && trial.faults.actors.is_empty() && parts_of(&trial.models).is_none()
}

/// Returns the distance \[m\] from its sender beyond which a latent on a link is of no use to any robot, so that it
/// need not be carried there; `None` if it has to be carried everywhere: in a small team, where robots may be mistaken
/// about where they are, where ranges are drawn, where what arrives is counted, and on ground so small that all are
/// near each other.
///
/// Robots accept latents within their communication range. Between the World's step and the reception both robots move,
/// and their measurements have noise.
pub(super) fn users_m(trial: &Trial, link: &Link) -> Option<f32> {
    let deployment = &trial.deployment;
    if deployment.robots <= FEW {
        return None;
    }
    let one_each = deployment.hosts.iter().all(|host| host.agents.concat().len() <= 1);
    let ranges = || RobotId::team(deployment.robots).map(|robot| trial.comm_range(robot));
    let certain = trial.faults.actors.is_empty() && trial.faults.links.is_empty() && !trial.everywhere;
    let whole = parts_of(&trial.models).is_none();
    if !(one_each && certain && whole && ranges().all(|range| range.std_m == 0.0) && link.radio.is_none()) {
        return None;
    }
    let sensor = trial.physics.sensor;
    let age = link.impairment().delay + sensor.latency + sensor.period + trial.step_takes + trial.models.period() * 2;
    let driven_m = 2.0 * FASTEST_AXES * trial.models.limit_m_s() * age.as_secs() as f32;
    let noise_m = 2.0 * FAR_DEVIATIONS * (sensor.position_m + sensor.velocity_m_s * age.as_secs() as f32);
    let users_m = ranges().map(|range| range.mean_m).fold(0.0, f32::max) + driven_m + noise_m + MARGIN_M;
    let across_m = 2.0 * trial.scenario.arena().half_extent.norm();
    (users_m < across_m).then_some(users_m)
}

/// Returns a function that passes an input for a transport to the emulated medium of its link.
pub(super) fn to(media: Rc<[Mailbox<ether::In>]>) -> impl Fn(LinkId, transport::In) {
    move |link, input| match input {
        transport::In::Transmit(transmit) => media[usize::from(link.0)].send(ether::In::Transmit(transmit)),
        // Hosts have no addresses there.
        transport::In::Admit(_) => {}
    }
}

#[cfg(test)]
mod tests {
    //! Whole episodes under virtual time with the protocol of real links, of which each datagram is lost with a
    //! probability of 20 %: how many are aborted because five heartbeats in a row are lost.

    use std::cell::RefCell;

    use super::*;
    use crate::graph::process::Process;
    use crate::graph::wire_all;
    use crate::messages::wire::KINDS;
    use crate::net::protocol::key::Key;
    use crate::net::protocol::reliability::{Heartbeats, Reliabilities, Setup};
    use crate::report::TrialReport;
    use crate::results::episode::Episode;
    use crate::runtime::drive::run_virtual;
    use crate::scenario::judge::Verdict;
    use crate::time::{Span, Time};
    use crate::trial::Trial;

    /// Probability that a receiver loses a datagram.
    const LOSS: f64 = 0.2;
    /// Longest simulated time of an episode with its reset \[s\].
    const LONGEST_S: f64 = 60.0;

    /// Returns how many episodes of five robots on their own hosts are run: `MURMURATE_LOSSY_EPISODES`, or few.
    fn wanted() -> u32 {
        std::env::var("MURMURATE_LOSSY_EPISODES").map_or(12, |count| count.parse().expect("it is a number of episodes"))
    }

    /// Runs episodes in which all hosts are on one link with this setup, and all datagrams on it may be lost.
    fn episodes(setup: &Setup, seed: u64) -> Vec<Episode> {
        let count = wanted();
        let trial = Trial::preset("onboard-infra", "passage").expect("they are there").seed(seed).episodes(count);
        let mut trial = trial;
        for link in &mut trial.deployment.links {
            (link.loss, link.impairs) = (LOSS, KINDS.to_vec());
        }
        let routes = Routes::of(&trial.deployment);
        let mut process = Process::all_hosts(&trial, &routes, Rc::new(|_, _| {}));
        for end in process.ends.values_mut() {
            end.key = Some(Key::new([7; 32]));
            end.links.fill(Some(setup.clone()));
        }
        let report = Rc::new(RefCell::new(TrialReport::default()));
        let (noted, ended) = (Rc::clone(&report), Rc::clone(&report));
        let limit = Time::ZERO + Span::from_secs(LONGEST_S) * u64::from(count);
        run_virtual(
            |clock| {
                wire_all(clock, &trial, (&process, routes, Reception::Shared), move |out| noted.borrow_mut().note(out))
            },
            |_, now| ended.borrow().finished || now >= limit,
        );
        let episodes = report.borrow().episodes.clone();
        assert_eq!(episodes.len(), count as usize, "all have a result in time");
        episodes
    }

    fn aborted(setup: &Setup) -> usize {
        let episodes = episodes(setup, 0);
        episodes.iter().filter(|episode| episode.verdict == Verdict::Aborted).count()
    }

    #[test]
    #[expect(clippy::print_stdout, reason = "with --nocapture its figures are what a recipe is run for")]
    fn at_20_percent_loss_no_more_than_one_of_500_episodes_is_aborted_on_multicast_or_unicast() {
        println!("| link | heartbeats | aborted of {} episodes |", wanted());
        for (name, setup) in
            [("multicast", Setup::multicast(Reliabilities::new())), ("unicast", Setup::unicast(Reliabilities::new()))]
        {
            let twice = aborted(&setup);
            println!("| {name} | twice while lossy | {twice} |");
            if wanted() >= 100 {
                let once = aborted(&Setup { heartbeats: Heartbeats::Once, ..setup });
                println!("| {name} | once | {once} |");
                assert!(once > 2 * twice, "that is what it is for");
            }
            assert!(twice <= wanted().div_ceil(500) as usize, "{name}: {twice} of {} were aborted", wanted());
        }
    }
}
