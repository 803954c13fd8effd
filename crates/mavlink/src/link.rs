//! Packets between the parts without I/O and their worker, encoded as bytes so that they can be recorded and replayed.
//! They contain no key and no signature that counts: the worker signs, and checks signatures.

use murmurate::edge::Packet;
pub use murmurate::edge::hold::Hold;

/// Packet of a driver to its worker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ToWorker<'a> {
    /// Frames to send, of MAVLink 2, unsigned. The worker gives them numbers, and its own version and signature.
    Send(Hold, &'a [u8]),
    /// Frame that makes the vehicle stand, for when the validity of a motion ends.
    Stand(&'a [u8]),
}

/// Reason for which the worker has refused frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// They have no signature, and the link is signed.
    Unsigned,
    /// Their signature is of another key.
    Forged,
    /// Their signature is of the link's key, and was used before or is more than a minute old.
    Stale,
    /// They are signed, and the link is not.
    Signed,
    /// Their checksum is wrong.
    Damaged,
    /// They are of a second autopilot with the same number, at another address.
    Second,
}

/// All reasons, by their numbers in a packet.
pub const REFUSALS: [Refusal; 6] =
    [Refusal::Unsigned, Refusal::Forged, Refusal::Stale, Refusal::Signed, Refusal::Damaged, Refusal::Second];

impl Refusal {
    /// Returns the reason in words, for a log line that counts them.
    pub fn why(self) -> &'static str {
        match self {
            Refusal::Unsigned => "a frame is unsigned on a signed link; set the key on the autopilot, too",
            Refusal::Forged => "a frame is signed by another key; give both sides the same",
            Refusal::Stale => "a frame has a signature that was used before, or is more than a minute old",
            Refusal::Signed => "its frames are signed; give its key as `signing_key_file`",
            Refusal::Damaged => "bytes are no whole frame of MAVLink",
            Refusal::Second => "a second autopilot has the same `system`, at another address; give each its own",
        }
    }
}

/// Packet of a worker to its driver or source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FromWorker<'a> {
    /// Whole frames of the autopilot, as received.
    Frames(&'a [u8]),
    /// Frames were refused, for this reason.
    Refused(Refusal),
    /// The link is open.
    Opened,
    /// The link cannot be opened or is lost. The bytes are the reason as text.
    Closed(&'a [u8]),
}

impl ToWorker<'_> {
    /// Returns the packet as bytes.
    pub fn encode(&self) -> Packet {
        match self {
            ToWorker::Send(hold, frames) => [b"W", &hold.to_bytes()[..], frames].concat().into(),
            ToWorker::Stand(frame) => [b"S", *frame].concat().into(),
        }
    }

    /// Decodes a packet; `None` if the bytes are not one.
    pub fn decode(packet: &[u8]) -> Option<ToWorker<'_>> {
        let (tag, rest) = packet.split_first()?;
        match tag {
            b'W' => {
                let (hold, frames) = rest.split_first_chunk()?;
                let hold = Hold::from_bytes(*hold);
                Some(ToWorker::Send(hold, frames))
            }
            b'S' => Some(ToWorker::Stand(rest)),
            _ => None,
        }
    }
}

impl FromWorker<'_> {
    /// Returns the packet as bytes.
    pub fn encode(&self) -> Packet {
        match self {
            FromWorker::Frames(frames) => [b"F", *frames].concat().into(),
            FromWorker::Refused(why) => {
                let number = REFUSALS.iter().position(|one| one == why).expect("all are in the table");
                Box::new([b'R', number as u8])
            }
            FromWorker::Opened => Box::new([b'O']),
            FromWorker::Closed(why) => [b"X", *why].concat().into(),
        }
    }

    /// Decodes a packet; `None` if the bytes are not one.
    pub fn decode(packet: &[u8]) -> Option<FromWorker<'_>> {
        match packet {
            [b'F', frames @ ..] => Some(FromWorker::Frames(frames)),
            [b'R', number] => REFUSALS.get(usize::from(*number)).map(|why| FromWorker::Refused(*why)),
            [b'O'] => Some(FromWorker::Opened),
            [b'X', why @ ..] => Some(FromWorker::Closed(why)),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::time::Span;

    #[test]
    fn packets_are_read_back_and_others_are_refused() {
        for hold in [Hold::Keep, Hold::Standing, Hold::For(Span::from_millis(200))] {
            let packet = ToWorker::Send(hold, b"frames");
            assert_eq!(ToWorker::decode(&packet.encode()), Some(packet));
        }
        assert_eq!(ToWorker::decode(&ToWorker::Stand(b"frame").encode()), Some(ToWorker::Stand(b"frame")));
        let refused = REFUSALS.map(FromWorker::Refused);
        let all = [FromWorker::Frames(b"frames"), FromWorker::Opened, FromWorker::Closed(b"no device")];
        for packet in all.into_iter().chain(refused) {
            assert_eq!(FromWorker::decode(&packet.encode()), Some(packet));
        }
        for odd in [&b""[..], b"R", b"R\xff", b"O1", b"Z"] {
            assert_eq!(FromWorker::decode(odd), None);
        }
        assert_eq!((ToWorker::decode(b"W123"), ToWorker::decode(b"")), (None, None));
    }
}
