//! A team without an access point: each robot simulates itself, one runs the state server, and what this says and hears
//! of those out of reach crosses hops.

use std::collections::BTreeSet;

use murmurate::deploy::Deployment;
use murmurate::messages::geometry::Vec2;
use murmurate::messages::wire::Kind;
use murmurate::net::media::radio::{Radio, Topology};
use murmurate::net::protocol::counts::LinkCounts;
use murmurate::policy::Model;
use murmurate::report::TrialReport;
use murmurate::safety::Safety;
use murmurate::trial::Trial;

/// Range \[m\] of the ad-hoc link of a team of eight: less than the width of its formation.
const RANGE_M: f32 = 2.4;

/// Returns the deployment of a team whose robots each simulate themselves, and know of each other by wires. The ad-hoc
/// link carries all else; without a mesh, wires carry what the state server says and hears.
fn deployment(robots: usize, mesh: bool) -> Deployment {
    let mut team = Deployment::preset("onboard-adhoc", robots).expect("it is a mode");
    team.hosts.pop().expect("the world and the state server");
    for (robot, host) in (0..).zip(&mut team.hosts) {
        host.simulates = vec![robot];
        host.state_server = robot == 0;
    }
    let led = [Kind::Heartbeat, Kind::Mode, Kind::Stop];
    let [adhoc, infra, wires] = &mut team.links[..] else { panic!("it has three links") };
    infra.carries.clear();
    wires.carries = vec![Kind::Reading];
    if mesh { adhoc } else { wires }.carries.extend(led);
    team.links[0].mesh = mesh;
    team.links.remove(1);
    let radio = Radio {
        channel: Topology::AdHoc,
        basic_rate: "ofdm-6".parse().expect("a rate of the table"),
        range_m: Some(RANGE_M),
        sense_m: Some(2.0 * RANGE_M),
        ..Radio::default()
    };
    team.links[0].radio = Some(radio);
    team
}

/// Number of episodes of a run.
const EPISODES: u32 = 5;

fn run(mesh: bool, seed: u64) -> TrialReport {
    let trial = Trial::of_team("onboard-adhoc", "passage", 8).expect("a preset");
    let model = Model::shipped("passage").expect("a policy of any size");
    let trial = Trial::new(deployment(8, mesh), trial.scenario, model).safety(Safety::deployed());
    trial.seed(seed).episodes(EPISODES).keeping_steps().run()
}

/// Returns the share of the time in which a robot was cut off from the one with the state server, and the longest time
/// \[s\] for which one was.
fn split(report: &TrialReport) -> (f64, f64) {
    let (mut cut, mut since, mut longest) = (0, [None; 8], 0.0_f64);
    for step in &report.steps {
        let at: Vec<Vec2> = step.samples.iter().map(|sample| sample.motion.position).collect();
        let (mut found, mut next) = (BTreeSet::from([0]), vec![0]);
        while let Some(from) = next.pop() {
            let near = (0..at.len()).filter(|to| (at[*to] - at[from]).norm() <= RANGE_M);
            next.extend(near.filter(|to| found.insert(*to)));
        }
        cut += u32::from(found.len() < at.len());
        let now = step.samples[0].time;
        for (robot, since) in since.iter_mut().enumerate() {
            *since = if found.contains(&robot) { None } else { since.or(Some(now)) };
            longest = longest.max(since.map_or(0.0, |since| now.since(since).as_secs()));
        }
    }
    (f64::from(cut) / report.steps.len() as f64, longest)
}

#[test]
fn a_team_without_an_access_point_crosses_the_passage_as_one_that_all_hear() {
    let runs = std::env::var("MESH_RUNS").ok().map(|count| count.parse().expect("MESH_RUNS is a number"));
    let runs: u64 = runs.unwrap_or(3);
    let (mut succeed, mut time, mut cut, mut air) = ([0; 2], 0.0, 0.0, [0.0; 2]);
    for seed in 1..=runs {
        let both = [true, false].map(|mesh| run(mesh, seed));
        let [hops, heard] = &both;
        assert_eq!(hops.episodes.len(), EPISODES as usize, "seed {seed}");
        assert!(hops.totals.links.over_hops > 100 && heard.totals.links.over_hops == 0, "{:?}", hops.totals.links);
        let LinkCounts { forged, misrouted, unfresh, passed_on, .. } = hops.totals.links;
        assert!(forged == 0 && misrouted == 0 && unfresh < passed_on / 50, "{:?}", hops.totals.links);
        for (mode, report) in both.iter().enumerate() {
            succeed[mode] += report.successes();
            air[mode] += airtime(report) / runs as f64;
        }
        time += hops.simulated.as_secs();
        cut += split(hops).0 * hops.simulated.as_secs();
        println!("seed {seed}: cut off for {:.1} s at the most", split(hops).1);
    }
    let (all, share) = (runs as usize * EPISODES as usize, 100.0 * cut / time);
    println!("{succeed:?} of {all} succeed; split {share:.2} % of the time; airtime {air:.3?}");
    assert!(succeed[0] + all / 10 + 1 >= succeed[1], "{succeed:?} of {all}");
}

/// Returns the share of the time in which something was on the air.
fn airtime(report: &TrialReport) -> f64 {
    1e-9 * report.totals.radio.airtime_ns as f64 / report.simulated.as_secs()
}
