//! Commands that a browser sends to the process that serves the live page.

use serde::Deserialize;

use murmurate::faults::Role;
use murmurate::messages::ids::RobotId;

/// Largest message accepted from a browser \[bytes\].
pub const MAX_BYTES: usize = 4096;
/// Largest delay that the live page may add to a link \[ms\].
pub const MAX_DELAY_MS: f64 = 5000.0;
/// Largest time in a record to which a page may jump \[s\]: a year.
const MAX_SEEK_S: f64 = 366.0 * 86_400.0;
/// Largest length of a link's name in a command \[bytes\].
const MAX_NAME: usize = 64;

/// Command that a browser with the live page sends to the process that runs, watches or replays the team.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "do", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Command {
    /// Engages the emergency stop of the team.
    Stop,
    /// Re-arms the team after an emergency stop; its robots stand until it is resumed.
    Rearm,
    /// Resumes a team that is held (stands after a re-arm) or paused.
    Resume,
    /// Pauses the team: after the current episode it stands until it is resumed.
    Pause,
    /// Crashes an actor of a robot, which is then down until `Restart`. Only in an emulated team.
    Kill {
        /// Role of the actor, such as agent or body.
        role: Role,
        /// Robot that the actor belongs to.
        robot: RobotId,
    },
    /// Restarts an actor that was crashed by `Kill`. Only in an emulated team.
    Restart {
        /// Role of the actor, such as agent or body.
        role: Role,
        /// Robot that the actor belongs to.
        robot: RobotId,
    },
    /// Sets the faults of a link, in addition to those of the deployment. Only in an emulated team.
    Link {
        /// Name of the link.
        link: String,
        /// Whether the link loses every frame.
        cut: bool,
        /// Delay that is added to every frame \[ms\].
        delay_ms: f64,
        /// Probability, 0 to 1, that a frame is lost.
        loss: f64,
    },
    /// Runs or halts the playback of a record.
    Play {
        /// Whether the playback runs.
        on: bool,
        /// Playback speed: seconds of the record for each second of real time, 0.01 to 100.
        rate: f64,
    },
    /// Jumps to another time of a record.
    Seek {
        /// Time since the start of the record \[s\].
        at_s: f64,
    },
    /// Jumps to the next or previous change of the robots' states in a record, and halts there.
    Step {
        /// Whether to jump to the previous change instead of the next.
        back: bool,
    },
}

/// Permission that a command of a browser needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Right {
    /// No permission: every browser that can open the page may give the command.
    Anyone,
    /// The browser has sent the page's token, and the process accepts orders to the team.
    Control,
    /// The browser has sent the page's token, the process accepts orders to the team, and the team is emulated.
    Emulation,
    /// The browser has sent the page's token, and the process plays a record.
    Playback,
}

impl Command {
    /// Parses a browser's message and checks the ranges of its numbers. The error is a text for the user.
    pub fn parse(text: &str) -> Result<Command, String> {
        let command: Command = serde_json::from_str(text).map_err(|error| format!("no command: {error}"))?;
        if let Command::Link { link, delay_ms, loss, .. } = &command {
            if link.len() > MAX_NAME {
                return Err("no command: the name of the link is too long".to_owned());
            }
            if !(0.0..=MAX_DELAY_MS).contains(delay_ms) || !(0.0..=1.0).contains(loss) {
                return Err(format!("no command: delay is 0 to {MAX_DELAY_MS} ms, loss 0 to 1"));
            }
        }
        match command {
            Command::Play { rate, .. } if !(0.01..=100.0).contains(&rate) => {
                Err("no command: the rate is 0.01 to 100".to_owned())
            }
            Command::Seek { at_s } if !(0.0..=MAX_SEEK_S).contains(&at_s) => {
                Err("no command: this time is in no record".to_owned())
            }
            command => Ok(command),
        }
    }

    /// Returns the permission that the command needs.
    pub fn right(&self) -> Right {
        match self {
            Command::Stop => Right::Anyone,
            Command::Rearm | Command::Resume | Command::Pause => Right::Control,
            Command::Kill { .. } | Command::Restart { .. } | Command::Link { .. } => Right::Emulation,
            Command::Play { .. } | Command::Seek { .. } | Command::Step { .. } => Right::Playback,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_read_and_everything_else_is_refused() {
        assert_eq!(Command::parse(r#"{"do":"stop"}"#), Ok(Command::Stop));
        let kill = r#"{"do":"kill","role":"state-server","robot":3}"#;
        assert_eq!(Command::parse(kill), Ok(Command::Kill { role: Role::StateServer, robot: RobotId(3) }));
        let cut = Command::parse(r#"{"do":"link","link":"air","cut":true,"delay_ms":20,"loss":0.5}"#).unwrap();
        assert_eq!((cut.right(), Command::Stop.right()), (Right::Emulation, Right::Anyone));
        for wrong in [
            "",
            "stop",
            "[]",
            r#"{"do":"halt"}"#,
            r#"{"do":"kill","role":"cache"}"#,
            r#"{"do":"kill","role":"cache","robot":-1}"#,
            r#"{"do":"link","link":"air","cut":true,"delay_ms":1e9,"loss":0.5}"#,
            r#"{"do":"link","link":"air","cut":true,"delay_ms":0,"loss":null}"#,
            r#"{"do":"play","on":true,"rate":0}"#,
            r#"{"do":"seek","at_s":-1}"#,
            r#"{"do":"seek","at_s":null}"#,
        ] {
            assert!(Command::parse(wrong).is_err(), "{wrong}");
        }
    }
}
