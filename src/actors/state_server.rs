//! StateServer: leads the team through its episodes without a person (paper, section IV).
//!
//! It receives heartbeats, and sends an instruction several times a second: reset, run or stop. It holds the team while
//! the emergency stop is engaged, then until a resume, and after a failed reset of real robots; it stops the team while
//! a host that announced its shutdown is away. A restarted server aborts a running episode, and goes on with the next.

use super::absent::{Absent, Members};
use super::lost::Lost;
use super::presence::Presence;
use crate::actor::Core;
use crate::messages::geometry::Task;
use crate::messages::ids::{HostId, RobotId};
use crate::messages::latch::Latch;
use crate::messages::wire::{Heartbeat, Hindrance, Leading, Located, Marks, Mode, Phase, Release, Round, Status, Stop};
use crate::results::episode::{AbortCause, AbortReason};
use crate::scenario::cost::Ending;
use crate::scenario::layout::Layouts;
use crate::time::{Span, Time};
use crate::world::Placement;

/// Period at which the state server decides whether to enter another phase: one step of a World.
pub const TICK: Span = Span::from_millis(50);
/// Period at which an unchanged instruction is repeated, with the tasks of one block of robots in turn.
pub const MODE_PERIOD: Span = Span::from_millis(100);
/// Number of times that a new instruction is sent with the tasks of all robots, in case copies are lost.
pub const NEW_MODE_REPEATS: u32 = 3;
/// Number of instructions after which the newest signed re-arm or resume is repeated: once a second.
const RELEASE_EVERY: u32 = 10;
/// Longest wait for missing robots at the start and after an aborted episode; then the team continues without them.
pub const MUSTER_LIMIT: Span = Span::from_millis(10_000);
/// Longest duration of a reset; after it, the reset has failed.
pub const RESET_LIMIT: Span = Span::from_millis(60_000);
/// Time by which an episode may exceed its longest duration before it is aborted: heartbeats may be late.
pub const GRACE: Span = Span::from_millis(500);

/// Input message of a state server, the actor that leads the episodes of a team.
#[derive(Clone, Debug)]
pub enum In {
    /// Heartbeat of a robot: its round, its phase of the episode, and the emergency stop latch that it follows.
    Heartbeat(Heartbeat),
    /// Emergency stop message: engage, re-arm or resume.
    Stop(Stop),
    /// Re-arm or resume with the signature of an operator, which was checked.
    Release(Release),
    /// Status report of a host, which says whether the host shuts down or is present.
    Status(Status),
    /// Members of the roster in force, once a second; not those of the key files.
    Members(Members),
    /// Robots whose poses are unknown, or known again, from a host that measures them.
    Located(Located),
    /// The host of the state server is shutting down; the team is told to wait.
    Leave,
}

/// Output message of a state server, the actor that leads the episodes of a team.
#[derive(Clone, Debug)]
pub enum Out {
    /// Instruction for the team: reset, run or stop, and the episode.
    Mode(Mode),
    /// Signed re-arm or resume that has led to the present emergency stop state, for robots that have missed it.
    Release(Release),
    /// Emergency stop state and robots that prevent a resume: answer to an operator, sent through the Status.
    Leading(Leading),
    /// The episode with this index, from 0, is aborted for this reason; said before the instruction. For reports only.
    Aborted(u32, AbortReason),
}

/// Configuration of a state server, the actor that leads the episodes of a team.
#[derive(Clone, Debug)]
pub struct Config {
    /// Starts and goals of all episodes of the trial, in order.
    pub layouts: Layouts,
    /// Index of this trial among the repeats of the experiment, from zero.
    pub repeat: u32,
    /// Whether robots are placed at their starts before an episode, or drive there.
    pub placement: Placement,
    /// Longest duration of an episode, after which it is aborted.
    pub limit: Span,
    /// Way in which an episode ends if it is not aborted.
    pub ending: Ending,
    /// Host of this server, in whose name a simulation gives orders.
    pub host: HostId,
    /// For each host, by its id: the robots whose Agents or Bodies it runs, or which it measures.
    pub hosts: Vec<Vec<RobotId>>,
    /// Robots that no World simulates, in ascending order of ids. They reach their starts only by driving or by hand.
    pub real: Vec<RobotId>,
    /// Largest number of robots in one instruction.
    pub block: usize,
    /// Marks of this host; 0 in simulations.
    pub marks: Marks,
}

/// State server: the actor that decides when resets and episodes begin and end, and sends instructions to robots.
#[derive(Debug)]
pub struct StateServer {
    config: Config,
    presence: Presence,
    /// Number of this incarnation of the server; each later one begins with a higher term.
    incarnation: u32,
    /// Whether the server started its episodes without a heartbeat.
    started_unheard: bool,
    latch: Latch,
    /// Whether a stop, re-arm or resume has changed the latch since the server was started.
    ordered: bool,
    /// Newest signed re-arm or resume that has changed the latch.
    release: Option<Release>,
    absent: Absent,
    lost: Lost,
    /// Whether the server's own host is shutting down.
    leaves: bool,
    round: Round,
    phase: Phase,
    /// Reason of an aborted episode that was not reported yet, with the episode's index.
    aborted: Option<(u32, AbortReason)>,
    /// Time at which the present phase began; `None` before the first decision.
    since: Option<Time>,
    sent_at: Option<Time>,
    /// Number of times that the present instruction was sent, and the block of robots for the next repetition.
    times_sent: u32,
    turn: usize,
    next: Time,
}

impl StateServer {
    /// Creates a state server of `robots` robots. `incarnation` counts its starts within the process, from 1.
    pub fn new(config: Config, robots: usize, incarnation: u32) -> StateServer {
        StateServer {
            absent: Absent::new(config.hosts.clone()),
            presence: Presence::new(robots, config.marks),
            config,
            incarnation,
            started_unheard: false,
            latch: Latch::default(),
            ordered: false,
            release: None,
            lost: Lost::default(),
            leaves: false,
            round: Round::default(),
            phase: Phase::NeedReset,
            aborted: None,
            since: None,
            sent_at: None,
            times_sent: 0,
            turn: 0,
            next: Time::ZERO,
        }
    }

    fn enter(&mut self, now: Time, phase: Phase) {
        tracing::debug!(episode = self.round.episode, ?phase, "the team enters a phase");
        (self.phase, self.since, self.sent_at) = (phase, Some(now), None);
    }

    fn abort(&mut self, now: Time, reason: AbortReason) {
        self.aborted = Some((self.round.episode, reason));
        self.enter(now, Phase::AbortRunning);
    }

