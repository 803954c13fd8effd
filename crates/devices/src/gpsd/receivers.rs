//! Receivers of one gpsd, told apart by the paths of their devices: which reports are of the robot's own.
//!
//! Positions of two receivers are those of two antennas, perhaps of two robots. So they are never mixed: without the
//! setting `device`, a second receiver with a fix makes all reports useless.

use murmurate::messages::ids::RobotId;
use murmurate::time::{Span, Time};

use super::report::Malformed;

/// Time without a report with a fix after which a receiver counts as gone.
const GONE: Span = Span::from_millis(2000);
/// Largest number of receivers that are told apart.
const MOST: usize = 8;

/// Receivers that one gpsd reports.
#[derive(Debug)]
pub struct Receivers {
    robot: RobotId,
    /// Path of the robot's receiver as set by the user; `None` if it is the only one of its gpsd.
    own: Option<String>,
    /// Path of each receiver with the arrival of its newest report with a fix. Reports without a path count as those of
    /// a receiver with an empty one.
    heard: Vec<(String, Time)>,
    /// Arrival of the first report with a position; `None` before.
    begun: Option<Time>,
    /// True once the receivers were named in the log because it is not clear which is the robot's.
    named: bool,
}

impl Receivers {
    /// Makes the receivers of the gpsd of `robot`, none of which was heard. `own` is the path of the robot's receiver;
    /// `None` if it is the only one.
    pub fn new(robot: RobotId, own: Option<String>) -> Receivers {
        Receivers { robot, own, heard: Vec::new(), begun: None, named: false }
    }

    /// Returns true if a report other than of a position is of the robot's receiver.
    pub(crate) fn is_own(&self, device: Option<&str>) -> bool {
        self.own.as_deref().is_none_or(|own| device == Some(own))
    }

    /// Takes note of a report of a position, with or without a fix. Returns whether it is of the robot's receiver; an
    /// error is the reason for which it cannot be said, or for which no report will be.
    pub fn take(&mut self, now: Time, device: Option<&str>, has_fix: bool) -> Result<bool, Malformed> {
        let path = device.unwrap_or_default();
        let begun = *self.begun.get_or_insert(now);
        self.heard.retain(|(_, at)| now.since(*at) < GONE);
        if has_fix || self.own.as_deref() == Some(path) {
            match self.heard.iter().position(|(known, _)| known == path) {
                Some(at) => self.heard[at].1 = now,
                None if self.heard.len() < MOST => self.heard.push((path.to_owned(), now)),
                None => {}
            }
        }
        let Some(own) = self.own.clone() else {
            if self.heard.len() > 1 {
                self.name("several receivers: name the robot's as `device`");
                return Err(Malformed("gpsd has several receivers; name the robot's as `device`"));
            }
            // Without a fix it is of interest only if no other receiver has one.
            return Ok(has_fix || self.heard.is_empty());
        };
        if own == path {
            return Ok(true);
        }
        // The robot's own may be slower than the others at first.
        if now.since(begun) >= GONE && !self.heard.iter().any(|(known, _)| *known == own) {
            self.name(&format!("no reports of `device` = '{own}'"));
            return Err(Malformed("gpsd reports other receivers than `device`; correct its path"));
        }
        Ok(false)
    }

    /// Logs which receivers gpsd has, once. Their paths come from outside, so odd characters are escaped.
    fn name(&mut self, why: &str) {
        if std::mem::replace(&mut self.named, true) {
            return;
        }
        let paths: Vec<String> = self.heard.iter().map(|(path, _)| format!("'{}'", path.escape_debug())).collect();
        let paths = if paths.is_empty() { "no other with a fix".to_owned() } else { paths.join(", ") };
        tracing::warn!("{}: gpsd has {why}; it has {paths}", self.robot);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    #[test]
    fn a_second_receiver_with_a_fix_makes_all_useless_until_it_is_gone() {
        let mut receivers = Receivers::new(RobotId(0), None);
        let mut take = |ms, path, fix| receivers.take(at_ms(ms), Some(path), fix).ok();
        assert_eq!((take(0, "a", true), take(50, "b", false)), (Some(true), Some(false)));
        assert_eq!((take(100, "b", true), take(150, "a", true)), (None, None));
        assert_eq!((take(2099, "a", true), take(2100, "a", true)), (None, Some(true)));
        assert_eq!(take(9000, "b", true), Some(true), "the receiver was plugged in anew");
        assert_eq!(take(12_000, "b", false), Some(true), "no fix of the only one");
    }

    #[test]
    fn a_path_that_no_receiver_has_is_a_reason() {
        let mut receivers = Receivers::new(RobotId(0), Some("a".to_owned()));
        for ms in (0..2000).step_by(100) {
            assert_eq!(receivers.take(at_ms(ms), Some("b"), true), Ok(false), "the own one may be slow");
        }
        assert!(receivers.take(at_ms(2000), Some("b"), true).is_err());
        assert_eq!(receivers.take(at_ms(2100), Some("a"), false), Ok(true));
        assert_eq!(receivers.take(at_ms(2200), Some("b"), true), Ok(false));
        assert!(receivers.is_own(Some("a")) && !receivers.is_own(None));
    }
}
