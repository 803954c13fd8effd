//! Pair of DDS processes, child processes of a host that connect it to ROS 2: an active one and a running spare. The
//! pair does no I/O: it decides on actions, which the supervisor carries out.
//!
//! The spare has discovered the robots and publishes nothing. It takes over at once when the active process ends, is
//! halted, uses too much memory, or no longer receives what the spare receives. The former active process is then
//! killed and replaced, with backoff.

use murmurate::time::{Span, Time};

use super::packet::{self, Drive, FromNode, Plan, Role, ToNode, Vitals};

/// Number of a DDS process of a pair (an active process and a spare); every process that is started gets a new number.
pub type Id = u32;

/// Packet between a host and a DDS process, as one line of JSON.
pub type Line = Box<[u8]>;

/// Period of the heartbeats that a host and its DDS processes send to each other.
pub const BEAT: Span = Span::from_millis(50);
/// Time without a line from a DDS process after which the process counts as halted: three periods of its heartbeats.
pub const SILENCE: Span = Span::from_millis(150);
/// Time without a line from a DDS process after which it counts as halted if the other process of the pair is not
/// alive. It is longer than `SILENCE`, because a busy machine delays both, and a restart takes a second.
const SILENCE_ALONE: Span = Span::from_millis(600);
/// Time after its start in which a DDS process must send its first line; otherwise it is replaced. A busy machine with
/// two cores takes 0.3 s.
const START: Span = Span::from_millis(5000);
/// Gap between two ticks that shows that the supervisor's own process was halted; the silence of DDS processes is then
/// ignored.
const OWN_HALT: Span = Span::from_millis(250);
/// Time for which the spare DDS process has to be better connected than the active one before it takes over.
const WORSE: Span = Span::from_millis(1000);
/// Largest age of a topic's last message at which a DDS process counts as receiving the topic. A spare reports at most
/// five messages a second of each topic.
const HEARD_NOW: Span = Span::from_millis(450);
/// First time without a connection to robots, in both DDS processes, after which the spare is replaced: forged packets
/// can stop DDS from receiving for good.
const DEAF: Span = Span::from_millis(3000);
/// Longest time without a connection to robots after which the spare DDS process is replaced. The time begins with
/// `DEAF` and doubles at each replacement while there is no connection, as when the robots are off.
const DEAF_MOST: Span = Span::from_millis(24_000);
/// First and longest delay between the end of a DDS process and its restart. The delay doubles each time that a process
/// ends within `LIVED` of its start.
const BACKOFF: [Span; 2] = [Span::from_millis(100), Span::from_millis(2000)];
/// Lifetime of a DDS process from which on it is restarted without delay when it ends.
const LIVED: Span = Span::from_millis(10_000);

/// Input of a pair of DDS processes, the active one and its spare.
#[derive(Clone, Copy, Debug)]
pub enum Input<'a> {
    /// The DDS process with this number has written this line.
    Line(Id, &'a [u8]),
    /// The DDS process with this number has ended.
    Ended(Id),
    /// The host's driver or source has sent this packet, which is for the active DDS process.
    Packet(&'a [u8]),
}

/// Output of a pair of DDS processes, which the supervisor carries out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// Start a new DDS process, which gets this number.
    Start(Id),
    /// Kill the DDS process with this number.
    Kill(Id),
    /// Write a line to the input of the DDS process with this number.
    Send(Id, Line),
    /// Pass on to the host's driver or source a line that the active DDS process has written.
    Pass(Line),
}

/// State machine for the DDS processes of a host, which connect it to ROS 2: an active process and a running spare that
/// takes over at once if the active one fails. It may be set to have no spare.
#[derive(Debug)]
pub struct Pair {
    plan: Plan,
    slots: Vec<Slot>,
    /// Index of the slot whose process is active.
    active: usize,
    /// Newest command of each published topic, with its expiry; `None` before the first.
    newest: Vec<Option<(Time, Drive)>>,
    beat_at: Time,
    ticked: Time,
    next: Id,
    /// Time since which the spare is better connected than the active process; `None` if it is not.
    worse: Option<Time>,
    /// Last time at which any of the processes was connected to robots.
    linked: Time,
    /// Time without a connection to robots after which the spare is replaced.
    patience: Span,
}

/// One of the two places of a [`Pair`] for a DDS process, whose ended process is replaced by a new one.
#[derive(Debug, Default)]
struct Slot {
    process: Option<Process>,
    start_at: Time,
    quick_ends: u32,
}

