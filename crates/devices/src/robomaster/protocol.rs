//! Codec of the plaintext SDK of the RoboMaster EP: lines to the robot, and its answers, pushes, events and
//! announcements.
//!
//! A line ends with a semicolon. Lengths in m, angles in degrees; x is forward, y is right, yaw is clockwise. Sources:
//! the chapter "Plaintext Protocol" of DJI's guide (robomaster-dev.readthedocs.io), and, for what it leaves open
//! (spaces, the second semicolon of a push, answers to queries), DJI's script for the robot's side,
//! `protocal_parser.py`.

use std::fmt::Write;
use std::net::Ipv4Addr;

/// TCP port of a RoboMaster EP for commands and answers.
pub(crate) const CONTROL_PORT: u16 = 40923;
/// UDP port of the host to which a RoboMaster EP sends (pushes) its state.
pub(crate) const PUSH_PORT: u16 = 40924;
/// TCP port of a RoboMaster EP on which it reports events, such as hits on its armour.
pub(crate) const EVENT_PORT: u16 = 40925;
/// UDP port to which a RoboMaster EP on a router's network announces its address, every 2 s until a program connects.
pub(crate) const ANNOUNCEMENT_PORT: u16 = 40926;

/// Longest statement that is accepted from the robot \[bytes\]: eight times the longest line that is sent.
const LONGEST: usize = 512;
/// Largest coordinate that is accepted from the robot \[m\]: the limit of a `Reading`.
const FARTHEST_M: f64 = 1e5;
/// Largest angle that is accepted from the robot \[degrees\]: ten turns. A robot reports -180 to 180.
const LARGEST_ANGLE_DEG: f64 = 3600.0;

/// Line to the robot: one command or query of its plaintext SDK.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Line {
    /// Enters SDK mode. Outside this mode the robot ignores all other lines.
    Enter,
    /// Leaves SDK mode, the mode in which the robot obeys lines; this stops the robot.
    Quit,
    /// Lets chassis and gimbal turn independently. In its other modes, the robot ignores yaw rates.
    Free,
    /// Makes the robot send (push) its position and attitude at this rate \[Hz\], and its chassis' status at 5 Hz.
    Pushes(u8),
    /// Switches on reports of hits on the armour.
    HitEvents,
    /// Sets the velocity of the robot's chassis.
    Speed(ChassisSpeed),
    /// Stops all wheels. With speed zero instead, the robot creeps, because it controls a heading that drifts
    /// (RoboMaster-SDK#11).
    Stand,
    /// Asks for the battery's charge \[%\].
    Battery,
}

/// Velocity of a RoboMaster's chassis in its own frame: x forward, y to the right, yaw clockwise.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ChassisSpeed {
    /// Forward component \[m/s\], within +-3.5.
    pub x: f32,
    /// Component to the right \[m/s\], within +-3.5.
    pub y: f32,
    /// Yaw rate \[degrees/s\], clockwise, within +-600.
    pub z: f32,
}

impl Line {
    /// Returns the line as text, with a semicolon and the sequence number `seq`, which the robot's answer repeats.
    pub fn encode(&self, seq: u32) -> String {
        let mut line = match self {
            // The semicolon in front ends what an earlier program left unfinished: the robot keeps it, and would refuse
            // the command appended to it (RoboMaster-SDK#21).
            Line::Enter => ";command".to_owned(),
            Line::Quit => "quit".to_owned(),
            Line::Free => "robot mode free".to_owned(),
            Line::Pushes(hz) => {
                format!("chassis push position on pfreq {hz} attitude on afreq {hz} status on sfreq 5")
            }
            Line::HitEvents => "armor event hit on".to_owned(),
            Line::Speed(ChassisSpeed { x, y, z }) => {
                let [x, y] = [*x, *y].map(|speed| shortened(speed, 1e3));
                format!("chassis speed x {x:.3} y {y:.3} z {:.1}", shortened(*z, 1e1))
            }
            Line::Stand => "chassis wheel w1 0 w2 0 w3 0 w4 0".to_owned(),
            Line::Battery => "robot battery ?".to_owned(),
        };
        write!(line, " seq {seq};").expect("a string takes everything");
        line
    }
}