    fn begin(&mut self, now: Time, episode: u32) {
        self.round.episode = episode;
        let phase = match self.config.placement {
            _ if episode >= self.config.layouts.len() => Phase::EpisodesFinished,
            Placement::Exact => Phase::Running,
            Placement::Drive => Phase::Resetting,
        };
        self.enter(now, phase);
    }

    /// Takes the team's state from heartbeats: begins the first episode, or goes on where an earlier server stopped.
    fn take_up(&mut self, now: Time) {
        let beats: Vec<Heartbeat> = self.presence.present(now).cloned().collect();
        let last = self.presence.latest_round(now, self.round);
        let term = last.term.saturating_add(1).max(self.incarnation);
        self.round = Round { term, episode: last.episode.min(self.config.layouts.len()) };
        self.started_unheard = beats.is_empty();
        let waits = beats.iter().any(|beat| beat.round == last && beat.phase == Phase::Waiting);
        let is_running = |beat: &Heartbeat| {
            let phases = [Phase::Running, Phase::FinishedRunning, Phase::AbortRunning, Phase::NeedReset];
            beat.round == last && phases.contains(&beat.phase)
        };
        if beats.iter().any(|beat| beat.round == last && beat.phase == Phase::EpisodesFinished) {
            self.enter(now, Phase::EpisodesFinished);
        } else if waits {
            // An earlier incarnation waited for a host. Its id is unknown, so all robots must report this phase first.
            self.enter(now, Phase::Waiting);
        } else if last.term > 0 && beats.iter().any(is_running) {
            let number = last.episode + 1;
            tracing::warn!("episode {number} was running and is given up: the state server was restarted");
            self.abort(now, AbortReason::of_team(AbortCause::ServerRestarted));
        } else {
            self.begin(now, last.episode);
        }
    }

    /// Takes a later term if a robot follows a later round, because that robot would refuse all earlier ones.
    fn overtake(&mut self, now: Time) {
        let latest = self.presence.latest_round(now, self.round);
        if self.round.term == 0 || latest <= self.round {
            return;
        }
        if self.started_unheard {
            self.take_up(now);
        } else {
            self.round.term = latest.term.saturating_add(1);
            self.sent_at = None;
        }
    }

    /// Returns the robots that prevent a resume, each with the reason.
    fn hindrances(&self, now: Time) -> Vec<(RobotId, Hindrance)> {
        self.presence.hindrances(now, self.latch, |robot| self.absent.has(robot))
    }

    fn take_stop(&mut self, now: Time, stop: &Stop, out: &mut Vec<Out>) {
        let (hindrances, before) = (self.hindrances(now), self.latch);
        let commanded = stop.by.is_operator() || stop.by == self.config.host;
        match self.latch.resumed(stop.latch) {
            Some(clear) if hindrances.is_empty() && commanded => self.latched(clear),
            Some(_) => {}
            None => self.latched(self.latch.after(stop.latch, commanded)),
        }
        self.ordered |= self.latch != before;
        if stop.by.is_operator() {
            out.push(Out::Leading(Leading { latch: self.latch, hindrances }));
        }
    }

    /// Stops the team until all hosts that have left are back. Then the interrupted episode is repeated.
    fn wait(&mut self, now: Time) {
        match self.phase {
            Phase::EpisodesFinished => {}
            Phase::Resetting | Phase::Running | Phase::AbortRunning => self.enter(now, Phase::Waiting),
            _ => self.since = Some(now),
        }
    }

    /// Stops the team. The next episode begins once the latch is clear and the team is ready.
    fn hold(&mut self, now: Time) {
        match self.phase {
            // A hold between two episodes: the next one is reset anew after the resume, and none is lost.
            Phase::Resetting if self.latch.is_held() => self.enter(now, Phase::Waiting),
            Phase::Resetting | Phase::Running => self.abort(now, AbortReason::of_team(AbortCause::Stopped)),
            _ => self.since = Some(now),
        }
    }

    /// Sets the emergency stop latch. If it is new, the next instruction, which contains it, is sent without delay.
    fn latched(&mut self, latch: Latch) {
        if latch != self.latch {
            tracing::warn!(state = latch.word(), number = latch.number(), "emergency stop");
            (self.latch, self.sent_at) = (latch, None);
        }
    }

    /// Ends a reset that takes too long. Simulated robots are then placed at their next starts. A real robot may be
    /// stuck, so the team is held until a person resumes it.
    fn fail_reset(&mut self, now: Time) {
        let late = self.presence.late(now, self.round);
        let names: Vec<String> = late.iter().map(RobotId::to_string).collect();
        let (number, names) = (self.round.episode + 1, names.join(", "));
        tracing::warn!("the reset before episode {number} has failed: {names} not in place");
        if late.iter().any(|robot| self.config.real.binary_search(robot).is_ok()) {
            tracing::error!("the team is held: look after {names}, then run 'murmurate resume'");
            self.latched(Latch::held(self.latch.number() + 1));
        }
        let causes: Vec<(RobotId, AbortCause)> = late.iter().map(|robot| (*robot, AbortCause::NotInPlace)).collect();
        let reason = AbortReason::of_robots(&causes);
        self.abort(now, reason.unwrap_or(AbortReason::of_team(AbortCause::NotInPlace)));
    }

    /// Aborts the running episode because of these robots, each with its cause; there is at least one.
    fn give_up(&mut self, now: Time, causes: &[(RobotId, AbortCause)]) {
        let reason = AbortReason::of_robots(causes).expect("there is a robot");
        let each = |cause: &(RobotId, AbortCause)| AbortReason::of_robots(&[*cause]).map(|reason| reason.to_string());
        let words: Vec<String> = causes.iter().filter_map(each).collect();
        tracing::warn!("episode {} is aborted: {}", self.round.episode + 1, words.join(", "));
        self.abort(now, reason);
    }