/// Running DDS process of a [`Slot`]: when it sent its last line and received its last messages.
#[derive(Debug)]
struct Process {
    id: Id,
    started: Time,
    /// Time of the last line from the process; `None` while it starts.
    heard: Option<Time>,
    vitals: Vitals,
    /// Time of the last received message of each subscribed topic; `None` before the first.
    topics: Vec<Option<Time>>,
}

impl Process {
    fn is_live(&self, now: Time) -> bool {
        self.heard.is_some_and(|heard| now.since(heard) <= SILENCE)
    }

    fn receives(&self, now: Time, topic: usize) -> bool {
        self.topics[topic].is_some_and(|at| now.since(at) <= HEARD_NOW)
    }
}

impl Pair {
    /// Creates the state machine; the first call of [`Pair::tick`] starts the DDS processes. `plan` lists their topics.
    /// With `spare`, a second process runs beside the active one and takes over if that fails.
    pub fn new(now: Time, plan: Plan, spare: bool) -> Pair {
        let slots = if spare { vec![Slot::default(), Slot::default()] } else { vec![Slot::default()] };
        let newest = vec![None; plan.writers.len()];
        Pair {
            plan,
            slots,
            active: 0,
            newest,
            beat_at: now,
            ticked: now,
            next: 0,
            worse: None,
            linked: now,
            patience: DEAF,
        }
    }

    /// Returns the number of the active DDS process; `None` if no active process runs.
    pub fn active(&self) -> Option<Id> {
        self.slots[self.active].process.as_ref().map(|process| process.id)
    }

    /// Handles an event of the DDS processes, the driver or the source, and appends actions to `out`. The caller must
    /// call [`Pair::tick`] afterwards.
    pub fn handle(&mut self, now: Time, event: Input, out: &mut Vec<Action>) {
        match event {
            Input::Line(id, line) => self.received(now, id, line, out),
            Input::Ended(id) => {
                if let Some(index) = self.index(id) {
                    self.end(now, index, out);
                }
            }
            Input::Packet(line) => {
                if let Ok(ToNode::Drive(drive)) = packet::decode_to_node(line)
                    && let Some(newest) = self.newest.get_mut(usize::from(drive.topic))
                {
                    *newest = Some((now + Span::from_millis(u64::from(drive.for_ms)), drive));
                }
                if let Some(id) = self.active() {
                    out.push(Action::Send(id, line.into()));
                }
            }
        }
    }

    /// Starts missing DDS processes, replaces failed ones, lets the spare take over if necessary and sends heartbeats,
    /// by actions that it appends to `out`. The caller must call it after each event, and no later than
    /// [`Pair::wake_at`].
    pub fn tick(&mut self, now: Time, out: &mut Vec<Action>) {
        if now.since(self.ticked) > OWN_HALT {
            for process in self.slots.iter_mut().filter_map(|slot| slot.process.as_mut()) {
                process.heard = process.heard.map(|_| now);
                process.started = now;
            }
            self.linked = now;
        }
        self.ticked = now;
        self.judge(now, out);
        self.elect(now, out);
        self.start(now, out);
        if now >= self.beat_at {
            self.beat_at = now + BEAT;
            self.replace_deaf(now, out);
            for (index, slot) in self.slots.iter().enumerate() {
                let role = if index == self.active { Role::Active } else { Role::Spare };
                if let Some(process) = &slot.process {
                    out.push(Action::Send(process.id, packet::encode(&ToNode::Beat(role)).into()));
                }
            }
        }
    }

    /// Returns the time at which [`Pair::tick`] has to be called next.
    pub fn wake_at(&self) -> Time {
        let due = |slot: &Slot| match &slot.process {
            None => Some(slot.start_at),
            Some(process) => process.heard.map(|heard| heard + SILENCE + Span::from_nanos(1)),
        };
        let dues = self.slots.iter().filter_map(due).filter(|due| *due > self.ticked);
        dues.fold(self.beat_at, Time::min)
    }

    fn index(&self, id: Id) -> Option<usize> {
        self.slots.iter().position(|slot| slot.process.as_ref().is_some_and(|process| process.id == id))
    }

    fn received(&mut self, now: Time, id: Id, line: &[u8], out: &mut Vec<Action>) {
        let Some(index) = self.index(id) else { return };
        let Some(process) = &mut self.slots[index].process else { return };
        process.heard = Some(now);
        let pass = match packet::decode_from_node(line) {
            Ok(FromNode::Beat(vitals)) => {
                process.vitals = vitals;
                false
            }
            Ok(FromNode::Received(heard)) => {
                if let Some(topic) = process.topics.get_mut(usize::from(heard.topic)) {
                    *topic = Some(now);
                }
                true
            }
            // The driver or source counts and refuses what is not understood.
            Ok(FromNode::Topic(_)) | Err(_) => true,
        };
        if pass && index == self.active {
            out.push(Action::Pass(line.into()));
        }
    }

