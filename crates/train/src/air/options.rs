//! Options of the air between the robots of many teams, with their checks.

use serde::{Deserialize, Serialize};

use murmurate::config::{ConfigError, in_range};
use murmurate::net::media::radio::Radio;
use murmurate::time::Span;

/// Largest number of periods for which a message is held.
const MOST_PERIODS: f64 = 1000.0;
/// Longest time for which messages of robots on a radio channel wait there \[s\], in multiples of the mean for an
/// exponentially distributed delay. Of what takes longer, which six of a million such delays do, nothing is kept.
const LONGEST_ON_RADIO_S: f64 = 2.0;
const LONGEST_TAIL: f64 = 12.0;

/// Options of the air between the robots of many teams.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Options {
    /// Number N of environments.
    #[serde(rename = "num_envs")]
    pub environments: usize,
    /// Number R of robots in each environment.
    #[serde(rename = "num_robots")]
    pub robots: usize,
    /// Number M of floats of a message; 0 if the caller keeps contents itself.
    #[serde(rename = "content")]
    pub floats: usize,
    /// Number of threads that advance environments.
    pub threads: usize,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Duration of a step \[s\].
    pub period_s: f64,
    /// Longest time after the beginning of a step at which a robot sends \[s\]. Each robot has its own, drawn for each
    /// episode; 0: all send at once.
    pub spread_s: f64,
    /// Age up to which a message counts \[s\], from when it has arrived, as robots count it: they know no other clock
    /// but their own.
    pub hold_s: f64,
    /// Distance up to which robots hear each other when a message is sent \[m\]; `None` for any.
    pub range_m: Option<f32>,
    /// Probability that a receiver loses a message, 0 to 1, independently of others.
    pub loss: f64,
    /// Times in which a receiver hears nothing of a sender; `None` for none.
    pub bursts: Option<Bursts>,
    /// Least and largest delay of a message \[s\], drawn for each receiver.
    pub delay_s: [f64; 2],
    /// Mean of an exponentially distributed part of the delay \[s\], in addition.
    pub tail_s: f64,
    /// Radio channel that the robots of an environment share; loss and delay act on what has come through it.
    pub radio: Option<Radio>,
}

/// Loss in bursts (Gilbert, Bell System Technical Journal 39, 1960; Elliott, 42, 1963): from each sender to each
/// receiver there are good times, and bad ones in which nothing arrives. Both are distributed geometrically over steps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bursts {
    /// Share of bad times, 0 to below 1.
    pub share: f64,
    /// Mean duration of a bad time \[s\], at least a period.
    pub mean_s: f64,
}

impl Bursts {
    /// Returns the probabilities that a bad time begins, and that it ends, in a step of `period_s` \[s\].
    pub(super) fn turns(self, period_s: f64) -> [f64; 2] {
        let end = period_s / self.mean_s;
        [end * self.share / (1.0 - self.share), end]
    }
}

impl Options {
    /// Checks all options. The error names the first wrong one.
    ///
    /// # Errors
    /// If a number is out of its range, or the radio is wrong.
    pub fn check(&self) -> Result<(), ConfigError> {
        in_range("num_envs", self.environments as f64, (1.0, 1e6))?;
        in_range("num_robots", self.robots as f64, (1.0, 1000.0))?;
        in_range("content", self.floats as f64, (0.0, 65_536.0))?;
        in_range("period_s", self.period_s, (1e-4, 3600.0))?;
        in_range("spread_s", self.spread_s, (0.0, self.period_s))?;
        in_range("hold_s", self.hold_s, (self.period_s, MOST_PERIODS * self.period_s))?;
        if let Some(range_m) = self.range_m {
            in_range("range_m", f64::from(range_m), (0.0, 1e9))?;
        }
        in_range("loss", self.loss, (0.0, 1.0))?;
        let [low, high] = self.delay_s;
        in_range("delay_s", high, (0.0, MOST_PERIODS * self.period_s))?;
        in_range("delay_s", low, (0.0, high))?;
        in_range("tail_s", self.tail_s, (0.0, MOST_PERIODS * self.period_s))?;
        if let Some(bursts) = self.bursts {
            in_range("burst_share", bursts.share, (0.0, 0.99))?;
            in_range("burst_s", bursts.mean_s, (self.period_s, 3600.0))?;
            let [begin, _] = bursts.turns(self.period_s);
            if begin > 1.0 {
                let why = "good times would be shorter than a step; make it smaller, or burst_s longer";
                return Err(ConfigError::field("burst_share", why));
            }
        }
        self.radio.as_ref().map_or(Ok(()), |radio| radio.check().map_err(|error| error.within("radio")))
    }

    /// Returns about how much memory the air needs \[bytes\].
    pub fn memory_bytes(&self) -> u64 {
        let (robots, floats) = (self.robots as u64, self.floats as u64);
        let edges = robots * robots;
        let radio = match &self.radio {
            None => 0,
            // With space, each station has a view of its own and knows its paths to all others.
            Some(radio) if radio.has_space() => 3000 + 900 * robots + 80 * edges,
            Some(_) => 2000 + 600 * robots,
        };
        // Buffers, what is held, and one message on its way for each edge.
        let row = edges * (9 + 4 * floats + 13 + 24) + 4 * self.memory() as u64 * robots * floats;
        self.environments as u64 * (500 + 20 * robots + radio + row)
    }

    /// Returns whether anything depends on the positions of the robots.
    pub fn needs_positions(&self) -> bool {
        self.range_m.is_some() || self.radio.as_ref().is_some_and(Radio::needs_positions)
    }

    /// Returns the duration of a step.
    pub(super) fn period(&self) -> Span {
        Span::from_secs(self.period_s)
    }

    /// Returns the number of newest steps whose messages may still count at the end of a step: messages are on their
    /// way first, and are held then.
    pub fn memory(&self) -> usize {
        let on_radio_s = if self.radio.is_some() { LONGEST_ON_RADIO_S } else { 0.0 };
        let way_s = on_radio_s + self.delay_s[1] + LONGEST_TAIL * self.tail_s;
        ((way_s + self.hold_s) / self.period_s).ceil() as usize + 1
    }
}
