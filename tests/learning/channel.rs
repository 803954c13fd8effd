//! Ages and shares of messages in environments of others, beside those in runs of the actors with the same traffic.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

use murmurate::deploy::{Impair, LinkMedium};
use murmurate::faults::{LinkFault, LinkFaultKind};
use murmurate::graph::event::Event;
use murmurate::hearing::CommRange;
use murmurate::messages::geometry::{Planar, Vec2};
use murmurate::messages::ids::HostId;
use murmurate::messages::wire::Kind;
use murmurate::net::media::radio::Radio;
use murmurate::net::protocol::codec::{self, Content};
use murmurate::observation::Observation;
use murmurate::policy::{Interface, Model, Neighbour, Policy};
use murmurate::random::{RngExt, Seed, Stream};
use murmurate::results::totals::Steps;
use murmurate::simulate::Proceed;
use murmurate::time::{Span, Time};
use murmurate::trial::Trial;
use murmurate::world::Placement;
use murmurate_train::air::{Air, Buffers, Bursts, Given, Options};

/// Time from the first messages to the first ages that count, and how long they count \[s\].
const WARM_S: f64 = 0.5;
const COUNTED_S: f64 = 1.5;

/// Number of environments of the air for each run of the actors, so that its own chance is small beside theirs.
const COPIES: usize = 4;

/// Largest distance of the distributions, and of the shares, with all runs.
const BAR: f64 = 0.02;

/// Policy that drives slowly to its goal and broadcasts floats that say nothing.
struct Slow(Interface);

impl Policy for Slow {
    fn interface(&self) -> Interface {
        self.0
    }

    fn encode(&mut self, _own: &Observation, features: &mut [f32]) {
        features.fill(0.5);
    }

    fn act(&mut self, own: &Observation, _: &[f32], _: &[Neighbour], _: &mut Stream) -> Vec2 {
        (own.goal - own.motion.position).capped(0.3)
    }
}

/// Team, its policy and its network. What is not said is the simplest.
#[derive(Clone, Debug)]
struct Setting {
    name: &'static str,
    mode: &'static str,
    robots: usize,
    period_ms: u64,
    hold_ms: u64,
    floats: usize,
    radio: Option<Radio>,
    delay_s: f64,
    /// Largest delay that is drawn for each message, in addition \[s\].
    drawn_s: f64,
    loss: f64,
    bursts: Option<Bursts>,
    range_m: Option<f32>,
    /// Number of runs with all of them.
    runs: usize,
}

const PLAIN: Setting = Setting {
    name: "",
    mode: "onboard-adhoc",
    robots: 5,
    period_ms: 50,
    hold_ms: 400,
    floats: 16,
    radio: None,
    delay_s: 0.0,
    drawn_s: 0.0,
    loss: 0.0,
    bursts: None,
    range_m: None,
    runs: 2000,
};

/// Messages of the kind that is compared are those of robots to each other, or, where agents drive robots over a link,
/// commands to the host of all robots.
fn kind(mode: &str) -> Kind {
    if mode == "offboard" { Kind::MotorCommand } else { Kind::Latent }
}

fn settings() -> Vec<Setting> {
    let radio = |name: &str| Radio::preset(name);
    let near = |name: &str| radio(name).map(|radio| Radio { range_m: Some(1.5), ..radio });
    let bursts = Some(Bursts { share: 0.3, mean_s: 0.3 });
    vec![
        Setting { name: "loss 0.3", robots: 3, hold_ms: 100, loss: 0.3, runs: 4000, ..PLAIN },
        Setting { name: "delay 0.12 s, loss 0.1, 10 Hz", period_ms: 100, delay_s: 0.12, loss: 0.1, ..PLAIN },
        Setting { name: "delays 0 to 0.15 s, loss 0.2", robots: 4, hold_ms: 100, drawn_s: 0.15, loss: 0.2, ..PLAIN },
        Setting { name: "bursts of 0.3 s, 30 %", robots: 3, bursts, runs: 4000, ..PLAIN },
        Setting { name: "range 1.5 m, loss 0.1", robots: 8, range_m: Some(1.5), loss: 0.1, runs: 1500, ..PLAIN },
        Setting { name: "wifi-n, long messages", robots: 12, floats: 200, radio: radio("wifi-n"), runs: 1000, ..PLAIN },
        Setting { name: "wifi", robots: 10, floats: 32, radio: radio("wifi"), runs: 1000, ..PLAIN },
        Setting {
            name: "wifi-slow, long messages",
            robots: 6,
            floats: 128,
            radio: radio("wifi-slow"),
            runs: 6000,
            ..PLAIN
        },
        Setting {
            name: "paper, loss 0.1, delay 0.02 s",
            hold_ms: 100,
            loss: 0.1,
            delay_s: 0.02,
            radio: radio("paper"),
            ..PLAIN
        },
        Setting {
            name: "wifi-n, range 1.5 m, 50 Hz",
            robots: 8,
            period_ms: 20,
            radio: near("wifi-n"),
            runs: 1000,
            ..PLAIN
        },
        // Readings, instructions and heartbeats share this channel, and the air has none of them.
        Setting { name: "access point, wifi", mode: "onboard-infra", hold_ms: 100, radio: radio("wifi"), ..PLAIN },
        Setting {
            name: "unicast, wifi-slow",
            mode: "offboard",
            robots: 8,
            radio: radio("wifi-slow"),
            runs: 1500,
            ..PLAIN
        },
        Setting { name: "unicast, wifi", mode: "offboard", robots: 12, radio: radio("wifi"), runs: 1000, ..PLAIN },
    ]
}