/// Reason why bytes from the robot are refused: they do not have the form of the plaintext SDK.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Malformed {
    /// Bytes that are not ASCII text.
    #[error("the robot's text has bytes that are not ASCII")]
    Text,
    /// A statement that is longer than the accepted length without a semicolon at its end.
    #[error("the robot's statement is too long")]
    Length,
    /// Statement with too few words, or with words in the wrong place.
    #[error("the robot's statement has words that are missing or out of place")]
    Words,
    /// A number that is missing, not finite or out of range.
    #[error("the robot's statement has a wrong number")]
    Number,
}

impl Malformed {
    /// Returns the description of the fault as text, for the output of a driver that refuses the bytes.
    pub fn reason(self) -> &'static str {
        match self {
            Malformed::Text => "the robot's text has bytes that are not ASCII",
            Malformed::Length => "the robot's statement is too long",
            Malformed::Words => "the robot's statement has words that are missing or out of place",
            Malformed::Number => "the robot's statement has a wrong number",
        }
    }
}

/// Splits the byte stream from the robot into statements, which end with a semicolon.
#[derive(Clone, Debug, Default)]
pub(crate) struct Splitter {
    rest: Vec<u8>,
    /// Whether the unfinished statement is too long; everything up to the next semicolon is dropped.
    overflowed: bool,
}

impl Splitter {
    /// Takes bytes of the stream, and calls `each` with every statement that they complete, without its semicolon, or
    /// with the reason why it is refused. Empty statements are skipped.
    pub fn take(&mut self, bytes: &[u8], mut each: impl FnMut(Result<&str, Malformed>)) {
        for &byte in bytes {
            if byte != b';' {
                if self.rest.len() < LONGEST {
                    self.rest.push(byte);
                } else {
                    self.overflowed = true;
                }
                continue;
            }
            if std::mem::take(&mut self.overflowed) {
                each(Err(Malformed::Length));
            } else {
                match text(&self.rest) {
                    Ok("") => {}
                    statement => each(statement),
                }
            }
            self.rest.clear();
        }
    }
}

/// Answer of a RoboMaster to one line, a command or query.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer<'a> {
    /// Result as text: `ok`, an error, or the values that a query asked for.
    pub result: &'a str,
    /// Sequence number of the answered line; `None` if the robot does not repeat it.
    pub seq: Option<u32>,
}

/// Decodes a statement of the control connection, without its semicolon, to the robot's answer; an error if it is
/// malformed.
pub fn decode_answer(statement: &str) -> Result<Answer<'_>, Malformed> {
    let Some((result, seq)) = statement.rsplit_once("seq ") else {
        return Ok(Answer { result: statement.trim(), seq: None });
    };
    let seq = seq.trim().parse().map_err(|_| Malformed::Number)?;
    let result = result.trim();
    if result.is_empty() { Err(Malformed::Words) } else { Ok(Answer { result, seq: Some(seq) }) }
}

impl Answer<'_> {
    /// Whether the answer says that the robot has carried out the line: `ok`, or `Already in SDK mode` where the line
    /// was to enter this mode.
    pub fn is_ok(&self) -> bool {
        self.result == "ok" || self.result == "Already in SDK mode"
    }

    /// Returns the charge of the battery \[%\]; `None` if the answer is not a charge.
    pub fn percent(&self) -> Option<u8> {
        self.result.parse().ok().filter(|percent| *percent <= 100)
    }
}

/// State of the chassis in one datagram that the robot sends unasked (a push); a value that it lacks is `None`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Push {
    /// Position since power-on \[m\]: forward and to the right of the pose at that time.
    pub position: Option<[f64; 2]>,
    /// Pitch, roll and yaw \[degrees\], yaw clockwise.
    pub attitude: Option<[f64; 3]>,
    /// Whether the robot lies on its side or back.
    pub rolled_over: Option<bool>,
    /// Reason why a value of the datagram is not used; `None` if all are. The other values count.
    pub refused: Option<Malformed>,
}

