//! Packets between the driver, which does no I/O, and its worker, as bytes that can be recorded and replayed. This is
//! the seam under which any carrier of CRTP fits.

use murmurate::edge::Packet as Bytes;
use murmurate::time::Span;

/// Packet of the driver for its worker.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ToWorker<'a> {
    /// Time for which the robot may fly without a newer packet; then the worker itself makes it land, as when the
    /// control thread hangs. Zero for a robot on the ground.
    pub hold: Span,
    /// Time that such a landing takes.
    pub landing: Span,
    /// Packet of CRTP for the robot; empty if only the time is new.
    pub crtp: &'a [u8],
}

/// Packet of the worker for the driver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FromWorker<'a> {
    /// Packet of CRTP of the robot.
    Crtp(&'a [u8]),
    /// The link carries nothing; the bytes are the reason as text.
    Failed(&'a [u8]),
}

impl<'a> ToWorker<'a> {
    /// Returns the packet as bytes.
    pub fn encode(&self) -> Bytes {
        let ms = |span: Span| (span.as_nanos() / 1_000_000).min(u64::from(u16::MAX)) as u16;
        [&ms(self.hold).to_le_bytes()[..], &ms(self.landing).to_le_bytes(), self.crtp].concat().into()
    }

    /// Decodes a packet; `None` if the bytes are not one.
    pub fn decode(bytes: &'a [u8]) -> Option<ToWorker<'a>> {
        let (hold, bytes) = bytes.split_first_chunk()?;
        let (landing, crtp) = bytes.split_first_chunk()?;
        let span = |bytes: [u8; 2]| Span::from_millis(u16::from_le_bytes(bytes).into());
        Some(ToWorker { hold: span(*hold), landing: span(*landing), crtp })
    }
}

impl<'a> FromWorker<'a> {
    /// Returns the packet as bytes.
    pub fn encode(&self) -> Bytes {
        match self {
            FromWorker::Crtp(bytes) => [b"C", *bytes].concat().into(),
            FromWorker::Failed(why) => [b"F", *why].concat().into(),
        }
    }

    /// Decodes a packet; `None` if the bytes are not one.
    pub fn decode(bytes: &'a [u8]) -> Option<FromWorker<'a>> {
        match bytes {
            [b'C', bytes @ ..] => Some(FromWorker::Crtp(bytes)),
            [b'F', why @ ..] => Some(FromWorker::Failed(why)),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packets_are_read_back_and_cut_ones_are_refused() {
        let packet = ToWorker { hold: Span::from_millis(400), landing: Span::from_millis(2000), crtp: &[0x7c, 1, 2] };
        let bytes = packet.encode();
        assert_eq!(ToWorker::decode(&bytes), Some(packet));
        (0..4).for_each(|cut| assert_eq!(ToWorker::decode(&bytes[..cut]), None, "{cut}"));
        for packet in [FromWorker::Crtp(&[1, 2, 3]), FromWorker::Failed(b"refused")] {
            assert_eq!(FromWorker::decode(&packet.encode()), Some(packet));
        }
        assert_eq!((FromWorker::decode(b""), FromWorker::decode(b"Z1")), (None, None));
    }
}
