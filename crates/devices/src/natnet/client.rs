//! State machine of a NatNet client: decides when to ask the server for its description, for frames and for model
//! definitions.
//!
//! It has no clock and no socket. The worker passes in the time and datagrams, and sends the requests that it returns.

use murmurate::time::{Span, Time};

use super::frame::{self, FrameLayout};
use super::model;
use super::packet::{self, ServerInfo, Version};

/// Period at which an unanswered request is repeated.
const AGAIN: Span = Span::from_millis(1000);
/// Period of KEEP_ALIVE requests, which a unicast server needs to keep a client (the manufacturer's sample).
const KEEP_ALIVE: Span = Span::from_millis(250);
/// Time without a frame after which the server counts as silent (20 frames at 20 Hz, the slowest camera's rate).
const SILENCE: Span = Span::from_millis(1000);
/// Time with frames but without model definitions after which the server counts as not answering (three requests).
const UNANSWERED: Span = Span::from_millis(3000);
/// Period at which the worker passes the server's last description and model definitions to the source again, since the
/// actor that runs the source may have been restarted.
const REMINDER: Span = Span::from_millis(500);
/// Bitstream version that is requested from a unicast server: the newest that was tested with independent servers.
const BITSTREAM: Version = Version { major: 4, minor: 1 };

/// Change of the connection to the server, to be shown to an operator.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Change {
    /// The server has sent its first description, or a changed one.
    Server(ServerInfo),
    /// Frames of motion capture data have begun to arrive, for the first time or after a silence.
    Frames,
    /// No frame of motion capture data has arrived for one second.
    Silent,
    /// Frames arrive, but the server does not answer requests for model definitions.
    Unanswered,
}

/// State machine of a NatNet client: processes the server's datagrams, and returns the requests that are due.
#[derive(Clone, Debug)]
pub struct Client {
    unicast: bool,
    server: Option<ServerInfo>,
    layout: FrameLayout,
    /// Time of the last frame; before the first, the time of the start.
    heard: Time,
    /// Time of the first frame since the start or the last silence; `None` if no frames arrive.
    streaming: Option<Time>,
    /// Whether it has been reported that the server does not answer requests for model definitions.
    unanswered: bool,
    /// Whether the server has been reported as silent, without a frame since.
    silent: bool,
    /// Whether the current model definitions (names and IDs of rigid bodies) have been received.
    named: bool,
    /// Newest datagram with the server's description, and newest datagram with model definitions; `None` before it
    /// arrives.
    newest: [Option<Box<[u8]>>; 2],
    remind_at: Time,
    connect_at: Time,
    keep_alive_at: Time,
    model_at: Time,
}

impl Client {
    /// Returns a client that has received nothing from its server. `unicast` says whether the server sends frames by
    /// unicast, and not by multicast.
    pub fn new(now: Time, unicast: bool) -> Client {
        Client {
            unicast,
            server: None,
            layout: FrameLayout::Sized,
            heard: now,
            streaming: None,
            unanswered: false,
            silent: false,
            named: false,
            newest: [None, None],
            remind_at: now + REMINDER,
            connect_at: now,
            keep_alive_at: now,
            model_at: now,
        }
    }

    /// Processes a datagram of the server. Returns the change of the connection that it causes. A malformed frame
    /// counts as a frame that has arrived; other malformed datagrams are ignored.
    pub fn take(&mut self, now: Time, datagram: &[u8]) -> Option<Change> {
        let split = packet::split(datagram);
        // A frame that cannot be decoded has arrived all the same: opening the sockets again would not help.
        if datagram.starts_with(&packet::FRAME.to_le_bytes()) {
            if let Ok((frame, layout)) = split.and_then(|(_, payload)| frame::decode(payload, self.layout)) {
                self.layout = layout;
                self.named &= !frame.models_changed;
            }
            (self.heard, self.silent) = (now, false);
            return self.streaming.replace(self.streaming.unwrap_or(now)).is_none().then_some(Change::Frames);
        }
        let (message, payload) = split.ok()?;
        match message {
            packet::MODEL => {
                // Definitions that cannot be decoded are asked for again, and the source says why it refuses them.
                self.named = model::decode(payload, self.server.as_ref().map(|server| server.natnet)).is_ok();
                if self.named || self.newest[1].is_none() {
                    self.newest[1] = Some(datagram.into());
                }
                None
            }
            packet::SERVER_INFO => {
                let server = packet::server_info(payload).ok()?;
                self.newest[0] = Some(datagram.into());
                if self.server.as_ref() == Some(&server) {
                    return None;
                }
                self.layout = FrameLayout::of(server.natnet);
                self.named = false;
                self.server = Some(server.clone());
                Some(Change::Server(server))
            }
            _ => None,
        }
    }