    /// Kills DDS processes that are halted, or use too much memory while the other process is connected and uses less,
    /// and schedules their restart.
    fn judge(&mut self, now: Time, out: &mut Vec<Action>) {
        for index in 0..self.slots.len() {
            let Some(process) = &self.slots[index].process else { continue };
            let other = self.other(index).filter(|other| other.is_live(now));
            let silence = now.since(process.heard.unwrap_or(process.started));
            let patience = match (process.heard, other) {
                (None, _) => START,
                (Some(_), Some(_)) => SILENCE,
                (Some(_), None) => SILENCE_ALONE,
            };
            let size = process.vitals.resident_mib;
            let halted = silence > patience;
            let relief = other.is_some_and(|other| other.vitals.resident_mib < size && self.is_linked(now, other));
            let large = size > self.plan.memory_mib / 2 && relief;
            if halted || large {
                let name = &self.plan.name;
                if halted {
                    tracing::warn!("{name}: a DDS process is silent for {silence} and is replaced");
                } else {
                    tracing::warn!(
                        "{name}: a DDS process takes {size} MiB and is replaced; see who sends on its ports"
                    );
                }
                out.push(Action::Kill(process.id));
                self.end(now, index, out);
            }
        }
    }

    fn other(&self, index: usize) -> Option<&Process> {
        self.slots.iter().enumerate().find(|(other, _)| *other != index)?.1.process.as_ref()
    }

    /// Removes the process at this index, which has ended or is killed, schedules its restart, and lets the spare take
    /// over if necessary.
    fn end(&mut self, now: Time, index: usize, out: &mut Vec<Action>) {
        let slot = &mut self.slots[index];
        let Some(process) = slot.process.take() else { return };
        slot.quick_ends = if now.since(process.started) < LIVED { (slot.quick_ends + 1).min(16) } else { 0 };
        let doubled = BACKOFF[0] * (1 << slot.quick_ends.saturating_sub(1));
        slot.start_at = if slot.quick_ends == 0 { now } else { now + doubled.min(BACKOFF[1]) };
        self.elect(now, out);
    }

    /// Makes the spare process active if it is live and the active one is not.
    fn elect(&mut self, now: Time, out: &mut Vec<Action>) {
        let live = |slot: &Slot| slot.process.as_ref().is_some_and(|process| process.is_live(now));
        if live(&self.slots[self.active]) {
            return;
        }
        if let Some(index) = self.slots.iter().position(live) {
            self.take_over(now, index, out);
        }
    }

    /// Makes the process at this index active, and sends it the newest command of each topic, with zero velocity if the
    /// command has expired.
    fn take_over(&mut self, now: Time, index: usize, out: &mut Vec<Action>) {
        self.active = index;
        self.worse = None;
        let Some(id) = self.active() else { return };
        out.push(Action::Send(id, packet::encode(&ToNode::Beat(Role::Active)).into()));
        for (until, drive) in self.newest.iter().flatten() {
            let left = until.since(now).as_nanos() / 1_000_000;
            let stand = Drive { x: 0.0, y: 0.0, yaw: 0.0, for_ms: 0, ..*drive };
            let drive = match u32::try_from(left) {
                Ok(for_ms) if for_ms > 0 => Drive { for_ms, ..*drive },
                _ => stand,
            };
            out.push(Action::Send(id, packet::encode(&ToNode::Drive(drive)).into()));
        }
    }

    fn start(&mut self, now: Time, out: &mut Vec<Action>) {
        for slot in &mut self.slots {
            if slot.process.is_some() || slot.start_at > now {
                continue;
            }
            let id = self.next;
            self.next += 1;
            let vitals = Vitals { resident_mib: 0, matched: false };
            let topics = vec![None; self.plan.readers.len()];
            slot.process = Some(Process { id, started: now, heard: None, vitals, topics });
            out.push(Action::Start(id));
            out.push(Action::Send(id, packet::encode(&ToNode::Open(self.plan.clone())).into()));
        }
    }

