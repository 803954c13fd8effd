//! Packet filter of a link's socket: a classic BPF program that the kernel runs on every datagram before it wakes the
//! process. It drops datagrams by length, version, team and source. They appear in no counter and no log.

use std::net::SocketAddr;

use socket2::{SockFilter, Socket};

use crate::net::protocol::codec::TAG_BYTES;
use crate::net::protocol::codec::{HEADER_BYTES, MAX_FRAME_BYTES, VERSION};
use crate::net::transport::Filter;

/// Length of the UDP header \[bytes\]; a filter sees a datagram from there on (RFC 768).
const UDP_BYTES: usize = 8;
/// Base offset of the IP header in filters (linux/filter.h, `SKF_NET_OFF`).
const NETWORK: u32 = 0xfff0_0000;
// BPF instructions (linux/bpf_common.h): load a byte, half word, word, or the length; compare; return.
const LOAD_BYTE: u16 = 0x30;
const LOAD_HALF: u16 = 0x28;
const LOAD_WORD: u16 = 0x20;
const LOAD_LENGTH: u16 = 0x80;
const EQUAL: u16 = 0x15;
const GREATER: u16 = 0x25;
const AT_LEAST: u16 = 0x35;
const RETURN: u16 = 0x06;

/// Attaches a packet filter to a socket: the kernel drops what `filter` excludes, and datagrams from the address `own`,
/// which are those of this process. If the kernel refuses it, the link layer drops the same datagrams at a higher cost.
pub(super) fn attach(filter: Filter, socket: &Socket, own: Option<SocketAddr>) {
    if let Err(error) = socket.attach_filter(&program(filter, own)) {
        tracing::debug!("the kernel takes no filter: {error}");
    }
}

fn program(filter: Filter, own: Option<SocketAddr>) -> Vec<SockFilter> {
    let mut program = match filter {
        Filter::All => Vec::new(),
        Filter::Team { number, tagged } => of_team(number, tagged),
    };
    if let Some(own) = own {
        let (offset, words) = source(own);
        // On the first difference, jump to the final accept. After each comparison follow two instructions for each
        // further word, and the one that drops.
        let mut left = words.len() as u8;
        program.push(SockFilter::new(LOAD_HALF, 0, 0, 0));
        program.push(SockFilter::new(EQUAL, 0, 2 * left + 1, u32::from(own.port())));
        for (index, word) in (0u32..).zip(words) {
            left -= 1;
            program.push(SockFilter::new(LOAD_WORD, 0, 0, NETWORK + offset + 4 * index));
            program.push(SockFilter::new(EQUAL, 0, 2 * left + 1, word));
        }
        program.push(SockFilter::new(RETURN, 0, 0, 0));
    }
    program.push(SockFilter::new(RETURN, 0, 0, u32::MAX));
    program
}

fn of_team(number: u16, tagged: bool) -> Vec<SockFilter> {
    let shortest = HEADER_BYTES + if tagged { TAG_BYTES } else { 0 };
    let at = |offset: usize| (UDP_BYTES + offset) as u32;
    vec![
        SockFilter::new(LOAD_LENGTH, 0, 0, 0),
        SockFilter::new(AT_LEAST, 1, 0, at(shortest)),
        SockFilter::new(RETURN, 0, 0, 0),
        SockFilter::new(GREATER, 0, 1, at(MAX_FRAME_BYTES)),
        SockFilter::new(RETURN, 0, 0, 0),
        SockFilter::new(LOAD_BYTE, 0, 0, at(0)),
        SockFilter::new(EQUAL, 1, 0, u32::from(VERSION)),
        SockFilter::new(RETURN, 0, 0, 0),
        SockFilter::new(LOAD_HALF, 0, 0, at(2)),
        // BPF loads words as big-endian, and the team number is little-endian.
        SockFilter::new(EQUAL, 1, 0, u32::from(number.swap_bytes())),
        SockFilter::new(RETURN, 0, 0, 0),
    ]
}

/// Returns the offset of the source address in the IP header, and the address in words (RFC 791, section 3.1; RFC 8200,
/// section 3).
fn source(own: SocketAddr) -> (u32, Vec<u32>) {
    match own {
        SocketAddr::V4(v4) => (12, vec![u32::from(*v4.ip())]),
        SocketAddr::V6(v6) => {
            let bits = u128::from(*v6.ip());
            (8, [96, 64, 32, 0].map(|shift| (bits >> shift) as u32).to_vec())
        }
    }
}