    /// Returns whether the server is silent: [`Change::Silent`] was returned, and no frame has arrived since.
    pub fn is_silent(&self) -> bool {
        self.silent
    }

    /// Returns [`Change::Silent`] once when no frame has arrived for one second, and [`Change::Unanswered`] once when
    /// the server does not answer requests for model definitions; otherwise `None`.
    pub fn listen(&mut self, now: Time) -> Option<Change> {
        if !self.silent && now.since(self.heard) >= SILENCE {
            // The server may have been restarted with other bodies.
            (self.streaming, self.silent, self.named) = (None, true, false);
            return Some(Change::Silent);
        }
        let waits = self.streaming.is_some_and(|since| now.since(since) >= UNANSWERED) && self.newest[1].is_none();
        let first = waits && !self.unanswered;
        self.unanswered |= waits;
        first.then_some(Change::Unanswered)
    }

    /// Returns the newest description of the server and the newest model definitions, as datagrams to pass to the
    /// source again, since the actor that runs it may have been restarted. They are due every 0.5 s; in between, the
    /// result is empty.
    pub(crate) fn reminders(&mut self, now: Time) -> Vec<Box<[u8]>> {
        if now < self.remind_at {
            return Vec::new();
        }
        self.remind_at = now + REMINDER;
        self.newest.iter().flatten().cloned().collect()
    }

