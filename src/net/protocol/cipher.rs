//! Encryption of datagrams, for teams that ask for confidentiality. No other module encrypts.
//!
//! The header stays in clear, for the filter of the kernel and the choice of the sender's key. The blocks after it
//! are encrypted by XChaCha20-Poly1305 (RFC 8439; draft-irtf-cfrg-xchacha-03), and followed by 16 bytes of the nonce
//! and the tag of that cipher, which covers the header, the link and the receiver, too.
//!
//! A nonce is made from what it encrypts, as in RFC 8452: 16 bytes are a keyed hash of the datagram in clear, its link
//! and its receiver, the other 8 are its incarnation and its sequence number. So equal nonces mean equal datagrams, of
//! which nothing is learned but that they are equal. That holds over retransmissions, wrapped numbers, restarts and two
//! runs with one incarnation, without a random number and without anything kept on disk, and a replay makes the same
//! bytes again.

use chacha20poly1305::{AeadInOut, KeyInit, XChaCha20Poly1305, XNonce};

use super::codec::{FLAGS_AT, Flags, HEADER_BYTES, TAG_BYTES};

/// Length of the part of a nonce that a datagram has after its encrypted blocks \[bytes\].
const SENT_BYTES: usize = 16;
/// Number of bytes by which a datagram becomes longer when it is encrypted: a part of the nonce, and the cipher's tag.
pub const ENCRYPTION_BYTES: usize = SENT_BYTES + TAG_BYTES;

/// Length of what a datagram is authenticated with and does not contain, the id of the link and that of the receiver
/// \[bytes\].
pub const ASSOCIATED_BYTES: usize = 4;
/// Link and receiver of a datagram.
pub type Associated = [u8; ASSOCIATED_BYTES];

/// Context strings for the derivation of the key of the cipher and that of the nonces, each unique to it.
const OF_BLOCKS: &str = "murmurate 2026-11-28 encryption of the blocks of datagrams";
const OF_NONCES: &str = "murmurate 2026-11-28 nonces of encrypted datagrams";

/// Cipher of the datagrams between those who have one key.
#[derive(Clone)]
pub struct Cipher {
    blocks: XChaCha20Poly1305,
    nonces: [u8; 32],
}

impl Cipher {
    /// Returns the cipher of the key `key`. Its own keys are derived from that, so tags of datagrams in clear reveal
    /// nothing about them.
    pub fn new(key: &[u8; 32]) -> Cipher {
        let blocks = XChaCha20Poly1305::new(&blake3::derive_key(OF_BLOCKS, key).into());
        Cipher { blocks, nonces: blake3::derive_key(OF_NONCES, key) }
    }

    /// Encrypts the blocks of a datagram, and appends what is needed to read them: [`ENCRYPTION_BYTES`]. The flags must
    /// be those that are sent.
    pub fn encrypt(&self, datagram: &mut Vec<u8>, associated: Associated) {
        let length = datagram.len();
        datagram.extend_from_slice(&associated);
        let hash = blake3::keyed_hash(&self.nonces, datagram);
        datagram.truncate(length);
        let sent = hash.as_bytes().first_chunk::<SENT_BYTES>().expect("a hash is longer");
        let (header, blocks) = datagram.split_first_chunk_mut().expect("a datagram has a header");
        let (nonce, authenticated) = beside(header, sent, associated);
        let tag = self.blocks.encrypt_inout_detached(&nonce, &authenticated, blocks.into());
        datagram.extend_from_slice(sent);
        datagram.extend_from_slice(&tag.expect("a datagram is short"));
    }

    /// Returns a datagram that `encrypt` has encrypted as it was in clear, without the flags that say how it is sent;
    /// `None` if anything in it, its link or its receiver is another. The tag is compared in constant time before
    /// anything is decrypted.
    pub fn decrypt(&self, datagram: &[u8], associated: Associated) -> Option<Vec<u8>> {
        let (rest, tag) = datagram.split_last_chunk::<TAG_BYTES>()?;
        let (rest, sent) = rest.split_last_chunk::<SENT_BYTES>()?;
        let mut plain = rest.to_vec();
        let (header, blocks) = plain.split_first_chunk_mut()?;
        let (nonce, authenticated) = beside(header, sent, associated);
        self.blocks.decrypt_inout_detached(&nonce, &authenticated, blocks.into(), &(*tag).into()).ok()?;
        plain[FLAGS_AT] &= !(Flags::ENCRYPTED | Flags::REPORT | Flags::FOR_EACH);
        Some(plain)
    }
}