    /// Lets the spare take over if it has been better connected for the time `WORSE`. Replaces the spare if no process
    /// has been connected to robots for the time `patience`.
    fn replace_deaf(&mut self, now: Time, out: &mut Vec<Action>) {
        if self.slots.iter().filter_map(|slot| slot.process.as_ref()).any(|process| self.is_linked(now, process)) {
            (self.linked, self.patience) = (now, DEAF);
        }
        let spare = if self.slots.len() == 2 { 1 - self.active } else { self.active };
        if self.is_worse(now) {
            let since = *self.worse.get_or_insert(now);
            if now.since(since) > WORSE {
                tracing::warn!("{}: the spare DDS process hears more, and takes over", self.plan.name);
                let worse = self.active;
                self.take_over(now, spare, out);
                self.kill(now, worse, out);
            }
            return;
        }
        self.worse = None;
        let old = self.slots[spare].process.as_ref().is_some_and(|process| now.since(process.started) > self.patience);
        if old && now.since(self.linked) > self.patience {
            self.patience = (self.patience * 2).min(DEAF_MOST);
            self.kill(now, spare, out);
        }
    }

    fn kill(&mut self, now: Time, index: usize, out: &mut Vec<Action>) {
        out.extend(self.slots[index].process.as_ref().map(|process| Action::Kill(process.id)));
        self.end(now, index, out);
        self.slots[index].start_at = now;
    }

    /// Whether a process is connected to robots: it currently receives at least one of its subscribed topics, if it has
    /// any, and each of its command topics, if it has any, has a subscriber.
    fn is_linked(&self, now: Time, process: &Process) -> bool {
        let commands = self.plan.writers.iter().any(|writer| writer.kind.is_command());
        let hears = process.topics.is_empty() || (0..process.topics.len()).any(|topic| process.receives(now, topic));
        hears && (!commands || process.vitals.matched)
    }