    /// Returns the requests to the server that are due now, as datagrams.
    pub fn requests(&mut self, now: Time) -> Vec<Vec<u8>> {
        let mut due = Vec::new();
        if (self.server.is_none() || self.silent) && now >= self.connect_at {
            self.connect_at = now + AGAIN;
            due.push(packet::connect(BITSTREAM));
        }
        if (self.server.is_some() || self.streaming.is_some()) && !self.named && now >= self.model_at {
            self.model_at = now + AGAIN;
            due.push(packet::request(packet::REQUEST_MODEL));
        }
        if self.unicast && self.server.is_some() && now >= self.keep_alive_at {
            self.keep_alive_at = now + KEEP_ALIVE;
            due.push(packet::request(packet::KEEP_ALIVE));
        }
        due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    /// Message numbers of the requests that are due at a time \[ms\].
    fn asked(client: &mut Client, ms: u64) -> Vec<u16> {
        client.requests(at_ms(ms)).iter().map(|datagram| packet::split(datagram).unwrap().0).collect()
    }

    fn message(message: u16, payload: &[u8]) -> Vec<u8> {
        [&message.to_le_bytes()[..], &(payload.len() as u16).to_le_bytes(), payload].concat()
    }

    /// Payload of a frame of bitstream 3.0 without bodies.
    fn frame(models_changed: bool) -> Vec<u8> {
        let mut payload = vec![0; 78];
        payload[72] = if models_changed { 2 } else { 0 };
        message(packet::FRAME, &payload)
    }

    #[test]
    fn a_client_asks_until_it_is_answered_and_again_when_models_change() {
        let mut client = Client::new(at_ms(0), false);
        assert_eq!(asked(&mut client, 0), [packet::CONNECT]);
        assert!(asked(&mut client, 500).is_empty());
        assert_eq!(asked(&mut client, 1000), [packet::CONNECT]);
        let info = message(packet::SERVER_INFO, &[0; 264]);
        assert!(matches!(client.take(at_ms(1100), &info), Some(Change::Server(_))));
        assert_eq!(client.take(at_ms(1100), &info), None, "known");
        assert_eq!(asked(&mut client, 1100), [packet::REQUEST_MODEL]);
        let model = message(packet::MODEL, &[0; 4]);
        client.take(at_ms(1200), &model);
        assert_eq!(client.reminders(at_ms(1300)), [info.clone().into(), model.into()]);
        assert!(client.reminders(at_ms(1400)).is_empty());
        assert!(asked(&mut client, 3000).is_empty());
        assert_eq!(client.take(at_ms(3000), &frame(false)), Some(Change::Frames));
        assert!(asked(&mut client, 3000).is_empty());
        assert_eq!(client.take(at_ms(3010), &frame(true)), None);
        assert_eq!(asked(&mut client, 3010), [packet::REQUEST_MODEL]);
        assert!(asked(&mut client, 3500).is_empty(), "once a second");
    }

    #[test]
    fn frames_that_cannot_be_decoded_are_no_silence() {
        let mut client = Client::new(at_ms(0), false);
        let mut damaged = frame(false);
        damaged.truncate(40);
        for ms in (0..10_000).step_by(10) {
            let event = client.take(at_ms(ms), &damaged);
            assert_eq!(event, (ms == 0).then_some(Change::Frames), "{ms}");
            assert!(client.listen(at_ms(ms)) != Some(Change::Silent) && !client.is_silent());
        }
        assert_eq!(client.listen(at_ms(11_000)), Some(Change::Silent));
    }

    #[test]
    fn definitions_that_cannot_be_decoded_are_asked_for_again() {
        let mut client = Client::new(at_ms(0), false);
        client.take(at_ms(0), &message(packet::SERVER_INFO, &[0; 264]));
        let (good, bad) = (message(packet::MODEL, &[0; 4]), message(packet::MODEL, &[9, 0, 0, 0, 1]));
        client.take(at_ms(100), &bad);
        assert_eq!(asked(&mut client, 1000), [packet::REQUEST_MODEL]);
        client.take(at_ms(1100), &good);
        assert!(asked(&mut client, 3000).is_empty());
        client.take(at_ms(3000), &bad);
        assert!(client.reminders(at_ms(3100)).contains(&good.into()), "the last good ones");
    }

    #[test]
    fn a_silent_server_is_reported_once_and_asked_each_second() {
        let mut client = Client::new(at_ms(0), true);
        client.take(at_ms(10), &message(packet::SERVER_INFO, &[0; 264]));
        client.take(at_ms(10), &message(packet::MODEL, &[0; 4]));
        assert_eq!(client.take(at_ms(20), &frame(false)), Some(Change::Frames));
        assert_eq!(asked(&mut client, 20), [packet::KEEP_ALIVE]);
        assert_eq!((asked(&mut client, 100), asked(&mut client, 270)), (vec![], vec![packet::KEEP_ALIVE]));
        assert_eq!(client.listen(at_ms(1000)), None);
        assert_eq!((client.listen(at_ms(1020)), client.listen(at_ms(1100))), (Some(Change::Silent), None));
        assert_eq!(asked(&mut client, 1100), [packet::CONNECT, packet::REQUEST_MODEL, packet::KEEP_ALIVE]);
        assert_eq!(client.take(at_ms(2000), &frame(false)), Some(Change::Frames));
    }

    #[test]
    fn a_server_that_sends_and_does_not_answer_is_reported_once() {
        let mut client = Client::new(at_ms(0), false);
        for ms in (0..10_000).step_by(10) {
            client.take(at_ms(ms), &frame(false));
            assert_eq!(client.listen(at_ms(ms)), (ms == 3000).then_some(Change::Unanswered), "{ms}");
        }
        assert_eq!(asked(&mut client, 10_000), [packet::CONNECT, packet::REQUEST_MODEL]);
    }
}