    /// Enters the next phase of the team if heartbeats, the latch, absent hosts or time limits require one.
    fn decide(&mut self, now: Time) {
        if self.leaves {
            return self.wait(now);
        }
        self.latched(self.presence.latch(now, self.latch, self.round.term > 0 || self.ordered));
        self.overtake(now);
        if !self.latch.is_clear() {
            return self.hold(now);
        }
        if self.absent.any() && self.phase != Phase::NeedReset || self.presence.differs(now) {
            return self.wait(now);
        }
        let unknown = [self.lost.causes(now), self.absent.causes()].concat();
        if !unknown.is_empty() && self.phase != Phase::NeedReset {
            // The others could drive into a robot whose place, or whose intention, is unknown.
            return match self.phase {
                Phase::Running => self.give_up(now, &unknown),
                Phase::AbortRunning => self.since = Some(now),
                _ => self.wait(now),
            };
        }
        let since = *self.since.get_or_insert(now);
        let lasted = now.since(since);
        let all_are = |phase| self.presence.all_are(now, self.round, phase);
        let aborts =
            if self.phase == Phase::Running { self.presence.reasons_to_abort(now, self.round) } else { Vec::new() };
        match self.phase {
            Phase::NeedReset if self.presence.is_complete(now) || lasted >= MUSTER_LIMIT => {
                self.take_up(now);
                if self.absent.any() {
                    self.wait(now);
                }
            }
            Phase::Waiting if all_are(Phase::Waiting) => self.begin(now, self.round.episode),
            Phase::Waiting if lasted >= MUSTER_LIMIT => {
                self.since = Some(now);
                let missing =
                    self.presence.all(now).filter(|(_, beat)| beat.is_none_or(|beat| beat.phase != Phase::Waiting));
                let names: Vec<String> = missing.map(|(robot, _)| robot.to_string()).collect();
                tracing::warn!("the team stands and still waits for {}", names.join(", "));
            }
            Phase::Resetting if all_are(Phase::FinishedResetting) => self.enter(now, Phase::Running),
            Phase::Resetting if lasted >= RESET_LIMIT => self.fail_reset(now),
            Phase::Running if all_are(Phase::FinishedRunning) => self.begin(now, self.round.episode + 1),
            Phase::Running if !aborts.is_empty() => self.give_up(now, &aborts),
            Phase::Running if lasted > self.config.limit + GRACE => match self.config.ending {
                Ending::Arrival => self.abort(now, AbortReason::of_team(AbortCause::TimeLimit)),
                Ending::Time => self.begin(now, self.round.episode + 1),
            },
            Phase::AbortRunning if all_are(Phase::NeedReset) || lasted >= MUSTER_LIMIT => {
                self.begin(now, self.round.episode + 1);
            }
            _ => {}
        }
    }

    /// Sends the signed original of the present latch, if there is one, for robots that have missed it.
    fn send_release(&self, out: &mut Vec<Out>) {
        let due = self.times_sent < NEW_MODE_REPEATS || self.times_sent.is_multiple_of(RELEASE_EVERY);
        let release = self.release.as_ref().filter(|release| due && release.latch == self.latch);
        out.extend(release.cloned().map(Out::Release));
    }

    /// Sends the instruction: a new one with the tasks of all robots, a repeated one with those of one block of them.
    fn send_mode(&mut self, out: &mut Vec<Out>) {
        let last = self.config.layouts.len() - 1;
        let tasks = self.config.layouts.episode(self.round.episode.min(last));
        let (size, blocks) = (self.config.block, tasks.len().div_ceil(self.config.block));
        self.times_sent = if self.sent_at.is_none() { 1 } else { self.times_sent.saturating_add(1) };
        let turn = if self.times_sent <= NEW_MODE_REPEATS { 0..blocks } else { self.turn..self.turn + 1 };
        self.turn = turn.end % blocks;
        for (index, block) in tasks.chunks(size).enumerate().filter(|(index, _)| turn.contains(index)) {
            let first = u16::try_from(index * size).expect("a team has at most 65 535 robots");
            out.push(Out::Mode(Mode {
                round: self.round,
                repeat: self.config.repeat,
                phase: self.phase,
                first: RobotId(first),
                tasks: block.iter().copied().collect::<std::sync::Arc<[Task]>>(),
                latch: self.latch,
            }));
        }
    }
}