/// Ages of what was held when receivers looked, and how often they looked for a message of another.
#[derive(Default)]
struct Held {
    ages_s: Vec<f64>,
    looks: u64,
}

impl Held {
    fn share(&self) -> f64 {
        self.ages_s.len() as f64 / self.looks as f64
    }

    /// Returns the largest distance of two distribution functions (Kolmogorov and Smirnov).
    fn distance(&mut self, other: &mut Held) -> f64 {
        let (mine, theirs) = (&mut self.ages_s, &mut other.ages_s);
        mine.sort_by(f64::total_cmp);
        theirs.sort_by(f64::total_cmp);
        let (mut below, mut largest) = ([0, 0], 0.0_f64);
        while below[0] < mine.len() && below[1] < theirs.len() {
            let age = mine[below[0]].min(theirs[below[1]]);
            below[0] += mine[below[0]..].iter().take_while(|&&other| other <= age).count();
            below[1] += theirs[below[1]..].iter().take_while(|&&other| other <= age).count();
            let [a, b] = [below[0] as f64 / mine.len() as f64, below[1] as f64 / theirs.len() as f64];
            largest = largest.max((a - b).abs());
        }
        largest
    }
}

/// Robots' messages in a run, by step and then by robot: lengths \[bytes\], 0 for none, and places \[m\].
struct Traffic {
    lengths: Vec<Vec<u32>>,
    places: Vec<Vec<Vec2>>,
}

/// Messages that a receiver held at a time: their senders, and when they had arrived.
struct Look {
    at: Time,
    receiver: HostId,
    held: Vec<(HostId, Time)>,
}

/// Events of one run of the actors.
#[derive(Default)]
struct Log {
    /// When each robot has sent, and how long the datagrams were.
    sent: BTreeMap<u16, Vec<(Time, u32)>>,
    /// When each datagram was sent, by sender and sequence number.
    times: BTreeMap<(HostId, u32), Time>,
    /// When what has arrived was sent, by receiver, sender and arrival.
    arrivals: BTreeMap<(HostId, HostId), BTreeMap<Time, Time>>,
    looks: Vec<Look>,
    places: Vec<(Time, Vec<Vec2>)>,
}

impl Setting {
    fn period_s(&self) -> f64 {
        self.period_ms as f64 / 1000.0
    }

    fn steps(&self, s: f64) -> usize {
        (s / self.period_s()).round() as usize
    }

    /// Returns the medium of the link on which the messages travel.
    fn medium(&self) -> LinkMedium {
        if self.mode == "onboard-adhoc" { LinkMedium::AdHoc } else { LinkMedium::AccessPoint }
    }

    fn trial(&self, seed: u64) -> Trial {
        let (period, hold) = (Span::from_millis(self.period_ms), Span::from_millis(self.hold_ms));
        let interface = Interface { features: self.floats, radius_m: 1e6, period, limit_m_s: 1.0, hold };
        let trial = Trial::of_team(self.mode, "passage", self.robots).expect("a preset of a team of this size");
        let mut trial = trial.model(Model::custom("slow", interface, move |_| Box::new(Slow(interface)))).seed(seed);
        let (delay_s, loss) = (Some(self.delay_s), Some(self.loss));
        trial.deployment = trial.deployment.impaired(delay_s, loss, Impair::Latent).expect("latents cross links");
        if let Some(radio) = &self.radio {
            trial.deployment = trial.deployment.with_radio(radio);
        }
        trial.deployment.placement = Placement::Exact;
        trial.range = self.range_m.map(CommRange::fixed);
        let fault = LinkFault { kinds: vec![Kind::Latent], ..LinkFault::always("ad-hoc") };
        if self.drawn_s > 0.0 {
            let (kind, by) = (LinkFaultKind::Reorder, Span::from_secs(self.drawn_s));
            trial.faults.links.push(LinkFault { kind, by, ..fault.clone() });
        }
        if let Some(bursts) = self.bursts {
            let mut stream = Seed::of_run(seed).stream("bursts");
            trial.faults.links = bursts_of(bursts, self.period_s(), fault, &mut stream);
        }
        trial.steps = Steps::Reported;
        trial.everywhere = true;
        trial.lasting(Span::from_secs(WARM_S + COUNTED_S + 1.0))
    }

