//! Messages of one environment on their way: what its robots have sent, and what each of them holds.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::{Buffers, Given, Options};
use murmurate::messages::geometry::Vec2;
use murmurate::net::media::radio::{Channel, Delivery, Destination};
use murmurate::random::{self, Rng, RngExt, Seed, Stream};
use murmurate::time::{Span, Time};

/// Message between two robots on its way, sent in the step `step` and due at `at`.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Flight {
    at: Time,
    /// Index of receiver and sender in the buffers of an environment.
    edge: u32,
    step: i32,
}

/// Air of one environment. Its time begins at its reset.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Row {
    #[serde(with = "random::stored")]
    stream: Stream,
    /// Number of steps since the reset.
    steps: i32,
    /// When each robot sends, from the beginning of a step.
    phases: Vec<Span>,
    /// Robots in the order in which they send.
    order: Vec<u16>,
    /// Number of the step in which the newest message was sent that the receiver has of the sender; -1 for none. By
    /// receiver and then by sender.
    newest: Vec<i32>,
    /// When that message has arrived; the beginning for none.
    arrived: Vec<Time>,
    /// Whether the time is a bad one, by receiver and then by sender; empty without bursts.
    bad: Vec<bool>,
    flights: Vec<Flight>,
    /// Radio channel of the robots, whose frames carry the number of the step in which they were sent.
    radio: Option<Channel<i32>>,
    /// Floats of the messages of the newest steps, by step modulo their number and then by robot.
    contents: Vec<f32>,
}

impl Row {
    /// Returns the air of an environment with a random stream of its own.
    pub(super) fn new(options: &Options, stream: Stream) -> Row {
        let robots = options.robots;
        let mut row = Row {
            stream,
            steps: 0,
            phases: vec![Span::ZERO; robots],
            order: (0..robots as u16).collect(),
            newest: vec![-1; robots * robots],
            arrived: vec![Time::ZERO; robots * robots],
            bad: vec![false; if options.bursts.is_some() { robots * robots } else { 0 }],
            flights: Vec::new(),
            radio: None,
            contents: vec![0.0; options.memory() * robots * options.floats],
        };
        row.reset(options);
        row
    }

    /// Returns whether this is the air of an environment with these options, as one that was stored may not be.
    pub(super) fn fits(&self, options: &Options) -> bool {
        let (robots, edges) = (options.robots, options.robots * options.robots);
        let Row { phases, order, newest, arrived, bad: times, contents, .. } = self;
        let lengths = [phases.len(), order.len(), newest.len(), arrived.len(), times.len(), contents.len()];
        let bad = if options.bursts.is_some() { edges } else { 0 };
        let known = |flight: &Flight| (flight.edge as usize) < edges && (0..self.steps).contains(&flight.step);
        lengths == [robots, robots, edges, edges, bad, options.memory() * robots * options.floats]
            && self.order.iter().all(|robot| usize::from(*robot) < robots)
            && self.newest.iter().all(|step| (-1..self.steps).contains(step))
            && self.flights.iter().all(known)
            && self.radio.is_some() == options.radio.is_some()
    }

    /// Begins the environment anew: nothing was said.
    pub(super) fn reset(&mut self, options: &Options) {
        self.steps = 0;
        self.newest.fill(-1);
        self.flights.clear();
        if options.spread_s > 0.0 {
            for phase in &mut self.phases {
                *phase = Span::from_secs(self.stream.random_range(0.0..options.spread_s));
            }
            let phases = &self.phases;
            self.order.sort_by_key(|robot| (phases[usize::from(*robot)], *robot));
        }
        if let Some(bursts) = options.bursts {
            self.bad.iter_mut().for_each(|bad| *bad = self.stream.random_bool(bursts.share));
        }
        if let Some(radio) = &options.radio {
            let mut bytes = [0; 32];
            self.stream.fill_bytes(&mut bytes);
            self.radio = Some(Channel::new(radio.clone(), options.robots as u16, &Seed::of_bytes(bytes)));
        }
    }

    /// Sends what the robots of the environment say in this step, and goes to its end.
    pub(super) fn step(&mut self, options: &Options, given: Given) {
        let (robots, begin) = (options.robots, Time::ZERO + options.period() * self.steps as u64);
        let end = begin + options.period();
        if let Some(bursts) = options.bursts {
            let [begins, ends] = bursts.turns(options.period_s);
            for bad in &mut self.bad {
                *bad = if *bad { !self.stream.random_bool(ends) } else { self.stream.random_bool(begins) };
            }
        }
        let kept = robots * options.floats;
        let at = self.steps as usize % options.memory() * kept;
        self.contents[at..at + kept].copy_from_slice(given.content);
        match self.radio.take() {
            Some(mut radio) => {
                self.send_by_radio(options, given, (&mut radio, begin, end));
                self.radio = Some(radio);
            }
            None => self.send(options, given, begin),
        }
        let (newest, arrived) = (&mut self.newest, &mut self.arrived);
        self.flights.retain(|flight| {
            let edge = flight.edge as usize;
            // What comes after a newer message is refused, as by robots.
            if flight.at <= end && flight.step > newest[edge] {
                (newest[edge], arrived[edge]) = (flight.step, flight.at);
            }
            flight.at > end
        });
        self.steps += 1;
    }