/// Returns the nonce of a datagram, and what is authenticated beside its blocks.
fn beside(
    header: &[u8; HEADER_BYTES],
    sent: &[u8; SENT_BYTES],
    associated: Associated,
) -> (XNonce, [u8; HEADER_BYTES + ASSOCIATED_BYTES]) {
    let mut nonce = [0; 24];
    nonce[..SENT_BYTES].copy_from_slice(sent);
    nonce[SENT_BYTES..].copy_from_slice(&header[HEADER_BYTES - 8..]);
    let mut authenticated = [0; HEADER_BYTES + ASSOCIATED_BYTES];
    authenticated[..HEADER_BYTES].copy_from_slice(header);
    authenticated[HEADER_BYTES..].copy_from_slice(&associated);
    (nonce.into(), authenticated)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::messages::ids::HostId;
    use crate::net::protocol::codec::{self, Header};

    const HERE: Associated = [1, 0, 255, 255];

    fn plain(flags: u8, (incarnation, sequence): (u32, u32), body: u8) -> Vec<u8> {
        let flags = Flags(flags | Flags::TAGGED | Flags::ENCRYPTED);
        let mut plain = codec::start(&Header { flags, team: 7, sender: HostId(3), incarnation, sequence });
        plain.extend_from_slice(&[body; 40]);
        plain
    }

    fn encrypted(cipher: &Cipher, plain: &[u8], associated: Associated) -> Vec<u8> {
        let mut datagram = plain.to_vec();
        cipher.encrypt(&mut datagram, associated);
        datagram
    }

    #[test]
    fn blocks_come_back_as_they_were_and_any_change_of_datagram_link_receiver_or_key_is_noticed() {
        let cipher = Cipher::new(&[5; 32]);
        let plain = plain(0, (1, 2), 9);
        let sent = encrypted(&cipher, &plain, HERE);
        assert_eq!(sent.len(), plain.len() + ENCRYPTION_BYTES);
        assert_eq!(sent[..HEADER_BYTES], plain[..HEADER_BYTES], "the header is in clear");
        assert!(!sent[HEADER_BYTES..].windows(8).any(|bytes| bytes == [9; 8]), "the blocks are not");
        let mut opened = cipher.decrypt(&sent, HERE).expect("it is whole");
        assert!(!codec::is_encrypted(&opened));
        opened[FLAGS_AT] |= Flags::ENCRYPTED;
        assert_eq!(opened, plain);
        for bit in 0..sent.len() * 8 {
            let mut turned = sent.clone();
            turned[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(cipher.decrypt(&turned, HERE), None, "bit {bit}");
        }
        for length in 0..sent.len() {
            assert_eq!(cipher.decrypt(&sent[..length], HERE), None, "{length} bytes");
        }
        assert_eq!(cipher.decrypt(&sent, [2, 0, 255, 255]), None, "another link");
        assert_eq!(cipher.decrypt(&sent, [1, 0, 4, 0]), None, "for one host");
        assert_eq!(Cipher::new(&[6; 32]).decrypt(&sent, HERE), None, "another key");
    }

    /// The layout on the wire, byte by byte: another one is another version.
    #[test]
    fn a_datagram_is_encrypted_to_these_bytes() {
        let sent = encrypted(&Cipher::new(&[5; 32]), &plain(0, (1, 2), 9), HERE);
        let pinned = blake3::hash(&sent).to_hex();
        assert_eq!(&pinned[..32], "244bae08fb9f37f951137b83d7645233");
    }

    #[test]
    fn equal_nonces_are_of_equal_datagrams_over_copies_wraps_restarts_links_and_receivers() {
        let cipher = Cipher::new(&[5; 32]);
        let (mut seen, mut repeats) = (BTreeMap::new(), 0);
        // Two runs of a host that have drawn one incarnation, and numbers before and after a wrap, in each of which
        // another message has each number.
        for (incarnation, run) in [(1, 0), (1, 1), (2, 0)] {
            for lap in 0..3u8 {
                for sequence in [u32::MAX - 1, u32::MAX, 0, 1] {
                    for flags in [0, Flags::COPY, Flags::COPY, Flags::DIRECT] {
                        for associated in [HERE, [2, 0, 255, 255], [1, 0, 4, 0]] {
                            let plain = plain(flags, (incarnation, sequence), 3 * run + lap);
                            let sent = encrypted(&cipher, &plain, associated);
                            let at = sent.len() - ENCRYPTION_BYTES;
                            let header = sent.first_chunk().expect("it has a header");
                            let part = sent[at..].first_chunk().expect("it has a part of the nonce");
                            let nonce = beside(header, part, associated).0;
                            if let Some(before) = seen.insert(nonce, (sent.clone(), associated)) {
                                assert_eq!(before, (sent, associated), "a nonce of two datagrams");
                                repeats += 1;
                            }
                        }
                    }
                }
            }
        }
        assert_eq!((seen.len(), repeats), (3 * 3 * 4 * 3 * 3, 3 * 3 * 4 * 3), "only copies are alike");
    }
}