    /// Runs the actors, adds what they hold to `held`, and returns what they have sent.
    fn run(&self, seed: u64, held: &mut Held) -> Traffic {
        let trial = self.trial(seed);
        let (kind, robots, medium) = (kind(self.mode), self.robots, self.medium());
        let mine: BTreeSet<u16> =
            (0..).zip(&trial.deployment.links).filter(|(_, link)| link.medium == medium).map(|(at, _)| at).collect();
        let log = Rc::new(RefCell::new(Log::default()));
        let shared = Rc::clone(&log);
        let report = move |now: Time, host: HostId, event: Event| {
            let mut log = shared.borrow_mut();
            log.note((now, host), &event, (kind, &mine, robots as u16));
        };
        let report = trial.run_observed(report, |_, _, _| Proceed::Continue);
        assert!(report.simulated >= Span::from_secs(WARM_S + COUNTED_S + 0.5), "{}", self.name);
        let log = log.borrow();
        let began = log.sent.values().map(|sent| sent[0].0).max().expect("robots send");
        self.count(&log, began, held);
        self.traffic(&log, began)
    }

    fn count(&self, log: &Log, began: Time, held: &mut Held) {
        let (from, to) = (began + Span::from_secs(WARM_S), began + Span::from_secs(WARM_S + COUNTED_S));
        let hold = Span::from_millis(self.hold_ms);
        for look in log.looks.iter().filter(|look| (from..to).contains(&look.at)) {
            held.looks += self.robots as u64 - u64::from(usize::from(look.receiver.0) < self.robots);
            for (sender, arrived) in &look.held {
                let sent = log.arrivals[&(look.receiver, *sender)][arrived];
                if look.at.since(*arrived) <= hold {
                    held.ages_s.push(look.at.since(sent).as_secs());
                }
            }
        }
    }

    fn traffic(&self, log: &Log, began: Time) -> Traffic {
        let steps = self.steps(WARM_S + COUNTED_S);
        let (mut lengths, mut places) = (vec![vec![0; self.robots]; steps], Vec::new());
        for (robot, sent) in &log.sent {
            for (now, bytes) in sent.iter().filter(|(now, _)| *now >= began) {
                let step = (now.since(began).as_secs() / self.period_s()) as usize;
                if step < steps {
                    lengths[step][usize::from(*robot)] = *bytes;
                }
            }
        }
        for step in 0..steps {
            let now = began + Span::from_secs(self.period_s() * step as f64);
            let at = log.places.partition_point(|(time, _)| *time <= now);
            places.push(log.places[at.saturating_sub(1)].1.clone());
        }
        Traffic { lengths, places }
    }

    fn options(&self, environments: usize) -> Options {
        let robots = self.robots + usize::from(kind(self.mode) == Kind::MotorCommand);
        let radio = self.radio.clone().map(|radio| {
            let channel = self.medium().topology().expect("a radio");
            Radio { channel, ..radio }
        });
        Options {
            environments,
            robots,
            floats: 0,
            threads: 1,
            seed: 5,
            period_s: self.period_s(),
            spread_s: self.period_s(),
            hold_s: self.hold_ms as f64 / 1000.0,
            range_m: self.range_m,
            loss: self.loss,
            bursts: self.bursts,
            delay_s: [self.delay_s, self.delay_s + self.drawn_s],
            tail_s: 0.0,
            radio,
        }
    }

    /// Sends the same messages through the air, and returns what its robots hold.
    fn through_air(&self, runs: &[Traffic]) -> Held {
        let options = self.options(COPIES * runs.len());
        options.check().expect("the options are sound");
        let (environments, robots) = (options.environments, options.robots);
        let to_world = robots > self.robots;
        let mut air = Air::new(options);
        let edges = environments * robots * robots;
        let (mut heard, mut age_s, mut index) = (vec![false; edges], vec![0.0; edges], vec![-1; edges]);
        let mut held = Held::default();
        let to = vec![if to_world { self.robots as i32 } else { -1 }; environments * robots];
        for step in 0..self.steps(WARM_S + COUNTED_S) {
            let (mut bytes, mut position) = (Vec::new(), Vec::new());
            for environment in 0..environments {
                let run = &runs[environment / COPIES];
                bytes.extend(run.lengths[step].iter().copied().chain(to_world.then_some(0)));
                let places = run.places[step].iter().copied().chain(to_world.then_some(Vec2::zeros()));
                position.extend(places.flat_map(|at| [at.x, at.y]));
            }
            let sends: Vec<bool> = bytes.iter().map(|&bytes| bytes > 0).collect();
            let given = Given { position: &position, sends: &sends, bytes: &bytes, to: &to, content: &[] };
            air.step(given, Buffers { heard: &mut heard, age_s: &mut age_s, index: &mut index, content: &mut [] });
            if step >= self.steps(WARM_S) {
                for edge in 0..edges {
                    let (receiver, sender) = (edge / robots % robots, edge % robots);
                    if receiver != sender && (!to_world || receiver == self.robots) {
                        held.looks += 1;
                        held.ages_s.extend(heard[edge].then_some(f64::from(age_s[edge])));
                    }
                }
            }
        }
        held
    }
}

