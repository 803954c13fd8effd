//! Control blocks of a received datagram: reports, acknowledgements and requests of its sender, beside messages.

use super::choice::Pair;
use super::codec::{self, Content, DecodeError};
use super::parts::Lacking;
use super::report::{DatagramId, Report, read_held, read_ids};

/// Control blocks found in a received datagram: its link report, acknowledgements, requests and offers to retransmit.
#[derive(Default)]
pub(super) struct ControlBlocks {
    pub(super) report: Option<Report>,
    pub(super) held: Vec<u32>,
    pub(super) acks: Vec<DatagramId>,
    pub(super) requests: Vec<DatagramId>,
    pub(super) lacking: Vec<Lacking>,
    pub(super) pair: Option<Pair>,
    /// Number of blocks of a later version, which are passed over.
    pub(super) skipped: u64,
}

impl ControlBlocks {
    /// Reads those of a datagram without its tag. A datagram without any block is malformed.
    pub(super) fn read(plain: &[u8]) -> Result<ControlBlocks, DecodeError> {
        let (mut blocks, mut empty) = (ControlBlocks::default(), true);
        for block in codec::blocks(plain) {
            empty = false;
            match block? {
                (Content::Message(_) | Content::Signature | Content::Relayed, _) => {}
                (Content::Other(_), _) => blocks.skipped += 1,
                (content @ (Content::Report | Content::NumberedReport), body) => {
                    blocks.report = Some(Report::read(content, body)?);
                }
                // It is in a datagram of its own, without a tag.
                (Content::Roster, _) => return Err(DecodeError::Link(Content::Roster)),
                (Content::Held, body) => blocks.held.extend(read_held(body)?),
                (content @ Content::Ack, body) => blocks.acks.extend(read_ids(content, body)?),
                (Content::Lacking, _) if !blocks.lacking.is_empty() => {
                    return Err(DecodeError::Link(Content::Lacking));
                }
                (Content::Lacking, body) => blocks.lacking = Lacking::read(body)?,
                (Content::Pair, body) => blocks.pair = Some(Pair::read(body)?),
                (content @ Content::Nack, body) => blocks.requests.extend(read_ids(content, body)?),
            }
        }
        if empty { Err(DecodeError::Blocks) } else { Ok(blocks) }
    }
}
