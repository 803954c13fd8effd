//! StateServer: leads the team through its episodes, unattended (paper, section IV).
//!
//! It hears heartbeats and says, several times a second, what everyone is to do: reset, run, or stop. It
//! asks nothing and is answered by nothing. While the emergency stop is engaged it holds the team. A restarted
//! one learns from the heartbeats where the team is, gives up an episode that was running, and goes on with the
//! next.

use super::Core;
use crate::messages::geometry::Task;
use crate::messages::ids::RobotId;
use crate::messages::latch::Latch;
use crate::messages::wire::{Heartbeat, MAX_BLOCK, Mode, Phase, Round, Stop};
use crate::scenario::layout::Layouts;
use crate::time::{Span, Time};
use crate::world::Placement;

/// How often it decides: once a World step.
pub const TICK: Span = Span::from_millis(50);
/// How often it repeats an unchanged instruction; to a team of more than one block, a block at a time.
pub const MODE_PERIOD: Span = Span::from_millis(100);
/// How often a new instruction is said to all blocks, before they take turns: of so many in a row hardly all get lost.
pub const NEWS: u32 = 3;
/// A robot that has been silent for longer is missing: five heartbeats.
pub const MISSING_AFTER: Span = Span::from_millis(1000);
/// How long it waits for missing robots before it goes on without them.
pub const MUSTER_LIMIT: Span = Span::from_millis(10_000);
/// How long a reset may take.
pub const RESET_LIMIT: Span = Span::from_millis(60_000);
/// How much longer than the rules allow a running episode is let go on: heartbeats are that late.
pub const GRACE: Span = Span::from_millis(500);

/// What a StateServer accepts.
#[derive(Clone, Debug)]
pub enum In {
    /// Where a robot stands.
    Heartbeat(Heartbeat),
    /// The emergency stop, engaged or taken back.
    Stop(Stop),
}

/// How a StateServer is set up.
#[derive(Clone, Debug)]
pub struct Config {
    /// The episodes, in order.
    pub layouts: Layouts,
    /// Which repeat of the experiment this is.
    pub repeat: u32,
    /// Whether robots are placed or drive to their starts.
    pub placement: Placement,
    /// How long an episode may run.
    pub limit: Span,
}

/// The state server.
#[derive(Debug)]
pub struct StateServer {
    config: Config,
    robots: Vec<Option<(Time, Heartbeat)>>,
    /// Its incarnation: no later one starts from an earlier epoch.
    life: u32,
    /// Whether it has taken up its work without hearing anyone.
    blind: bool,
    latch: Latch,
    round: Round,
    phase: Phase,
    /// When the phase began; before the first tick there is none.
    since: Option<Time>,
    said: Option<Time>,
    /// How often the instruction was said, and which block of robots it is repeated to next.
    told: u32,
    turn: usize,
    next: Time,
}

impl StateServer {
    /// A state server that does not yet know where the team is.
    pub fn new(config: Config, robots: usize, life: u32) -> StateServer {
        StateServer {
            config,
            robots: vec![None; robots],
            life,
            blind: false,
            latch: Latch::default(),
            round: Round::default(),
            phase: Phase::NeedReset,
            since: None,
            said: None,
            told: 0,
            turn: 0,
            next: Time::ZERO,
        }
    }

    /// What a robot last said, if that was not long ago.
    fn present(&self, now: Time) -> impl Iterator<Item = Option<&Heartbeat>> {
        self.robots.iter().map(move |heard| {
            let (at, beat) = heard.as_ref()?;
            (now.since(*at) < MISSING_AFTER).then_some(beat)
        })
    }

    fn all_are(&self, now: Time, phase: Phase) -> bool {
        self.present(now).all(|beat| beat.is_some_and(|beat| beat.round == self.round && beat.phase == phase))
    }

