//! Condition of a robot's hardware, as its driver knows it: health, battery, temperature, and the reason of a fault.

use std::fmt;

use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::numbered::numbered;

/// Health of a robot's hardware: whether it follows commands, reports a fault, or does not answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "u8", from = "u8")]
pub enum Health {
    /// The hardware follows its commands.
    Ready,
    /// The hardware answers and reports a fault.
    Faulty,
    /// The hardware does not answer.
    Silent,
    /// The hardware is in a state of a later version: it may not follow its commands.
    Other = 255,
}

impl Health {
    /// All states of this version, in the order of their numbers.
    pub(crate) const ALL: [Health; 3] = [Health::Ready, Health::Faulty, Health::Silent];
}

numbered!(Health);

/// Temperature from -40 to 215 °C in whole degrees. The wire format is one byte with an offset of 40, as in SAE
/// J1939-71.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Celsius(u8);

/// Temperature that the byte 0 encodes in a message \[°C\].
const ZERO_C: i16 = -40;

impl Celsius {
    /// Rounds a temperature \[°C\] to whole degrees; `None` if `degrees` is NaN or outside -40 to 215 °C.
    pub fn of(degrees: f32) -> Option<Celsius> {
        let byte = (degrees - f32::from(ZERO_C)).round();
        (0.0..=255.0).contains(&byte).then_some(Celsius(byte as u8))
    }

    /// Returns the temperature \[°C\].
    pub fn degrees(self) -> i16 {
        i16::from(self.0) + ZERO_C
    }
}

impl fmt::Display for Celsius {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} \u{b0}C", self.degrees())
    }
}

/// Longest text of a [`Reason`] \[bytes\]: one line of a terminal.
pub(crate) const MAX_REASON: usize = 80;

/// Reason of a hardware fault in a few words: 1 to 80 (`MAX_REASON`) bytes of printable ASCII.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reason(Box<str>);

/// Text that replaces the end of a [`Reason`] that was cut because it was too long.
const CUT: &str = "...";

impl Reason {
    /// Makes a reason from `text`, without surrounding whitespace. Characters other than printable ASCII become `?`,
    /// and a text longer than `MAX_REASON` (80 bytes) is cut. Returns `None` if the text is empty.
    pub fn new(text: &str) -> Option<Reason> {
        let printable = |c: char| if c == ' ' || c.is_ascii_graphic() { c } else { '?' };
        let clean: String = text.trim().chars().take(MAX_REASON + 1).map(printable).collect();
        match clean.len() {
            0 => None,
            1..=MAX_REASON => Some(Reason(clean.into())),
            _ => Some(Reason((clean[..MAX_REASON - CUT.len()].to_owned() + CUT).into())),
        }
    }

    /// Returns the text of the reason, in printable ASCII.
    pub fn text(&self) -> &str {
        &self.0
    }

    /// Returns true if the reason is the beginning of a longer text.
    pub fn is_cut(&self) -> bool {
        self.0.ends_with(CUT)
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl Serialize for Reason {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_bytes(self.0.as_bytes())
    }
}

impl<'de> Deserialize<'de> for Reason {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Reason, D::Error> {
        struct Text;
        impl Visitor<'_> for Text {
            type Value = Reason;
            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("1 to 80 bytes of printable ASCII")
            }
            fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<Reason, E> {
                let text = std::str::from_utf8(bytes).ok();
                let reason = text.and_then(Reason::new).filter(|reason| reason.0.as_bytes() == bytes);
                reason.ok_or_else(|| E::invalid_length(bytes.len(), &self))
            }
        }
        deserializer.deserialize_bytes(Text)
    }
}

/// Condition of one robot's hardware, as reported by the robot's driver.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hardware {
    /// Whether the hardware follows commands, reports a fault, or does not answer.
    pub health: Health,
    /// Charge of the battery \[%\], 0 to 100; `None` if unknown.
    pub battery: Option<u8>,
    /// Temperature of the hottest part of the robot; `None` if unknown.
    pub temperature: Option<Celsius>,
    /// Reason for which the hardware is faulty or silent; `None` if unknown or if there is no fault.
    pub reason: Option<Reason>,
}

impl Hardware {
    /// Makes the condition of a robot with this health; battery, temperature and reason are unknown (`None`).
    pub fn of(health: Health) -> Hardware {
        Hardware { health, battery: None, temperature: None, reason: None }
    }

    /// Returns this condition with the text `reason` as the reason of the fault. An empty text sets the reason to
    /// `None`.
    pub fn because(self, reason: &str) -> Hardware {
        Hardware { reason: Reason::new(reason), ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reason_is_a_short_line_whatever_a_driver_says() {
        let text = |text: &str| Reason::new(text).map(|reason| reason.text().to_owned());
        assert_eq!(text("  bumper pressed\n").as_deref(), Some("bumper pressed"));
        assert_eq!(text("a\tb\u{1b}[31m\u{fc}").as_deref(), Some("a?b?[31m?"));
        assert_eq!((text(""), text(" \n")), (None, None));
        let long = text(&"\u{fc}".repeat(200)).unwrap();
        assert_eq!((long.len(), long.ends_with("?...")), (MAX_REASON, true));
        assert_eq!(text(&"x".repeat(80)).unwrap().len(), 80);
        assert!(!Reason::new(&"x".repeat(80)).unwrap().is_cut() && Reason::new(&"x".repeat(81)).unwrap().is_cut());
    }

    #[test]
    fn a_temperature_is_a_byte_with_an_offset() {
        let degrees = |degrees: f32| Celsius::of(degrees).map(Celsius::degrees);
        assert_eq!((degrees(21.4), degrees(-39.6), degrees(215.0)), (Some(21), Some(-40), Some(215)));
        assert_eq!((degrees(216.0), degrees(-41.0), degrees(f32::NAN)), (None, None, None));
        assert_eq!(serde_json::to_string(&Celsius::of(25.0)).unwrap(), "65");
    }
}
