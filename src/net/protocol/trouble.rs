//! The cause of a tag that is not valid: another key, none, or only one of two hosts encrypts.

use super::codec::{self, Flags};
use super::counts::Refusal;
use super::key::Key;
use super::link::LinkState;

impl LinkState {
    /// Returns what is wrong with the key of a datagram that a host of this team seems to have sent: that host and this
    /// one have two keys, or one key, or only one encrypts. The header is not authenticated, so it is only counted.
    #[cold]
    pub(super) fn key_trouble(&self, frame: &[u8]) -> Option<Refusal> {
        let header = codec::peek(frame).ok()?;
        if header.team != self.me.team || header.sender >= self.first_guest || header.sender == self.me.host {
            return None;
        }
        let unlike = |key: &Key| key.is_confidential() != header.flags.has(Flags::ENCRYPTED);
        Some(match (&self.key, header.flags.has(Flags::TAGGED)) {
            (Some(key), true) if unlike(key) => Refusal::Confidential,
            (Some(_), true) => Refusal::OtherKey,
            (Some(_), false) => Refusal::Untagged,
            (None, _) => Refusal::Keyed,
        })
    }
}