impl Core for StateServer {
    type In = In;
    type Out = Out;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        match input {
            In::Heartbeat(beat) => {
                let latch = self.latch.tightened(beat.latch);
                let fresh = self.round.term == 0;
                let overshoots = self.latch.is_overshot_by(beat.latch) || self.round.is_overshot_by(beat.round);
                if overshoots && !fresh {
                    self.presence.note_beyond_reach(&beat);
                }
                if self.presence.take(now, beat) {
                    self.latched(latch);
                }
            }
            In::Stop(stop) => self.take_stop(now, &stop, out),
            In::Release(release) => {
                self.take_stop(now, &release.stop(), out);
                self.release = Some(release).filter(|release| release.latch == self.latch).or(self.release.take());
            }
            In::Status(status) => self.absent.take(&status),
            In::Members(members) => self.absent.take_members(&members),
            In::Located(located) => self.lost.take(now, &located),
            In::Leave => {
                self.leaves = true;
                self.next = now;
            }
        }
    }

    fn wake_at(&self) -> Option<Time> {
        Some(self.next)
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        self.decide(now);
        out.extend(self.aborted.take().map(|(episode, reason)| Out::Aborted(episode, reason)));
        // Before the server knows the team's state, it only sends instructions to stop.
        let may_send = self.round.term > 0 || !self.latch.is_clear() || self.leaves;
        // While its host is shutting down, it sends at every decision.
        let period = if self.leaves { Span::ZERO } else { MODE_PERIOD };
        if may_send && self.sent_at.is_none_or(|at| now.since(at) >= period) {
            if self.sent_at.is_none() {
                self.times_sent = 0;
            }
            self.send_release(out);
            self.send_mode(out);
            self.sent_at = Some(now);
        }
        self.next = now.next_on_grid(Span::ZERO, TICK);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::place::Whereabouts;
    use crate::messages::wire;
    use crate::messages::wire::REVISION;
    use crate::scenario::{Settings, build};

    fn server() -> StateServer {
        let passage = build("passage", &Settings::of(2)).unwrap();
        let layouts = Layouts::of_scenario(&*passage, 1, 2);
        let limit = Span::from_millis(25_000);
        let hosts = vec![vec![RobotId(0)], vec![RobotId(1)], vec![RobotId(0), RobotId(1)]];
        StateServer::new(
            Config {
                layouts,
                repeat: 0,
                placement: Placement::Drive,
                limit,
                ending: Ending::Arrival,
                host: HostId(2),
                hosts,
                real: Vec::new(),
                block: 64,
                marks: Marks::default(),
            },
            2,
            1,
        )
    }

    fn beat(server: &mut StateServer, now: Time, round: Round, phases: [Phase; 2]) {
        for (robot, phase) in phases.into_iter().enumerate() {
            let robot = RobotId(robot as u16);
            let latch = Latch::default();
            server.handle(now, In::Heartbeat(Heartbeat::new(robot, round, phase, latch)), &mut Vec::new());
        }
    }

    fn tick(server: &mut StateServer, now: Time) -> (Round, Phase) {
        server.wake(now, &mut Vec::new());
        (server.round, server.phase)
    }

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    fn round(term: u32, episode: u32) -> Round {
        Round { term, episode }
    }

    #[test]
    fn a_team_goes_through_its_episodes() {
        let mut server = server();
        assert_eq!(tick(&mut server, at_ms(0)), (round(0, 0), Phase::NeedReset));
        beat(&mut server, at_ms(10), round(0, 0), [Phase::NeedReset; 2]);
        assert_eq!(tick(&mut server, at_ms(50)), (round(1, 0), Phase::Resetting));
        beat(&mut server, at_ms(60), round(1, 0), [Phase::FinishedResetting, Phase::Resetting]);
        assert_eq!(tick(&mut server, at_ms(100)).1, Phase::Resetting);
        beat(&mut server, at_ms(110), round(1, 0), [Phase::FinishedResetting; 2]);
        assert_eq!(tick(&mut server, at_ms(150)).1, Phase::Running);
        beat(&mut server, at_ms(160), round(1, 0), [Phase::FinishedRunning; 2]);
        assert_eq!(tick(&mut server, at_ms(200)), (round(1, 1), Phase::Resetting));
        beat(&mut server, at_ms(210), round(1, 1), [Phase::FinishedResetting; 2]);
        tick(&mut server, at_ms(250));
        beat(&mut server, at_ms(260), round(1, 1), [Phase::FinishedRunning; 2]);
        assert_eq!(tick(&mut server, at_ms(300)).1, Phase::EpisodesFinished);
    }

    #[test]
    fn an_episode_with_a_revoked_robot_is_aborted_and_the_team_waits_for_its_new_key() {
        let members = |server: &mut StateServer, ms: u64, hosts: &[u16]| {
            let members = hosts.iter().copied().map(HostId).chain([HostId::operator(1)]).collect();
            server.handle(at_ms(ms), In::Members(members), &mut Vec::new());
        };
        let mut server = running();
        members(&mut server, 110, &[0, 1, 2]);
        assert_eq!(tick(&mut server, at_ms(150)).1, Phase::Running);
        members(&mut server, 160, &[0, 2]);
        let mut out = Vec::new();
        server.wake(at_ms(200), &mut out);
        let revoked = AbortReason::of_robots(&[(RobotId(1), AbortCause::Revoked)]);
        let aborted = out.iter().find_map(|said| if let Out::Aborted(0, reason) = said { Some(*reason) } else { None });
        assert_eq!((aborted, server.phase), (revoked, Phase::AbortRunning));
        // For as long as it takes, in spite of the robot's heartbeats.
        for ms in (250..20_000).step_by(50) {
            beat(&mut server, at_ms(ms - 1), round(1, 0), [Phase::NeedReset; 2]);
            assert_eq!(tick(&mut server, at_ms(ms)), (round(1, 0), Phase::AbortRunning));
        }
        assert_eq!(server.hindrances(at_ms(20_000)), [(RobotId(1), Hindrance::Left)]);
        members(&mut server, 20_000, &[0, 1, 2]);
        beat(&mut server, at_ms(20_010), round(1, 0), [Phase::NeedReset; 2]);
        assert_eq!(tick(&mut server, at_ms(20_050)), (round(1, 1), Phase::Resetting));
        // Between two episodes none is used up.
        members(&mut server, 20_060, &[0, 2]);
        assert_eq!(tick(&mut server, at_ms(20_100)), (round(1, 1), Phase::Waiting));
    }

    #[test]
    fn a_team_of_unequal_revisions_stands_and_a_resume_names_the_robot() {
        let other = |server: &mut StateServer, ms: u64, phase: Phase| {
            let round = server.round;
            beat(server, at_ms(ms), round, [phase; 2]);
            let equal = Heartbeat::new(RobotId(1), server.round, phase, server.latch);
            let later = Heartbeat { revision: REVISION + 1, ..equal };
            server.handle(at_ms(ms), In::Heartbeat(later), &mut Vec::new());
        };
        let mut server = server();
        tick(&mut server, at_ms(0));
        other(&mut server, 10, Phase::NeedReset);
        assert_eq!(tick(&mut server, at_ms(50)), (round(0, 0), Phase::NeedReset), "it does not begin");
        beat(&mut server, at_ms(60), round(0, 0), [Phase::NeedReset; 2]);
        assert_eq!(tick(&mut server, at_ms(100)), (round(1, 0), Phase::Resetting), "until it is equal");
        beat(&mut server, at_ms(110), round(1, 0), [Phase::FinishedResetting; 2]);
        assert_eq!(tick(&mut server, at_ms(150)).1, Phase::Running);
        other(&mut server, 160, Phase::Running);
        assert_eq!(tick(&mut server, at_ms(200)), (round(1, 0), Phase::Waiting), "and no episode is lost");
        other(&mut server, 210, Phase::Waiting);
        server.handle(at_ms(220), In::Stop(Stop::engage(HostId::operator(1), server.latch)), &mut Vec::new());
        assert!(server.latch.is_engaged(), "a stop works");
        server.handle(at_ms(230), In::Stop(Stop::rearm(HostId::operator(1), server.latch)), &mut Vec::new());
        assert!(server.latch.is_held(), "and a re-arm");
        other(&mut server, 240, Phase::Waiting);
        let unequal = (RobotId(1), Hindrance::Unequal);
        assert!(resume(&mut server, 250).hindrances.contains(&unequal) && server.latch.is_held());
        let held = server.latch;
        follow(&mut server, at_ms(260), held, Phase::Waiting);
        assert!(resume(&mut server, 270).hindrances.is_empty());
        let clear = server.latch;
        follow(&mut server, at_ms(280), clear, Phase::Waiting);
        assert_eq!(tick(&mut server, at_ms(300)), (round(1, 0), Phase::Resetting), "the same episode");
    }

    #[test]
    fn a_team_of_unequal_policies_stands_and_a_resume_names_the_robot() {
        let says = |server: &mut StateServer, ms: u64, phase: Phase, policies: [u32; 2]| {
            for (robot, policy) in RobotId::team(2).zip(policies) {
                let beat = Heartbeat::new(robot, server.round, phase, server.latch);
                server.handle(at_ms(ms), In::Heartbeat(Heartbeat { policy, ..beat }), &mut Vec::new());
            }
        };
        let mut server = server();
        server.presence = Presence::new(2, Marks { policy: 7, task: 0 });
        says(&mut server, 10, Phase::NeedReset, [7, 8]);
        assert_eq!(tick(&mut server, at_ms(50)), (round(0, 0), Phase::NeedReset), "it does not begin");
        says(&mut server, 60, Phase::NeedReset, [7, 0]);
        assert_eq!(tick(&mut server, at_ms(100)), (round(1, 0), Phase::Resetting), "an older host does not say");
        says(&mut server, 110, Phase::Resetting, [8, 7]);
        assert_eq!(tick(&mut server, at_ms(150)).1, Phase::Waiting);
        server.handle(at_ms(160), In::Stop(Stop::rearm(HostId::operator(1), server.latch)), &mut Vec::new());
        says(&mut server, 170, Phase::Waiting, [8, 7]);
        assert_eq!(resume(&mut server, 180).hindrances, [(RobotId(0), Hindrance::Policy)]);
    }

    #[test]
    fn a_team_of_unequal_task_files_stands_and_a_resume_names_the_robot() {
        let says = |server: &mut StateServer, ms: u64, phase: Phase, tasks: [u32; 2]| {
            for (robot, task) in RobotId::team(2).zip(tasks) {
                let beat = Heartbeat::new(robot, server.round, phase, server.latch).of(Marks { policy: 7, task });
                server.handle(at_ms(ms), In::Heartbeat(beat), &mut Vec::new());
            }
        };
        let mut server = server();
        server.presence = Presence::new(2, Marks { policy: 7, task: 5 });
        for tasks in [[5, 6], [0, 5]] {
            says(&mut server, 10, Phase::NeedReset, tasks);
            assert_eq!(tick(&mut server, at_ms(50)), (round(0, 0), Phase::NeedReset), "it does not begin");
        }
        says(&mut server, 60, Phase::NeedReset, [5, 5]);
        assert_eq!(tick(&mut server, at_ms(100)), (round(1, 0), Phase::Resetting));
        says(&mut server, 110, Phase::Resetting, [6, 5]);
        assert_eq!(tick(&mut server, at_ms(150)).1, Phase::Waiting);
        server.handle(at_ms(160), In::Stop(Stop::rearm(HostId::operator(1), server.latch)), &mut Vec::new());
        says(&mut server, 170, Phase::Waiting, [6, 5]);
        assert_eq!(resume(&mut server, 180).hindrances, [(RobotId(0), Hindrance::Task)]);
    }

    #[test]
    fn no_robots_host_ends_a_stop_or_a_hold_whatever_it_repeats() {
        let claims = |server: &mut StateServer, ms: u64, latch: Latch| {
            let (round, phase) = (server.round, Phase::AbortRunning);
            server.handle(at_ms(ms), In::Heartbeat(Heartbeat::new(RobotId(1), round, phase, latch)), &mut Vec::new());
            tick(server, at_ms(ms));
            server.latch
        };
        let order = |server: &mut StateServer, ms: u64, stop: Stop| {
            server.handle(at_ms(ms), In::Stop(stop), &mut Vec::new());
            server.latch
        };
        let (mut server, by) = (running(), HostId::operator(1));
        let stop = Stop::engage(by, server.latch);
        let stopped = order(&mut server, 110, stop);
        assert!(stopped.is_engaged());
        for latch in [Latch::clear(99), Latch::held(99), Latch::clear(stopped.number() + 1)] {
            assert_eq!(claims(&mut server, 120, latch), stopped, "{latch:?}");
        }
        let rearm = Stop::rearm(HostId(1), stopped);
        assert_eq!(order(&mut server, 140, rearm), stopped, "it is no operator's");
        assert_eq!(claims(&mut server, 150, Latch::engaged(60)), Latch::engaged(60), "a stop is believed");
        let held = order(&mut server, 160, Stop::rearm(by, Latch::engaged(60)));
        assert_eq!(held, Latch::held(61));
        assert_eq!(claims(&mut server, 170, Latch::clear(62)), held);
        let resume = Stop::resume(HostId(1), held);
        assert_eq!(order(&mut server, 180, resume), held);
        // A server that has just started knows nothing, and takes the strictest.
        for (one, other) in [(Latch::engaged(5), Latch::clear(99)), (Latch::clear(99), Latch::engaged(5))] {
            let mut next = super::tests::server();
            tick(&mut next, at_ms(0));
            for (robot, latch) in [(0, one), (1, other)] {
                let beat = Heartbeat::new(RobotId(robot), round(1, 0), Phase::AbortRunning, latch);
                next.handle(at_ms(10), In::Heartbeat(beat), &mut Vec::new());
            }
            let mut out = Vec::new();
            next.wake(at_ms(50), &mut out);
            assert!(next.latch.is_engaged() && next.latch.number() == 99, "{:?}", next.latch);
            assert!(modes(&out).iter().all(|mode| mode.latch.is_engaged()), "and never says otherwise");
            tick(&mut next, at_ms(2000));
            assert!(next.latch.is_engaged(), "nor forgets it when no robot is heard any more");
        }
    }

    #[test]
    fn the_signed_original_of_the_present_latch_is_repeated_for_robots_that_have_missed_it() {
        let by = HostId::operator(1);
        let signed = |latch| {
            let signature = wire::Signature([1; 64]);
            Release { by, latch, hosts: vec![(HostId(0), 5)], signature }
        };
        let sent = |server: &mut StateServer, ms: u64| {
            let mut out = Vec::new();
            server.wake(at_ms(ms), &mut out);
            let releases = |out: &Out| if let Out::Release(release) = out { Some(release.latch) } else { None };
            (out.iter().find_map(releases), modes(&out).len())
        };
        let mut server = running();
        let stop = Stop::engage(by, server.latch);
        server.handle(at_ms(110), In::Stop(stop), &mut Vec::new());
        let held = Latch::held(stop.latch.number() + 1);
        server.handle(at_ms(120), In::Release(signed(held)), &mut Vec::new());
        assert_eq!(server.latch, held);
        let said: Vec<_> = (0..40).map(|turn| sent(&mut server, 150 + 100 * turn)).collect();
        assert!(said.iter().all(|(_, modes)| *modes > 0));
        let times = said.iter().filter(|(release, _)| *release == Some(held)).count();
        assert!((6..=7).contains(&times), "with each new one, then once a second: {times}");
        server.handle(at_ms(4200), In::Stop(Stop::engage(by, held)), &mut Vec::new());
        assert_eq!(sent(&mut server, 4250).0, None, "it is of a state that is past");
    }

    #[test]
    fn an_episode_without_goals_ends_by_time_and_is_not_aborted() {
        let mut server = server();
        (server.config.ending, server.config.placement) = (Ending::Time, Placement::Exact);
        let (mut at, mut phases) = (0, Vec::new());
        while server.round.episode < 2 && at < 60_000 {
            at += 50;
            let now = (server.round, server.phase);
            beat(&mut server, at_ms(at), now.0, [now.1; 2]);
            let next = tick(&mut server, at_ms(at));
            if next != now {
                phases.push(next.1);
            }
        }
        assert_eq!(phases, [Phase::Running, Phase::Running, Phase::EpisodesFinished], "{at} ms");
        assert!((51_000..52_000).contains(&at), "two episodes of 25 s and the grace: {at} ms");
    }

    #[test]
    fn after_a_failed_reset_of_a_real_robot_the_team_is_held_until_a_resume() {
        for (real, held) in [(vec![RobotId(1)], true), (vec![RobotId(0)], false), (Vec::new(), false)] {
            let mut server = server();
            server.config.real = real;
            let mut at = 0;
            let mut latest = (round(0, 0), Phase::NeedReset);
            while latest.1 != Phase::AbortRunning {
                at += 50;
                let phases = [Phase::FinishedResetting, Phase::Resetting];
                let now = server.round;
                beat(&mut server, at_ms(at), now, if now.term == 0 { [Phase::NeedReset; 2] } else { phases });
                latest = tick(&mut server, at_ms(at));
                assert!(at < 70_000, "a reset does not last for ever");
            }
            assert_eq!(server.latch.is_held(), held, "robot 1 is late");
            let latch = server.latch;
            for robot in [0, 1].map(RobotId) {
                let beat = Heartbeat::new(robot, round(1, 0), Phase::NeedReset, latch);
                server.handle(at_ms(at + 10), In::Heartbeat(beat), &mut Vec::new());
            }
            let after = if held { Phase::AbortRunning } else { Phase::Resetting };
            assert_eq!(tick(&mut server, at_ms(at + 50)).1, after);
            server.handle(at_ms(at + 60), In::Stop(Stop::resume(HostId::operator(70), latch)), &mut Vec::new());
            assert_eq!(tick(&mut server, at_ms(at + 100)), (round(1, 1), Phase::Resetting), "it goes on");
        }
    }

    #[test]
    fn a_large_team_is_told_news_at_once_and_then_a_block_at_a_time() {
        let swap = build("swap", &Settings::of(150)).unwrap();
        let layouts = Layouts::of_scenario(&*swap, 1, 2);
        let limit = Span::from_millis(60_000);
        let config = Config {
            layouts,
            repeat: 0,
            placement: Placement::Exact,
            limit,
            ending: Ending::Arrival,
            host: HostId(0),
            hosts: Vec::new(),
            real: Vec::new(),
            block: 64,
            marks: Marks::default(),
        };
        let mut server = StateServer::new(config, 150, 1);
        let blocks = |server: &mut StateServer, ms: u64, phase: Phase| -> Vec<u16> {
            for robot in RobotId::team(150) {
                let beat = Heartbeat::new(robot, server.round, phase, Latch::default());
                server.handle(at_ms(ms), In::Heartbeat(beat), &mut Vec::new());
            }
            let mut out = Vec::new();
            server.wake(at_ms(ms), &mut out);
            modes(&out).iter().map(|mode| mode.first.0).collect()
        };
        let all = [0, 64, 128];
        let mut said: Vec<Vec<u16>> = Vec::new();
        said.extend((0..9).map(|at| blocks(&mut server, 100 * at, Phase::Running)));
        assert_eq!(said[..3], [all.to_vec(), all.to_vec(), all.to_vec()], "news");
        assert_eq!(said[3..], [[0], [64], [128], [0], [64], [128]].map(Vec::from));
        assert_eq!(blocks(&mut server, 900, Phase::FinishedRunning), all, "the next episode is news");
    }

    #[test]
    fn a_restarted_server_gives_up_the_running_episode_and_goes_on() {
        let mut server = server();
        tick(&mut server, at_ms(0));
        beat(&mut server, at_ms(10), round(4, 0), [Phase::Running, Phase::FinishedRunning]);
        assert_eq!(tick(&mut server, at_ms(50)), (round(5, 0), Phase::AbortRunning));
        beat(&mut server, at_ms(60), round(5, 0), [Phase::NeedReset; 2]);
        assert_eq!(tick(&mut server, at_ms(100)), (round(5, 1), Phase::Resetting));
    }

    #[test]
    fn a_server_that_started_blind_or_is_behind_overtakes_the_team() {
        let mut unheard = server();
        tick(&mut unheard, at_ms(0));
        assert_eq!(tick(&mut unheard, at_ms(10_000)), (round(1, 0), Phase::Resetting));
        beat(&mut unheard, at_ms(10_010), round(4, 1), [Phase::Resetting; 2]);
        assert_eq!(tick(&mut unheard, at_ms(10_050)), (round(5, 1), Phase::Resetting), "it learns where the team is");

        let mut server = server();
        tick(&mut server, at_ms(0));
        beat(&mut server, at_ms(10), round(0, 0), [Phase::NeedReset; 2]);
        tick(&mut server, at_ms(50));
        beat(&mut server, at_ms(60), round(1, 900), [Phase::NeedReset; 2]);
        assert_eq!(tick(&mut server, at_ms(100)), (round(2, 0), Phase::Resetting), "a garbled episode is no episode");
    }

    #[test]
    fn a_missing_robot_or_one_that_gives_up_ends_the_episode() {
        assert_eq!(tick(&mut running(), at_ms(1100)).1, Phase::AbortRunning);
        let mut server = running();
        beat(&mut server, at_ms(110), round(1, 0), [Phase::Running, Phase::AbortRunning]);
        assert_eq!(tick(&mut server, at_ms(150)).1, Phase::AbortRunning);
    }

    #[test]
    fn an_engaged_stop_holds_the_team_until_a_later_re_arm() {
        let mut server = server();
        tick(&mut server, at_ms(0));
        beat(&mut server, at_ms(10), round(0, 0), [Phase::NeedReset; 2]);
        assert_eq!(tick(&mut server, at_ms(50)).1, Phase::Resetting);
        let (robot, phase, latch) = (RobotId(1), Phase::Resetting, Latch::engaged(3));
        let stopped = Heartbeat::new(robot, round(1, 0), phase, latch);
        server.handle(at_ms(60), In::Heartbeat(stopped), &mut Vec::new());
        let mut out = Vec::new();
        server.wake(at_ms(100), &mut out);
        let told = modes(&out)[0];
        assert_eq!((told.phase, told.latch), (Phase::AbortRunning, Latch::engaged(3)), "it repeats the stop");
        for ms in (150..30_000).step_by(50) {
            beat(&mut server, at_ms(ms), round(1, 0), [Phase::NeedReset; 2]);
            assert_eq!(tick(&mut server, at_ms(ms)).1, Phase::AbortRunning, "whatever the robots say, and for ever");
        }
        let say = |server: &mut StateServer, ms: u64, latch: Latch| {
            server.handle(at_ms(ms), In::Stop(Stop { by: HostId::operator(9), latch }), &mut Vec::new());
            tick(server, at_ms(ms));
            server.latch
        };
        assert_eq!(say(&mut server, 30_000, Latch::held(3)), Latch::engaged(3), "not later than the stop");
        assert_eq!(say(&mut server, 30_010, Latch::clear(4)), Latch::engaged(3), "a stop cannot be resumed from");
        assert_eq!(say(&mut server, 30_020, Latch::held(4)), Latch::held(4));
        for ms in (30_050..40_000).step_by(50) {
            follow(&mut server, at_ms(ms), Latch::held(4), Phase::NeedReset);
            assert_eq!(tick(&mut server, at_ms(ms)).1, Phase::AbortRunning, "a re-arm alone begins nothing");
        }
        for stale in [Latch::clear(0), Latch::clear(4), Latch::clear(6)] {
            assert_eq!(say(&mut server, 40_000, stale), Latch::held(4), "another resume than that of this hold");
        }
        assert_eq!(say(&mut server, 40_010, Latch::clear(5)), Latch::clear(5));
        assert_eq!(tick(&mut server, at_ms(40_050)), (round(1, 1), Phase::Resetting), "the next episode");
        assert_eq!(say(&mut server, 40_060, Latch::clear(5)), Latch::clear(5), "a resume counts once");
    }

    #[test]
    fn a_hold_between_two_episodes_loses_neither() {
        let mut server = server();
        tick(&mut server, at_ms(0));
        beat(&mut server, at_ms(10), round(0, 0), [Phase::NeedReset; 2]);
        assert_eq!(tick(&mut server, at_ms(50)), (round(1, 0), Phase::Resetting));
        let hold = Stop::rearm(HostId::operator(1), Latch::clear(0));
        server.handle(at_ms(60), In::Stop(hold), &mut Vec::new());
        assert_eq!(tick(&mut server, at_ms(100)).1, Phase::Waiting);
        for ms in (150..20_000).step_by(50) {
            follow(&mut server, at_ms(ms), Latch::held(1), Phase::Waiting);
            assert_eq!(tick(&mut server, at_ms(ms)).1, Phase::Waiting, "until the resume");
        }
        assert_eq!(resume(&mut server, 20_000).latch, Latch::clear(2));
        follow(&mut server, at_ms(20_020), Latch::clear(2), Phase::Waiting);
        let (round, phase) = tick(&mut server, at_ms(20_050));
        assert_eq!((round.episode, phase), (0, Phase::Resetting), "the same episode, anew");
    }

    /// Both robots follow the current round with this latch and phase.
    fn follow(server: &mut StateServer, now: Time, latch: Latch, phase: Phase) {
        for robot in RobotId::team(2) {
            let round = server.round;
            server.handle(now, In::Heartbeat(Heartbeat::new(robot, round, phase, latch)), &mut Vec::new());
        }
    }

    fn modes(out: &[Out]) -> Vec<&Mode> {
        out.iter().filter_map(|said| if let Out::Mode(mode) = said { Some(mode) } else { None }).collect()
    }

    /// Answer to an operator that asks for a resume.
    fn resume(server: &mut StateServer, ms: u64) -> Leading {
        let (by, mut out) = (HostId::operator(1), Vec::new());
        server.handle(at_ms(ms), In::Stop(Stop::resume(by, server.latch)), &mut out);
        out.into_iter().find_map(|said| if let Out::Leading(leading) = said { Some(leading) } else { None }).unwrap()
    }

    #[test]
    fn a_resume_is_refused_by_name_while_a_robot_is_missing_latched_or_has_left() {
        let mut server = server();
        tick(&mut server, at_ms(0));
        follow(&mut server, at_ms(10), Latch::held(2), Phase::NeedReset);
        tick(&mut server, at_ms(50));
        let (robot, phase, round) = (RobotId(1), Phase::NeedReset, server.round);
        let latched = Heartbeat::new(robot, round, phase, Latch::engaged(1));
        server.handle(at_ms(60), In::Heartbeat(latched), &mut Vec::new());
        assert_eq!(resume(&mut server, 70).hindrances, [(RobotId(1), Hindrance::Latched)]);
        assert_eq!(server.latch, Latch::held(2));
        server.handle(at_ms(80), In::Status(status(0, true)), &mut Vec::new());
        follow(&mut server, at_ms(90), Latch::held(2), Phase::NeedReset);
        assert_eq!(resume(&mut server, 95).hindrances, [(RobotId(0), Hindrance::Left)]);
        server.handle(at_ms(100), In::Status(status(0, false)), &mut Vec::new());
        let missing = [(RobotId(0), Hindrance::Missing), (RobotId(1), Hindrance::Missing)];
        assert_eq!(resume(&mut server, 2000).hindrances, missing);
        follow(&mut server, at_ms(2010), Latch::held(2), Phase::NeedReset);
        assert_eq!(resume(&mut server, 2020), Leading { latch: Latch::clear(3), hindrances: Vec::new() });
    }

    /// Message of a host that leaves or is present; its robots' part is not used.
    fn status(host: u16, leaves: bool) -> Status {
        let following = |robot| wire::Following { robot: RobotId(robot), controller: None, body: None };
        Status::of(HostId(host), leaves, (0..64).map(following).collect(), None)
    }

    fn running() -> StateServer {
        let mut server = server();
        tick(&mut server, at_ms(0));
        follow(&mut server, at_ms(10), Latch::default(), Phase::NeedReset);
        tick(&mut server, at_ms(50));
        follow(&mut server, at_ms(60), Latch::default(), Phase::FinishedResetting);
        assert_eq!(tick(&mut server, at_ms(100)), (round(1, 0), Phase::Running));
        server
    }

    #[test]
    fn the_team_waits_for_a_host_that_leaves_for_as_long_as_it_takes_and_uses_up_no_episode() {
        let mut server = running();
        server.handle(at_ms(110), In::Status(status(1, true)), &mut Vec::new());
        for ms in (150..60_000).step_by(50) {
            assert_eq!(tick(&mut server, at_ms(ms)), (round(1, 0), Phase::Waiting));
        }
        server.handle(at_ms(60_000), In::Status(status(1, false)), &mut Vec::new());
        follow(&mut server, at_ms(60_010), Latch::default(), Phase::NeedReset);
        assert_eq!(tick(&mut server, at_ms(60_050)).1, Phase::Waiting, "until all follow");
        follow(&mut server, at_ms(60_060), Latch::default(), Phase::Waiting);
        assert_eq!(tick(&mut server, at_ms(60_100)), (round(1, 0), Phase::Resetting), "the same episode");
    }

    fn locate(server: &mut StateServer, ms: u64, whereabouts: Whereabouts) {
        let located = Located { host: HostId(1), robots: vec![(RobotId(1), whereabouts)], answer: None };
        server.handle(at_ms(ms), In::Located(located), &mut Vec::new());
    }

    #[test]
    fn an_episode_is_aborted_for_a_robot_whose_pose_is_lost_and_no_reset_begins_before_it_is_known_again() {
        let mut server = running();
        let round = server.round;
        locate(&mut server, 1000, Whereabouts::Adrift);
        assert_eq!(tick(&mut server, at_ms(1000)), (round, Phase::AbortRunning));
        for ms in (1050..30_000).step_by(50) {
            locate(&mut server, ms, Whereabouts::Adrift);
            beat(&mut server, at_ms(ms), round, [Phase::NeedReset; 2]);
            assert_eq!(tick(&mut server, at_ms(ms)).1, Phase::AbortRunning, "for as long as it takes");
        }
        locate(&mut server, 30_000, Whereabouts::Known);
        beat(&mut server, at_ms(30_000), round, [Phase::NeedReset; 2]);
        let (next, phase) = tick(&mut server, at_ms(30_000));
        assert_eq!((next.episode, phase), (round.episode + 1, Phase::Resetting));
        locate(&mut server, 31_000, Whereabouts::Jumped);
        assert_eq!(tick(&mut server, at_ms(31_000)), (next, Phase::Waiting), "the others stand, too");
        for ms in [31_500, 32_050] {
            beat(&mut server, at_ms(ms), next, [Phase::Waiting; 2]);
            let expected = if ms == 31_500 { Phase::Waiting } else { Phase::Resetting };
            assert_eq!(tick(&mut server, at_ms(ms)), (next, expected), "its host has said nothing more for a second");
        }
    }

    #[test]
    fn a_server_whose_host_leaves_says_so_at_once_and_its_successor_uses_up_no_episode() {
        let mut server = running();
        server.handle(at_ms(110), In::Leave, &mut Vec::new());
        assert_eq!(server.wake_at(), Some(at_ms(110)));
        let mut out = Vec::new();
        server.wake(at_ms(110), &mut out);
        assert_eq!((modes(&out)[0].phase, server.wake_at()), (Phase::Waiting, Some(at_ms(150))));
        out.clear();
        server.wake(at_ms(150), &mut out);
        assert_eq!(modes(&out).len(), 1, "and repeats it at every step");
        let mut next = super::tests::server();
        beat(&mut next, at_ms(10), round(1, 0), [Phase::Waiting; 2]);
        assert_eq!(tick(&mut next, at_ms(50)), (round(2, 0), Phase::Waiting), "until all follow it");
        beat(&mut next, at_ms(60), round(2, 0), [Phase::Waiting; 2]);
        assert_eq!(tick(&mut next, at_ms(100)), (round(2, 0), Phase::Resetting), "the same episode");
    }

    #[test]
    fn a_server_that_was_started_afresh_still_waits_for_a_host_that_has_left() {
        let mut next = super::tests::server();
        let round_of = |server: &StateServer| if server.round.term == 0 { round(1, 0) } else { server.round };
        tick(&mut next, at_ms(0));
        for ms in (0..60_000).step_by(50) {
            let (robot, phase, latch) = (RobotId(0), Phase::Waiting, Latch::default());
            let beat = Heartbeat::new(robot, round_of(&next), phase, latch);
            next.handle(at_ms(ms), In::Heartbeat(beat), &mut Vec::new());
            let (_, phase) = tick(&mut next, at_ms(ms));
            assert!(matches!(phase, Phase::NeedReset | Phase::Waiting), "robot 1 has left: {phase:?}");
        }
        follow(&mut next, at_ms(60_000), Latch::default(), Phase::Waiting);
        assert_eq!(tick(&mut next, at_ms(60_050)), (round(2, 0), Phase::Resetting));
    }

    #[test]
    fn a_host_that_leaves_before_the_first_episode_is_waited_for_and_comes_back() {
        let mut server = server();
        tick(&mut server, at_ms(0));
        server.handle(at_ms(10), In::Status(status(1, true)), &mut Vec::new());
        let mut out = Vec::new();
        server.wake(at_ms(10_050), &mut out);
        assert_eq!(modes(&out)[0].phase, Phase::Waiting, "it is told, so that the host says that it is here");
        server.handle(at_ms(10_100), In::Status(status(1, false)), &mut Vec::new());
        follow(&mut server, at_ms(10_110), Latch::default(), Phase::Waiting);
        assert_eq!(tick(&mut server, at_ms(10_150)).1, Phase::Resetting);
    }

    #[test]
    fn a_host_of_no_team_and_a_member_that_repeats_itself_leave_nothing_behind() {
        let mut server = running();
        for host in 0..1000 {
            server.handle(at_ms(110), In::Status(status(host % 500, true)), &mut Vec::new());
        }
        assert_eq!(server.absent.count(), 3, "the hosts that there are");
    }

    #[test]
    fn one_robot_that_claims_the_largest_numbers_is_not_followed() {
        let mut server = running();
        let (robot, phase) = (RobotId(1), Phase::Running);
        let far = Heartbeat::new(robot, round(1 << 30, 0), phase, Latch::engaged(1 << 50));
        for ms in (110..900).step_by(50) {
            server.handle(at_ms(ms), In::Heartbeat(far.clone()), &mut Vec::new());
            tick(&mut server, at_ms(ms));
        }
        assert_eq!((server.round.term, server.latch), (1, Latch::default()));
        assert_eq!(server.presence.beyond_reach, 16);
        let two_say = 1 << 25;
        let mut fresh = super::tests::server();
        beat(&mut fresh, at_ms(0), round(two_say, 0), [Phase::NeedReset; 2]);
        tick(&mut fresh, at_ms(0));
        assert_eq!(fresh.round.term, two_say + 1, "what two say is taken up, however far");
        let mut fresh = super::tests::server();
        fresh.handle(at_ms(0), In::Heartbeat(far.clone()), &mut Vec::new());
        tick(&mut fresh, at_ms(10));
        assert_eq!(fresh.latch, Latch::default(), "the first that is heard may lie, too");
        beat(&mut fresh, at_ms(20), round(40, 0), [Phase::NeedReset; 2]);
        fresh.handle(at_ms(30), In::Heartbeat(far), &mut Vec::new());
        tick(&mut fresh, at_ms(40));
        assert_eq!((fresh.round.term, fresh.latch), (41, Latch::default()));
    }

    #[test]
    fn a_stop_before_the_team_is_together_is_told_and_held() {
        let mut server = server();
        server.handle(at_ms(0), In::Stop(Stop::engage(HostId(9), Latch::default())), &mut Vec::new());
        let mut out = Vec::new();
        server.wake(at_ms(0), &mut out);
        assert!(modes(&out)[0].latch.is_engaged());
        beat(&mut server, at_ms(10), round(0, 0), [Phase::NeedReset; 2]);
        assert_eq!(tick(&mut server, at_ms(50)), (round(0, 0), Phase::NeedReset));
    }
}