    /// Whether the spare is better connected than the active process: it receives a topic that the active process does
    /// not receive, or only its command topics all have subscribers.
    fn is_worse(&self, now: Time) -> bool {
        let Some(active) = &self.slots[self.active].process else { return false };
        let Some(spare) = self.other(self.active).filter(|spare| spare.is_live(now)) else { return false };
        let deaf = |topic| !active.receives(now, topic) && spare.receives(now, topic);
        (0..active.topics.len()).any(deaf) || (spare.vitals.matched && !active.vitals.matched)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::packet::{Publication, Read, ReceivedMessage, Sample, Subscription, Written};

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    fn plan() -> Plan {
        Plan {
            name: "robot 1".to_owned(),
            domain: 0,
            interface: None,
            memory_mib: 200,
            writers: vec![Publication { topic: "/r1/cmd_vel".to_owned(), kind: Written::Twist }],
            readers: vec![Subscription { topic: "/r1/odom".to_owned(), kind: Read::Odometry }],
        }
    }

    /// Pair with processes that answer, on a clock of 10 ms.
    struct Bench {
        pair: Pair,
        ms: u64,
        /// Living processes: number, memory, whether it hears.
        alive: Vec<(Id, u32, bool)>,
        halted: Vec<Id>,
        /// Commands that the processes got: time, process, forward speed.
        driven: Vec<(u64, Id, f64)>,
        passed: usize,
    }

    impl Bench {
        fn new(spare: bool) -> Bench {
            let pair = Pair::new(Time::ZERO, plan(), spare);
            Bench { pair, ms: 0, alive: vec![], halted: vec![], driven: vec![], passed: 0 }
        }

        fn event(&mut self, event: Input) {
            let mut out = Vec::new();
            self.pair.handle(at_ms(self.ms), event, &mut out);
            self.pair.tick(at_ms(self.ms), &mut out);
            self.apply(out);
        }

        fn apply(&mut self, actions: Vec<Action>) {
            for action in actions {
                match action {
                    Action::Start(id) => self.alive.push((id, 12, true)),
                    Action::Kill(id) => self.alive.retain(|(other, ..)| *other != id),
                    Action::Send(id, line) => {
                        if let Ok(ToNode::Drive(drive)) = packet::decode_to_node(&line) {
                            self.driven.push((self.ms, id, drive.x));
                        }
                    }
                    Action::Pass(_) => self.passed += 1,
                }
            }
        }

        /// Runs for some time; each process beats every 50 ms and hears odometry.
        fn run(&mut self, ms: u64) {
            for _ in 0..ms / 10 {
                self.ms += 10;
                for (id, resident_mib, hears) in self.alive.clone() {
                    if self.halted.contains(&id) || !self.ms.is_multiple_of(50) {
                        continue;
                    }
                    let beat = FromNode::Beat(Vitals { resident_mib, matched: true });
                    self.event(Input::Line(id, &packet::encode(&beat)));
                    if hears {
                        let heard =
                            FromNode::Received(ReceivedMessage { topic: 0, sample: Sample::Pose(Default::default()) });
                        self.event(Input::Line(id, &packet::encode(&heard)));
                    }
                }
                let mut out = Vec::new();
                self.pair.tick(at_ms(self.ms), &mut out);
                self.apply(out);
            }
        }

        fn command(&mut self, x: f64) {
            let drive = ToNode::Drive(Drive { topic: 0, x, y: 0.0, yaw: 0.0, for_ms: 200 });
            self.event(Input::Packet(&packet::encode(&drive)));
        }
    }

    #[test]
    fn a_halted_process_is_relieved_by_the_spare_with_the_newest_command() {
        let mut bench = Bench::new(true);
        bench.run(2000);
        bench.command(0.3);
        assert_eq!(bench.driven, [(2000, 0, 0.3)]);
        bench.halted.push(0);
        bench.run(150);
        assert_eq!(bench.driven[1..], []);
        bench.run(20);
        assert_eq!(bench.driven[1..], [(2160, 1, 0.3)]);
        bench.command(0.2);
        assert_eq!(bench.driven[2], (2170, 1, 0.2));
        bench.run(500);
        assert_eq!(bench.alive.iter().map(|(id, ..)| *id).collect::<Vec<_>>(), [1, 2], "the halted one is replaced");
    }

    #[test]
    fn after_an_end_the_spare_stands_if_the_command_has_lapsed() {
        let mut bench = Bench::new(true);
        bench.run(1000);
        bench.command(0.3);
        bench.run(250);
        bench.alive.remove(0);
        bench.event(Input::Ended(0));
        assert_eq!(bench.driven[1..], [(1250, 1, 0.0)]);
    }

    #[test]
    fn quick_ends_are_followed_by_ever_later_starts() {
        let mut bench = Bench::new(false);
        let mut starts = Vec::new();
        for _ in 0..12_000 {
            bench.run(10);
            if let Some((id, ..)) = bench.alive.pop() {
                starts.push(bench.ms);
                bench.event(Input::Ended(id));
            }
        }
        let gaps: Vec<u64> = starts.windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert_eq!(gaps[..7], [100, 200, 400, 800, 1600, 2000, 2000]);
    }

    #[test]
    fn a_large_process_is_replaced_while_the_other_is_small() {
        let mut bench = Bench::new(true);
        bench.run(1000);
        bench.alive[0].1 = 150;
        bench.run(200);
        assert_eq!(bench.pair.active(), Some(1));
        assert_eq!(bench.alive.iter().map(|(id, ..)| *id).collect::<Vec<_>>(), [1, 2]);
        bench.alive[1].2 = false;
        bench.run(500);
        bench.alive[0].1 = 150;
        bench.run(1000);
        assert_eq!(bench.pair.active(), Some(1), "none that hears nothing takes over");
    }

    #[test]
    fn a_spare_that_hears_more_takes_over_and_a_deaf_pair_gets_a_new_spare() {
        let mut bench = Bench::new(true);
        bench.run(1000);
        bench.alive[0].2 = false;
        bench.run(2000);
        assert_eq!((bench.pair.active(), bench.alive.len()), (Some(1), 2));
        bench.alive.iter_mut().for_each(|process| process.2 = false);
        // A new process hears.
        bench.run(6000);
        assert!(bench.pair.active() > Some(2), "{:?}", bench.pair.active());
        let active = bench.pair.active();
        bench.run(20_000);
        assert_eq!(bench.pair.active(), active, "no change without need");
    }

    #[test]
    fn a_host_that_was_halted_itself_kills_no_process() {
        let mut bench = Bench::new(true);
        bench.run(1000);
        bench.ms += 5000;
        bench.run(1000);
        assert_eq!(bench.alive.iter().map(|(id, ..)| *id).collect::<Vec<_>>(), [0, 1]);
        assert!(bench.passed > 30);
    }

    #[test]
    fn lines_of_the_spare_are_not_passed_on() {
        let mut bench = Bench::new(true);
        bench.run(1000);
        let spare = 1 - bench.pair.active().unwrap();
        let before = bench.passed;
        let heard = FromNode::Received(ReceivedMessage { topic: 0, sample: Sample::Pose(Default::default()) });
        bench.event(Input::Line(spare, &packet::encode(&heard)));
        bench.event(Input::Line(99, &packet::encode(&heard)));
        bench.event(Input::Line(1 - spare, b"not a packet"));
        assert_eq!(bench.passed, before + 1, "what is not understood is refused further on");
    }
}