impl Log {
    fn note(&mut self, (now, host): (Time, HostId), event: &Event, (kind, mine, robots): (Kind, &BTreeSet<u16>, u16)) {
        match event {
            Event::Sent(link, frame) if mine.contains(&link.0) && codec::first(frame) == Ok(Content::Message(kind)) => {
                let header = codec::peek(frame).expect("it was encoded here");
                self.sent.entry(host.0).or_default().push((now, frame.len() as u32));
                self.times.insert((host, header.sequence), now);
            }
            Event::Arrived(link, frame)
                if mine.contains(&link.0) && codec::first(frame) == Ok(Content::Message(kind)) =>
            {
                let header = codec::peek(frame).expect("it was encoded here");
                let sent = self.times[&(header.sender, header.sequence)];
                self.arrivals.entry((host, header.sender)).or_default().insert(now, sent);
            }
            Event::Perceived(robot, heard) if kind == Kind::Latent => {
                let heard = heard.iter().map(|(other, age)| {
                    let arrived = Time::ZERO + Span::from_nanos(now.since(Time::ZERO).as_nanos() - age.as_nanos());
                    (HostId(other.0), arrived)
                });
                self.looks.push(Look { at: now, receiver: HostId(robot.0), held: heard.collect() });
            }
            Event::Truth(truth) => {
                self.places.push((now, truth.samples.iter().map(|sample| sample.motion.position).collect()));
                if kind == Kind::MotorCommand {
                    let newest = |sender: u16| {
                        let arrivals = self.arrivals.get(&(HostId(robots), HostId(sender)))?;
                        arrivals.keys().next_back().map(|arrived| (HostId(sender), *arrived))
                    };
                    let held = (0..robots).filter_map(newest).collect();
                    self.looks.push(Look { at: now, receiver: HostId(robots), held });
                }
            }
            _ => {}
        }
    }
}

/// Returns times in which the whole link loses everything, as they are for each edge of the air.
fn bursts_of(bursts: Bursts, period_s: f64, fault: LinkFault, stream: &mut Stream) -> Vec<LinkFault> {
    let end = period_s / bursts.mean_s;
    let begin = end * bursts.share / (1.0 - bursts.share);
    let (mut bad, mut faults) = (stream.random_bool(bursts.share), Vec::new());
    for step in 0..200_u64 {
        let at = |step: u64| Time::ZERO + Span::from_secs(period_s * step as f64);
        if bad {
            faults.push(LinkFault { from: at(step), until: at(step + 1), ..fault.clone() });
        }
        bad = if bad { !stream.random_bool(end) } else { stream.random_bool(begin) };
    }
    faults
}

#[test]
fn ages_and_shares_of_the_air_are_those_of_runs_of_the_actors() {
    let full = std::env::var_os("MURMURATE_CHANNEL_RUNS").is_some();
    for setting in settings() {
        let runs = if full { setting.runs } else { 40 };
        let mut held = Held::default();
        let traffic: Vec<Traffic> = (0..runs).map(|run| setting.run(run as u64, &mut held)).collect();
        let mut through = setting.through_air(&traffic);
        let (distance, shares) = (held.distance(&mut through), [held.share(), through.share()]);
        println!(
            "{:32} {:2} robots, {runs} runs, {} ages: distance {distance:.4}, shares {:.4} and {:.4}",
            setting.name,
            setting.robots,
            held.ages_s.len(),
            shares[0],
            shares[1]
        );
        // Ages of a run depend on each other, by its phases and bursts: a run of few robots says little.
        let chance = if full { 0.0 } else { 1.6 / ((runs * setting.robots) as f64).sqrt() };
        assert!(distance <= BAR + chance, "{}: {distance}", setting.name);
        assert!((shares[0] - shares[1]).abs() <= BAR + chance, "{}: {shares:?}", setting.name);
    }
}