/// Number of flags in a chassis status: static, uphill, downhill, on slope, picked up, slips, hit along x, y, z, rolled
/// over, static on a slope.
const FLAGS: usize = 11;
/// Index of the flag "rolled over" among the flags of a chassis status.
const ROLLED_OVER: usize = 9;

/// Decodes a state datagram (push), which names several values after one prefix:
/// `chassis push position 1.000 2.000 ; attitude 0.100 0.200 30.000 ;;`. Pushes of other modules are skipped. A value
/// that cannot be read costs itself; an error says that nothing could be read.
pub fn decode_push(datagram: &[u8]) -> Result<Push, Malformed> {
    let mut push = Push::default();
    let mut module = None;
    for part in text(datagram)?.split(';') {
        let mut words: Vec<&str> = part.split_ascii_whitespace().collect();
        if let [name, "push", ..] = words[..] {
            module = Some(name);
            words.drain(..2);
        }
        match (module, &words[..]) {
            (_, []) => {}
            (None, _) => return Err(Malformed::Words),
            (Some("chassis"), ["position", values @ ..]) => push.position = push.value(numbers(values, FARTHEST_M)),
            (Some("chassis"), ["attitude", values @ ..]) => {
                push.attitude = push.value(numbers(values, LARGEST_ANGLE_DEG));
            }
            (Some("chassis"), ["status", values @ ..]) => {
                let flags: Option<[f64; FLAGS]> = push.value(numbers(values, 1.0));
                push.rolled_over = flags.map(|flags| flags[ROLLED_OVER] > 0.5);
            }
            (Some("chassis"), _) => drop(push.value::<0>(Err(Malformed::Words))),
            (Some(_), _) => {}
        }
    }
    match push {
        _ if module.is_none() => Err(Malformed::Words),
        Push { position: None, attitude: None, rolled_over: None, refused: Some(why) } => Err(why),
        push => Ok(push),
    }
}

impl Push {
    /// Returns the numbers of a value; `None` if they cannot be read, which is noted.
    fn value<const N: usize>(&mut self, numbers: Result<[f64; N], Malformed>) -> Option<[f64; N]> {
        numbers.map_err(|why| self.refused = Some(why)).ok()
    }
}

/// Cause of a hit on the robot's armour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hit {
    /// Hit by a gel bead.
    Bead,
    /// Hit in a collision.
    Collision,
    /// Hit by a hand.
    Hand,
}

/// Decodes a statement of the event connection: the plate that was hit, and the kind of hit. Plates are 1 to 6: rear,
/// front, left and right of the chassis, left and right of the gimbal. Returns `None` for an event that is not a hit.
pub fn decode_hit(statement: &str) -> Result<Option<(u8, Hit)>, Malformed> {
    let words: Vec<&str> = statement.split_ascii_whitespace().collect();
    match words[..] {
        ["armor", "event", "hit", plate, kind] => {
            let plate = plate.parse().ok().filter(|plate| (1..=6).contains(plate)).ok_or(Malformed::Number)?;
            let kind = match kind {
                "0" => Hit::Bead,
                "1" => Hit::Collision,
                "2" => Hit::Hand,
                _ => return Err(Malformed::Number),
            };
            Ok(Some((plate, kind)))
        }
        [_, "event", ..] => Ok(None),
        _ => Err(Malformed::Words),
    }
}

/// Decodes a datagram of the announcement port, `robot ip 192.168.1.103` with or without a semicolon, to that address.
pub fn decode_announcement(datagram: &[u8]) -> Result<Ipv4Addr, Malformed> {
    let text = text(datagram)?;
    let address = text.strip_prefix("robot ip ").ok_or(Malformed::Words)?;
    address.trim_end_matches([';', ' ']).parse().map_err(|_| Malformed::Number)
}

/// Returns the bytes as text without white space at both ends; an error if they are too long or not ASCII.
fn text(bytes: &[u8]) -> Result<&str, Malformed> {
    if bytes.len() > LONGEST {
        return Err(Malformed::Length);
    }
    match std::str::from_utf8(bytes) {
        Ok(text) if text.is_ascii() => Ok(text.trim()),
        _ => Err(Malformed::Text),
    }
}

