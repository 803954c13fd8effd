//! Signatures of MAVLink 2: the key of a link, stamps that only grow, and what is refused. Time is an argument.

use std::collections::BTreeMap;
use std::fmt;

use data_encoding::HEXLOWER_PERMISSIVE;
use mavlink::MAVLinkV2MessageRaw;

/// Flag of signed frames among the flags of a frame of MAVLink 2 that a receiver has to know.
pub const SIGNED: u8 = 0x01;
/// Length of a key \[bytes\] (MAVLink guide, "Message Signing").
const KEY: usize = 32;
/// Longest time by which the first stamp of a sender may be behind this host's, in units of 10 us: a minute (MAVLink
/// guide, "Accepting Signed Packets").
const BEHIND: u64 = 60 * 100_000;
/// Number of this host's link, which is a part of each signature. Senders with several links count their stamps by it.
const LINK: u8 = 0;
/// Largest number of senders whose stamps are kept. Only those with the key get there.
const SENDERS: usize = 64;

/// Secret key of a link. It is never shown.
#[derive(Clone, PartialEq, Eq)]
pub struct Key([u8; KEY]);

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Key(..)")
    }
}

impl Key {
    /// Reads a key from the text of its file: 64 hexadecimal digits, with white space around them. The error does not
    /// quote the text.
    pub fn read(text: &[u8]) -> Result<Key, String> {
        let wrong = || "it has not 64 hexadecimal digits, as `murmurate key new --out FILE` writes them".to_owned();
        let bytes = HEXLOWER_PERMISSIVE.decode(text.trim_ascii()).map_err(|_| wrong())?;
        bytes.try_into().map(Key).map_err(|_| wrong())
    }
}

/// Reason for which a frame is refused on a signed link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unsound {
    /// The frame has no signature.
    Unsigned,
    /// The signature is not of this link's key.
    Forged,
    /// The signature is of this link's key, and its stamp is not later than one before, or more than a minute behind.
    Stale,
}

/// Signatures of one link: signs what is sent, and judges what is received.
#[derive(Clone, Debug)]
pub struct Signer {
    key: Key,
    /// Last stamp that was used or seen, in units of 10 us since the year 2015.
    stamp: u64,
    /// Last stamp of each sender, by its link, system and component.
    senders: BTreeMap<(u8, u8, u8), u64>,
}

impl Signer {
    /// Makes the signer of a link that has neither sent nor received.
    pub fn new(key: Key) -> Signer {
        Signer { key, stamp: 0, senders: BTreeMap::new() }
    }

    /// Signs a frame that has the flag of signed frames. `now` is the time since the beginning of 2015 in units of
    /// 10 us.
    pub fn sign(&mut self, now: u64, frame: &mut MAVLinkV2MessageRaw) {
        self.stamp = now.max(self.stamp + 1);
        frame.signature_timestamp_bytes_mut().copy_from_slice(&self.stamp.to_le_bytes()[..6]);
        *frame.signature_link_id_mut() = LINK;
        let mut value = [0; 6];
        frame.calculate_signature(&self.key.0, &mut value);
        frame.signature_value_mut().copy_from_slice(&value);
    }

    /// Checks a frame of MAVLink 2 that was received at `now`, in units of 10 us since the beginning of 2015.
    pub fn check(&mut self, now: u64, frame: &MAVLinkV2MessageRaw) -> Result<(), Unsound> {
        if frame.incompatibility_flags() & SIGNED == 0 {
            return Err(Unsound::Unsigned);
        }
        let mut value = [0; 6];
        frame.calculate_signature(&self.key.0, &mut value);
        if value != frame.signature_value() {
            return Err(Unsound::Forged);
        }
        let system = u8::try_from(frame.system_id()).unwrap_or_default();
        let (sender, stamp) = ((frame.signature_link_id(), system, frame.component_id()), frame.signature_timestamp());
        self.stamp = self.stamp.max(now);
        let stale = match self.senders.get(&sender) {
            Some(last) => stamp <= *last,
            None => stamp.saturating_add(BEHIND) < self.stamp || self.senders.len() >= SENDERS,
        };
        if stale {
            return Err(Unsound::Stale);
        }
        self.senders.insert(sender, stamp);
        self.stamp = self.stamp.max(stamp);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::{Framer, parse, raw};
    use mavlink::dialects::common::{HEARTBEAT_DATA, MavMessage};

    /// Time of a test, in units of 10 us.
    const NOW: u64 = 37_000_000_000_000;

    fn signed(key: &Key, at: u64) -> Vec<u8> {
        let mut framer = Framer::signed(7, 1, Signer::new(key.clone()));
        framer.frame(at, &MavMessage::HEARTBEAT(HEARTBEAT_DATA::default()))
    }

    #[test]
    fn a_signed_frame_is_accepted_once_and_no_earlier_one_after_it() {
        let key = Key::read(&[b'a'; 64]).expect("a key");
        let (first, second) = (signed(&key, NOW), signed(&key, NOW + 10));
        let mut signer = Signer::new(key);
        assert!(parse(&first).is_ok());
        assert_eq!(signer.check(NOW, &raw(&second)), Ok(()));
        assert_eq!(signer.check(NOW, &raw(&second)), Err(Unsound::Stale), "a copy");
        assert_eq!(signer.check(NOW, &raw(&first)), Err(Unsound::Stale), "an earlier one");
    }

    #[test]
    fn another_key_a_changed_frame_and_an_old_one_are_refused() {
        let [key, other] = [b'a', b'b'].map(|digit| Key::read(&[digit; 64]).expect("a key"));
        let mut signer = Signer::new(key.clone());
        assert_eq!(signer.check(NOW, &raw(&signed(&other, NOW))), Err(Unsound::Forged));
        let frame = signed(&key, NOW);
        for at in 1..frame.len() {
            let mut changed = frame.clone();
            changed[at] ^= 1;
            let judged = signer.clone().check(NOW, &raw(&changed));
            assert!(matches!(judged, Err(Unsound::Forged | Unsound::Unsigned)), "byte {at}: {judged:?}");
        }
        assert_eq!(signer.check(NOW + BEHIND + 1, &raw(&frame)), Err(Unsound::Stale), "of more than a minute ago");
        let mut framer = Framer::new(7, 1, crate::frames::Version::Two);
        let unsigned = framer.frame(0, &MavMessage::HEARTBEAT(HEARTBEAT_DATA::default()));
        assert_eq!(signer.check(NOW, &raw(&unsigned)), Err(Unsound::Unsigned));
    }

    #[test]
    fn stamps_grow_when_the_clock_is_set_back() {
        let key = Key::read(&[b'a'; 64]).expect("a key");
        let mut framer = Framer::signed(7, 1, Signer::new(key.clone()));
        let mut signer = Signer::new(key);
        for now in [NOW, NOW, NOW - 500, NOW + 3] {
            let frame = framer.frame(now, &MavMessage::HEARTBEAT(HEARTBEAT_DATA::default()));
            assert_eq!(signer.check(NOW, &raw(&frame)), Ok(()), "{now}");
        }
    }

    #[test]
    fn a_key_has_64_digits_and_is_not_shown() {
        let key = Key::read(format!(" {}\n", "0f".repeat(32)).as_bytes()).expect("a key");
        assert_eq!(format!("{key:?}"), "Key(..)");
        for wrong in ["", "0f", &"0f".repeat(33), &"0g".repeat(32)] {
            let error = Key::read(wrong.as_bytes()).expect_err(wrong);
            assert!(error.contains("64 hexadecimal") && (wrong.is_empty() || !error.contains(wrong)), "{error}");
        }
    }
}
