//! Player of a record: keeps the shown time and the state of the team at that time, and executes the page's commands.
//! The code is pure.

use std::cell::RefCell;
use std::rc::Rc;

use super::command::Command;
use super::status::Playback;
use super::team_view::TeamView;
use super::timeline::Timeline;
use murmurate::time::{Span, Time};

/// Player of a record: the current time, and the state of the team at that time.
pub struct Player {
    timeline: Timeline,
    view: Rc<RefCell<TeamView>>,
    /// Number of events of the record that are included in the shown state.
    taken: usize,
    now: Time,
    playing: bool,
    /// Playback speed: seconds of the record for each second of real time.
    rate: f64,
}

impl Player {
    /// Returns a player that begins at the start of a record and runs.
    pub fn new(timeline: Timeline) -> Player {
        let (view, taken) = timeline.picture(Time::ZERO);
        Player { timeline, view: Rc::new(RefCell::new(view)), taken, now: Time::ZERO, playing: true, rate: 1.0 }
    }

    /// Returns the state of the team, which the player updates.
    pub fn view(&self) -> Rc<RefCell<TeamView>> {
        Rc::clone(&self.view)
    }

    /// Returns the time of the record that is shown.
    pub fn now(&self) -> Time {
        self.now
    }

    /// Returns the state of the playback: whether the player runs, and its rate.
    pub fn playback(&self) -> Playback {
        Playback { playing: self.playing, rate: self.rate }
    }

    /// Advances a running player by `seconds` of real time \[s\]. It halts at the end of the record.
    pub fn pass(&mut self, seconds: f64) {
        if self.playing {
            let to = (self.now + Span::from_secs(seconds * self.rate)).min(self.timeline.end());
            self.timeline.advance(&mut self.view.borrow_mut(), &mut self.taken, to);
            self.playing = to < self.timeline.end();
            self.now = to;
        }
    }

    /// Executes a command of a page. Returns whether the player has jumped to another time.
    pub fn take(&mut self, command: &Command) -> bool {
        match command {
            Command::Play { on, rate } => {
                let again = *on && !self.playing && self.now >= self.timeline.end();
                if again {
                    self.show(Time::ZERO);
                }
                (self.playing, self.rate) = (*on, *rate);
                again
            }
            Command::Seek { at_s } => {
                self.show(Time::ZERO + Span::from_secs(*at_s));
                true
            }
            Command::Step { back } => {
                self.playing = false;
                self.show(self.timeline.step(self.now, *back));
                true
            }
            // Not reached: these commands are refused before, because there is no team.
            _ => false,
        }
    }

    /// Jumps to a time of the record and shows the team's state at that time.
    fn show(&mut self, at: Time) {
        self.now = at.min(self.timeline.end());
        let (view, taken) = self.timeline.picture(self.now);
        (*self.view.borrow_mut(), self.taken) = (view, taken);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::status::Scene;
    use crate::timeline::Sight;
    use murmurate::messages::ids::RobotId;

    fn at(s: f64) -> Time {
        Time::ZERO + Span::from_secs(s)
    }

    /// A player of a record in which the battery of robot 0 is reported each second from 0 to 4.
    fn player() -> Player {
        let view = TeamView::new(Scene { robots: 1, ..Scene::default() }, Vec::new(), 1);
        let sights = (0..5u8).map(|second| (at(f64::from(second)), Sight::Battery(RobotId(0), 90 - second)));
        Player::new(Timeline::new(view, sights.collect()))
    }

    #[test]
    fn time_passes_at_the_rate_until_the_end_and_begins_again_there() {
        let mut player = player();
        player.pass(0.5);
        assert_eq!((player.now(), player.taken), (at(0.5), 1));
        assert!(!player.take(&Command::Play { on: true, rate: 4.0 }));
        player.pass(0.5);
        assert_eq!((player.now(), player.taken), (at(2.5), 3));
        player.pass(10.0);
        assert_eq!((player.now(), player.playback().playing), (at(4.0), false));
        player.pass(1.0);
        assert_eq!(player.now(), at(4.0), "it has halted");
        assert!(player.take(&Command::Play { on: true, rate: 1.0 }), "it begins again");
        assert_eq!((player.now(), player.taken, player.playback().playing), (at(0.0), 1, true));
    }

    #[test]
    fn a_jump_shows_the_state_of_its_time_and_not_beyond_the_end() {
        let mut player = player();
        assert!(player.take(&Command::Seek { at_s: 3.5 }));
        assert_eq!((player.now(), player.taken, player.playback().playing), (at(3.5), 4, true));
        player.take(&Command::Seek { at_s: 99.0 });
        assert_eq!((player.now(), player.taken), (at(4.0), 5));
        player.take(&Command::Seek { at_s: 0.0 });
        assert!(player.take(&Command::Step { back: true }));
        assert_eq!((player.now(), player.playback().playing), (at(0.0), false));
        player.pass(1.0);
        assert_eq!(player.now(), at(0.0));
    }
}