/// Parses exactly `N` numbers from `words`; an error if their count differs or the absolute value of one exceeds
/// `most`.
fn numbers<const N: usize>(words: &[&str], most: f64) -> Result<[f64; N], Malformed> {
    let words: [&str; N] = words.try_into().map_err(|_| Malformed::Words)?;
    let mut numbers = [0.0; N];
    for (number, word) in numbers.iter_mut().zip(words) {
        *number = word.parse().ok().filter(|value: &f64| value.abs() <= most).ok_or(Malformed::Number)?;
    }
    Ok(numbers)
}

/// Returns the number with the decimals of a line, toward zero, so that what is sent is within the limits. `per_unit`
/// is 1000 for three decimals. What is within a thousandth of the last decimal is that decimal, such as the f32 of 0.7.
fn shortened(number: f32, per_unit: f64) -> f64 {
    let steps = f64::from(number) * per_unit;
    // Adding zero makes a negative zero positive.
    (steps + 1e-3 * steps.signum()).trunc() / per_unit + 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    const PUSH: &[u8] =
        b"chassis push position 1.000 -2.500 ; attitude 0.100 -0.200 30.000 ; status 1 0 0 0 0 0 0 0 0 1 0 ;;";

    #[test]
    fn lines_are_as_in_the_guide() {
        let speed = Line::Speed(ChassisSpeed { x: 0.5, y: -0.0, z: -12.34 });
        for (line, text) in [
            (Line::Enter, ";command seq 7;"),
            (Line::Quit, "quit seq 7;"),
            (Line::Free, "robot mode free seq 7;"),
            (Line::Pushes(50), "chassis push position on pfreq 50 attitude on afreq 50 status on sfreq 5 seq 7;"),
            (Line::HitEvents, "armor event hit on seq 7;"),
            (speed, "chassis speed x 0.500 y 0.000 z -12.3 seq 7;"),
            (Line::Stand, "chassis wheel w1 0 w2 0 w3 0 w4 0 seq 7;"),
            (Line::Battery, "robot battery ? seq 7;"),
        ] {
            assert_eq!(line.encode(7), text);
        }
    }

    #[test]
    fn answers_are_read_with_and_without_a_number_and_however_they_are_cut() {
        let stream =
            b"ok;ok seq 3;87  seq 4; ;Already in SDK mode seq 5;\xff;command format error: command parse error;";
        for cut in 0..=stream.len() {
            let (mut splitter, mut heard) = (Splitter::default(), Vec::new());
            for part in [&stream[..cut], &stream[cut..]] {
                splitter.take(part, |statement| {
                    let answer = statement.and_then(decode_answer);
                    heard.push(answer.map(|answer| (answer.is_ok(), answer.percent(), answer.seq)));
                });
            }
            let expected = [
                Ok((true, None, None)),
                Ok((true, None, Some(3))),
                Ok((false, Some(87), Some(4))),
                Ok((true, None, Some(5))),
                Err(Malformed::Text),
                Ok((false, None, None)),
            ];
            assert_eq!(heard, expected, "cut at {cut}");
        }
    }

    #[test]
    fn a_statement_without_an_end_takes_no_memory_and_the_next_is_read() {
        let (mut splitter, mut heard) = (Splitter::default(), Vec::new());
        (0..1000).for_each(|_| splitter.take(&[b'x'; 100], |_| panic!("no end yet")));
        assert!(splitter.rest.len() <= LONGEST);
        splitter.take(b";ok;", |statement| heard.push(statement.map(str::to_owned)));
        assert_eq!(heard, [Err(Malformed::Length), Ok("ok".to_owned())]);
    }

    #[test]
    fn pushes_are_read_together_and_alone() {
        let push = decode_push(PUSH).unwrap();
        assert_eq!(push.position, Some([1.0, -2.5]));
        assert_eq!(push.attitude, Some([0.1, -0.2, 30.0]));
        assert_eq!(push.rolled_over, Some(true));
        let alone = decode_push(b"chassis push attitude 0.1 1 3;").unwrap();
        assert_eq!(alone, Push { attitude: Some([0.1, 1.0, 3.0]), ..Push::default() });
        assert_eq!(decode_push(b"gimbal push attitude 20 10;"), Ok(Push::default()));
        let partly = b"chassis push position nan 1 ; attitude 0.1 1 3 ; speed 1 1 ; status 1 0 0 0 0 0 0 0 0 1 0 ;";
        let partly = decode_push(partly).unwrap();
        assert_eq!((partly.position, partly.attitude), (None, Some([0.1, 1.0, 3.0])), "a bad value costs itself");
        assert_eq!((partly.rolled_over, partly.refused), (Some(true), Some(Malformed::Words)));
        for (wrong, why) in [
            (&b"chassis push position nan 1;"[..], Malformed::Number),
            (b"chassis push position inf 1;", Malformed::Number),
            (b"chassis push position 1e9 1;", Malformed::Number),
            (b"chassis push position 1;", Malformed::Words),
            (b"chassis push speed 1 1;", Malformed::Words),
            (b"position 1 1;", Malformed::Words),
            (b"", Malformed::Words),
            (b"chassis push position 1 \xff;", Malformed::Text),
            (&[b' '; 600], Malformed::Length),
        ] {
            assert_eq!(decode_push(wrong), Err(why), "{}", wrong.escape_ascii());
        }
    }

    #[test]
    fn events_and_announcements_are_read() {
        assert_eq!(decode_hit("armor event hit 2 1"), Ok(Some((2, Hit::Collision))));
        assert_eq!(decode_hit("sound event applause 2"), Ok(None));
        assert_eq!(decode_hit("armor event hit 7 1"), Err(Malformed::Number));
        assert_eq!(decode_hit("ok"), Err(Malformed::Words));
        let address = Ok(Ipv4Addr::new(192, 168, 0, 115));
        assert_eq!(decode_announcement(b"robot ip 192.168.0.115"), address);
        assert_eq!(decode_announcement(b"robot ip 192.168.0.115;"), address);
        assert_eq!(decode_announcement(b"robot ip 192.168.0"), Err(Malformed::Number));
        assert_eq!(decode_announcement(b"robot"), Err(Malformed::Words));
    }

    /// Feeds bytes to all decoders. None may panic, and numbers stay within their ranges.
    fn decode_all(bytes: &[u8]) {
        if let Ok(push) = decode_push(bytes) {
            assert!(push.position.is_none_or(|p| p.iter().all(|value| value.abs() <= FARTHEST_M)));
            assert!(push.attitude.is_none_or(|a| a.iter().all(|value| value.abs() <= LARGEST_ANGLE_DEG)));
        }
        let _ = decode_announcement(bytes);
        Splitter::default().take(bytes, |statement| {
            let _ = statement.map(|statement| (decode_answer(statement).is_ok(), decode_hit(statement).is_ok()));
        });
    }

    #[test]
    fn nothing_panics_on_cut_or_changed_bytes() {
        let samples: [&[u8]; 6] = [
            PUSH,
            b"ok seq 12;",
            b"87  seq 4;",
            b"armor event hit 2 1 ;;",
            b"robot ip 192.168.0.115",
            b"command format error: seq parse error;",
        ];
        for sample in samples {
            (0..=sample.len()).for_each(|cut| decode_all(&sample[..cut]));
        }
        // A xorshift generator (Marsaglia 2003) with a fixed seed.
        let mut state = 0x9E37_79B9_7F4A_7C15_u64;
        let mut below = |limit: usize| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state % limit as u64) as usize
        };
        for _ in 0..200_000 {
            let mut bytes = samples[below(samples.len())].to_vec();
            for _ in 0..=below(4) {
                let at = below(bytes.len());
                match below(4) {
                    0 => bytes[at] ^= 1 << below(8),
                    1 => bytes[at] = b" ;.-0123456789eE\xffNn"[below(19)],
                    2 => bytes.insert(at, b"; 9-"[below(4)]),
                    _ if bytes.len() > 1 => drop(bytes.remove(at)),
                    _ => {}
                }
            }
            decode_all(&bytes);
        }
    }
}