    fn enter(&mut self, now: Time, phase: Phase) {
        tracing::debug!(episode = self.round.episode, ?phase, "the team goes on");
        (self.phase, self.since, self.said) = (phase, Some(now), None);
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

    /// Takes up where the team is: at the beginning, or wherever a former incarnation has left it.
    fn take_up(&mut self, now: Time) {
        let heard: Vec<Heartbeat> = self.present(now).flatten().cloned().collect();
        let last = heard.iter().map(|beat| beat.round).max().unwrap_or_default();
        let epoch = last.epoch.saturating_add(1).max(self.life);
        self.round = Round { epoch, episode: last.episode.min(self.config.layouts.len()) };
        self.blind = heard.is_empty();
        let in_the_midst = |beat: &Heartbeat| {
            let phases = [Phase::Running, Phase::FinishedRunning, Phase::AbortRunning, Phase::NeedReset];
            beat.round == last && phases.contains(&beat.phase)
        };
        if heard.iter().any(|beat| beat.round == last && beat.phase == Phase::EpisodesFinished) {
            self.enter(now, Phase::EpisodesFinished);
        } else if last.epoch > 0 && heard.iter().any(in_the_midst) {
            tracing::warn!(episode = last.episode, "a running episode is given up: the state server was restarted");
            self.enter(now, Phase::AbortRunning);
        } else {
            self.begin(now, last.episode);
        }
    }

    /// A robot follows a later round than this: one of a former incarnation, or one that was garbled on its way.
    /// It would refuse everything that is said here, so the epoch has to overtake it.
    fn overtake(&mut self, now: Time) {
        let latest = self.present(now).flatten().map(|beat| beat.round).max().unwrap_or_default();
        if self.round.epoch == 0 || latest <= self.round {
            return;
        }
        if self.blind {
            self.take_up(now);
        } else {
            self.round.epoch = latest.epoch.saturating_add(1);
            self.said = None;
        }
    }

    /// Nobody moves, no episode begins, and the next one begins no sooner than the team is ready for it.
    fn hold(&mut self, now: Time) {
        match self.phase {
            Phase::Resetting | Phase::Running => self.enter(now, Phase::AbortRunning),
            _ => self.since = Some(now),
        }
    }

    /// It knows more of the emergency stop than before, and says so at once.
    fn latched(&mut self, latch: Latch) {
        if latch != self.latch {
            tracing::warn!(engaged = latch.is_engaged(), number = latch.number(), "emergency stop");
            (self.latch, self.said) = (latch, None);
        }
    }

    /// Decides what comes next.
    fn decide(&mut self, now: Time) {
        self.overtake(now);
        if self.latch.is_engaged() {
            return self.hold(now);
        }
        let since = *self.since.get_or_insert(now);
        let lasted = now.since(since);
        let everyone = self.present(now).all(|beat| beat.is_some());
        let gives_up = |beat: &Heartbeat| beat.round == self.round && beat.phase == Phase::AbortRunning;
        match self.phase {
            Phase::NeedReset if everyone || lasted >= MUSTER_LIMIT => self.take_up(now),
            Phase::Resetting if self.all_are(now, Phase::FinishedResetting) => self.enter(now, Phase::Running),
            Phase::Resetting if lasted >= RESET_LIMIT => {
                tracing::warn!(episode = self.round.episode, "the reset takes too long; the episode is given up");
                self.enter(now, Phase::AbortRunning);
            }
            Phase::Running if self.all_are(now, Phase::FinishedRunning) => self.begin(now, self.round.episode + 1),
            Phase::Running
                if !everyone || lasted > self.config.limit + GRACE || self.present(now).flatten().any(gives_up) =>
            {
                self.enter(now, Phase::AbortRunning);
            }
            Phase::AbortRunning if self.all_are(now, Phase::NeedReset) || lasted >= MUSTER_LIMIT => {
                self.begin(now, self.round.episode + 1);
            }
            _ => {}
        }
    }

    /// What is new is said to everyone. What is repeated holds the tasks of one block, and all else for everyone: so
    /// what a robot hears does not grow with the team.
    fn say(&mut self, out: &mut Vec<Mode>) {
        let last = self.config.layouts.len() - 1;
        let tasks = self.config.layouts.episode(self.round.episode.min(last));
        let blocks = tasks.len().div_ceil(MAX_BLOCK);
        self.told = if self.said.is_none() { 1 } else { self.told.saturating_add(1) };
        let turn = if self.told <= NEWS { 0..blocks } else { self.turn..self.turn + 1 };
        self.turn = turn.end % blocks;
        for (index, block) in tasks.chunks(MAX_BLOCK).enumerate().filter(|(index, _)| turn.contains(index)) {
            let first = u16::try_from(index * MAX_BLOCK).expect("a team has at most 65 535 robots");
            out.push(Mode {
                round: self.round,
                repeat: self.config.repeat,
                phase: self.phase,
                first: RobotId(first),
                tasks: block.iter().copied().collect::<std::sync::Arc<[Task]>>(),
                latch: self.latch,
            });
        }
    }
}

impl Core for StateServer {
    type In = In;
    type Out = Mode;

    fn handle(&mut self, now: Time, input: In, _: &mut Vec<Mode>) {
        match input {
            In::Heartbeat(beat) => {
                let latch = self.latch.joined(beat.latch);
                if let Some(heard) = self.robots.get_mut(beat.robot.index()) {
                    *heard = Some((now, beat));
                    self.latched(latch);
                }
            }
            In::Stop(stop) => self.latched(self.latch.told(stop.latch)),
        }
    }