    /// Sends messages, each of which takes its own way to each receiver.
    fn send(&mut self, options: &Options, given: Given, begin: Time) {
        for at in 0..self.order.len() {
            let sender = usize::from(self.order[at]);
            if !given.sends.is_empty() && !given.sends[sender] {
                continue;
            }
            let sent = begin + self.phases[sender];
            let to = given.to.get(sender).copied().unwrap_or(-1);
            let receivers = if to < 0 { 0..options.robots } else { to as usize..to as usize + 1 };
            for receiver in receivers.filter(|receiver| *receiver != sender) {
                self.pass(options, given, sent, (receiver, sender), self.steps);
            }
        }
    }

    /// Sends messages on the radio channel, and runs it up to the end of the step.
    fn send_by_radio(&mut self, options: &Options, given: Given, (radio, begin, end): (&mut Channel<i32>, Time, Time)) {
        let mut arrived: Vec<Delivery<i32>> = Vec::new();
        for (robot, at) in (0..).zip(given.position.chunks_exact(2)) {
            radio.place(robot, Vec2::new(at[0], at[1]));
        }
        let all: Arc<[u16]> = (0..options.robots as u16).collect();
        for sender in self.order.iter().map(|robot| usize::from(*robot)) {
            if !given.sends.is_empty() && !given.sends[sender] {
                continue;
            }
            let sent = begin + self.phases[sender];
            let to = match given.to.get(sender) {
                Some(&to) if to >= 0 => Destination::One(to as u16),
                _ => Destination::Many(Arc::clone(&all)),
            };
            let bytes = given.bytes.get(sender).unwrap_or(&given.bytes[0]);
            radio.wake(sent, &mut arrived);
            radio.offer(sent, sender as u16, to, *bytes as usize, self.steps);
        }
        radio.wake(end, &mut arrived);
        for Delivery { at, from, to, token } in arrived {
            self.pass(options, given, at, (to.into(), from.into()), token);
        }
    }

    /// Puts a message that is on its way from `sent` on among the flights, unless the receiver loses it. The positions
    /// are those of the present step.
    fn pass(&mut self, options: &Options, given: Given, sent: Time, (receiver, sender): (usize, usize), step: i32) {
        let edge = receiver * options.robots + sender;
        let place = |robot: usize| Vec2::new(given.position[2 * robot], given.position[2 * robot + 1]);
        let far = options.range_m.is_some_and(|range_m| (place(receiver) - place(sender)).norm() > range_m);
        let [least, most] = options.delay_s;
        // As many numbers are drawn for a message that is lost as for one that is not.
        let lost = options.loss > 0.0 && self.stream.random_bool(options.loss);
        let mut delay_s = if most > least { self.stream.random_range(least..most) } else { least };
        if options.tail_s > 0.0 {
            delay_s += options.tail_s * random::exponential(&mut self.stream);
        }
        if far || lost || self.bad.get(edge).copied().unwrap_or(false) {
            return;
        }
        self.flights.push(Flight { at: sent + Span::from_secs(delay_s), edge: edge as u32, step });
    }

    /// Writes what the robots of the environment hold.
    pub(super) fn look(&self, options: &Options, to: &mut Buffers) {
        let (robots, floats, memory) = (options.robots, options.floats, options.memory());
        let now = Time::ZERO + options.period() * self.steps as u64;
        for (edge, &step) in self.newest.iter().enumerate() {
            let sender = edge % robots;
            let sent = |step: i32| Time::ZERO + options.period() * step as u64 + self.phases[sender];
            // Half a nanosecond more than any rounding of spans.
            let fresh = step >= 0 && now.since(self.arrived[edge]).as_secs() <= options.hold_s + 1e-9;
            let heard = fresh && ((self.steps - step) as usize) <= memory;
            to.heard[edge] = heard;
            to.age_s[edge] = if heard { now.since(sent(step)).as_secs() as f32 } else { 0.0 };
            to.index[edge] = if heard { step } else { -1 };
            let content = &mut to.content[edge * floats..(edge + 1) * floats];
            if heard {
                let from = (step as usize % memory * robots + sender) * floats;
                content.copy_from_slice(&self.contents[from..from + floats]);
            } else {
                content.fill(0.0);
            }
        }
    }
}