    fn wake_at(&self) -> Option<Time> {
        Some(self.next)
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Mode>) {
        self.decide(now);
        // Until it knows where the team is, it has nothing to say but that everyone is to stand.
        let speaks = self.round.epoch > 0 || self.latch.is_engaged();
        if speaks && self.said.is_none_or(|said| now.since(said) >= MODE_PERIOD) {
            self.say(out);
            self.said = Some(now);
        }
        self.next = now.next_on_grid(Span::ZERO, TICK);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::ids::HostId;
    use crate::scenario::{Settings, build};

    fn server() -> StateServer {
        let passage = build("passage", &Settings::of(2)).unwrap();
        let layouts = Layouts::of_scenario(&*passage, 1, 2);
        let limit = Span::from_millis(25_000);
        StateServer::new(Config { layouts, repeat: 0, placement: Placement::Drive, limit }, 2, 1)
    }

    fn beat(server: &mut StateServer, now: Time, round: Round, phases: [Phase; 2]) {
        for (robot, phase) in phases.into_iter().enumerate() {
            let robot = RobotId(robot as u16);
            let latch = Latch::default();
            server.handle(now, In::Heartbeat(Heartbeat { robot, round, phase, latch }), &mut Vec::new());
        }
    }

    fn tick(server: &mut StateServer, now: Time) -> (Round, Phase) {
        server.wake(now, &mut Vec::new());
        (server.round, server.phase)
    }

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    fn round(epoch: u32, episode: u32) -> Round {
        Round { epoch, episode }
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
    fn a_large_team_is_told_news_at_once_and_then_a_block_at_a_time() {
        let swap = build("swap", &Settings::of(150)).unwrap();
        let layouts = Layouts::of_scenario(&*swap, 1, 2);
        let limit = Span::from_millis(60_000);
        let config = Config { layouts, repeat: 0, placement: Placement::Exact, limit };
        let mut server = StateServer::new(config, 150, 1);
        let blocks = |server: &mut StateServer, ms: u64, phase: Phase| -> Vec<u16> {
            for robot in RobotId::team(150) {
                let beat = Heartbeat { robot, round: server.round, phase, latch: Latch::default() };
                server.handle(at_ms(ms), In::Heartbeat(beat), &mut Vec::new());
            }
            let mut out = Vec::new();
            server.wake(at_ms(ms), &mut out);
            out.iter().map(|mode| mode.first.0).collect()
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
        let mut blind = server();
        tick(&mut blind, at_ms(0));
        assert_eq!(tick(&mut blind, at_ms(10_000)), (round(1, 0), Phase::Resetting));
        beat(&mut blind, at_ms(10_010), round(4, 1), [Phase::Resetting; 2]);
        assert_eq!(tick(&mut blind, at_ms(10_050)), (round(5, 1), Phase::Resetting), "it learns where the team is");

        let mut server = server();
        tick(&mut server, at_ms(0));
        beat(&mut server, at_ms(10), round(0, 0), [Phase::NeedReset; 2]);
        tick(&mut server, at_ms(50));
        beat(&mut server, at_ms(60), round(1, 900), [Phase::NeedReset; 2]);
        assert_eq!(tick(&mut server, at_ms(100)), (round(2, 0), Phase::Resetting), "a garbled episode is no episode");
    }

    #[test]
    fn a_missing_robot_or_one_that_gives_up_ends_the_episode() {
        let running = || {
            let mut server = server();
            tick(&mut server, at_ms(0));
            beat(&mut server, at_ms(10), round(0, 0), [Phase::NeedReset; 2]);
            tick(&mut server, at_ms(50));
            beat(&mut server, at_ms(60), round(1, 0), [Phase::FinishedResetting; 2]);
            assert_eq!(tick(&mut server, at_ms(100)).1, Phase::Running);
            server
        };
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
        let stopped = Heartbeat { robot, round: round(1, 0), phase, latch };
        server.handle(at_ms(60), In::Heartbeat(stopped), &mut Vec::new());
        let mut out = Vec::new();
        server.wake(at_ms(100), &mut out);
        assert_eq!((out[0].phase, out[0].latch), (Phase::AbortRunning, Latch::engaged(3)), "it repeats the stop");
        for ms in (150..30_000).step_by(50) {
            beat(&mut server, at_ms(ms), round(1, 0), [Phase::NeedReset; 2]);
            assert_eq!(tick(&mut server, at_ms(ms)).1, Phase::AbortRunning, "whatever the robots say, and for ever");
        }
        let rearm = |number| In::Stop(Stop { by: HostId(9), latch: Latch::armed(number) });
        server.handle(at_ms(30_000), rearm(3), &mut Vec::new());
        assert_eq!(tick(&mut server, at_ms(30_000)).1, Phase::AbortRunning, "not later than the stop");
        server.handle(at_ms(30_010), rearm(4), &mut Vec::new());
        assert_eq!(tick(&mut server, at_ms(30_050)), (round(1, 1), Phase::Resetting), "the next episode");
    }

    #[test]
    fn a_stop_before_the_team_is_together_is_told_and_held() {
        let mut server = server();
        server.handle(at_ms(0), In::Stop(Stop::engage(HostId(9), Latch::default())), &mut Vec::new());
        let mut out = Vec::new();
        server.wake(at_ms(0), &mut out);
        assert!(out[0].latch.is_engaged());
        beat(&mut server, at_ms(10), round(0, 0), [Phase::NeedReset; 2]);
        assert_eq!(tick(&mut server, at_ms(50)), (round(0, 0), Phase::NeedReset));
    }
}
