//! One WebSocket connection of the live page: sends snapshots, or sends goals and status and receives commands. One
//! thread reads and writes it.

use std::io;
use std::net::TcpStream;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use serde_json::json;
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Message, WebSocket};

use super::command::{Command, MAX_BYTES};
use super::request::Socket;
use super::shared::{LOOK, Shared};

/// A quarter of the time after which a ping checks a WebSocket connection on which no status was sent.
const REPEAT: Duration = Duration::from_millis(500);
/// Largest number of client messages that are handled before something is sent again.
const AT_ONCE: usize = 8;

/// Serves a WebSocket connection of the kind `socket` until either side ends it. `rest` are the bytes that were
/// received after the request's header.
pub(super) fn run(stream: TcpStream, rest: Vec<u8>, socket: Socket, shared: &Shared) {
    if stream.set_read_timeout(Some(LOOK)).is_err() {
        return;
    }
    let limit = Some(MAX_BYTES);
    let config = WebSocketConfig::default().read_buffer_size(MAX_BYTES).max_message_size(limit).max_frame_size(limit);
    let mut socket_ = WebSocket::from_partially_read(stream, rest, Role::Server, Some(config));
    let mut session = Session { seen: [0; 3], told_at: None, answers: Vec::new() };
    // Any error ends the connection; the page then opens another.
    let _ = session.serve(&mut socket_, socket, shared);
    let _ = socket_.close(None);
    let _ = socket_.flush();
}

/// State of one WebSocket connection of the live page.
struct Session {
    /// Version numbers of the snapshot, goals and status that were sent last.
    seen: [u64; 3],
    /// Time of the last status or ping.
    told_at: Option<Instant>,
    /// Responses to refused commands that are still to be sent.
    answers: Vec<String>,
}

type Client = WebSocket<TcpStream>;

impl Session {
    fn serve(&mut self, client: &mut Client, socket: Socket, shared: &Shared) -> tungstenite::Result<()> {
        if let Socket::Control(standing) = socket {
            let holder = standing.is_holder();
            let hello = json!({ "kind": "hello", "body": { "holder": holder } });
            client.send(Message::text(hello.to_string()))?;
            if holder || !shared.access.guarded {
                client.send(Message::Text(shared.scene.clone()))?;
            }
        }
        loop {
            // Read before the status is sent, so that the last status is sent before the connection ends.
            let closing = shared.closing.load(Ordering::Acquire);
            match socket {
                Socket::View { .. } => {
                    if let Some(bytes) = shared.snapshot.newer(&mut self.seen[0]) {
                        client.send(Message::Binary(bytes))?;
                    }
                }
                Socket::Control(standing) => self.send_changes(client, standing.is_holder(), shared)?,
            }
            if closing {
                return Ok(());
            }
            for _ in 0..AT_ONCE {
                match client.read() {
                    Ok(message) => self.take(&message, socket, shared)?,
                    Err(tungstenite::Error::Io(error)) if is_nothing(&error) => break,
                    Err(error) => return Err(error),
                }
            }
        }
    }

    /// Sends the refusals of the client's commands, and goals and status if they have changed.
    fn send_changes(&mut self, client: &mut Client, holder: bool, shared: &Shared) -> tungstenite::Result<()> {
        for answer in self.answers.drain(..) {
            client.send(Message::text(answer))?;
        }
        if shared.access.guarded && !holder {
            return Ok(());
        }
        if let Some(goals) = shared.goals.newer(&mut self.seen[1]) {
            client.send(Message::Text(goals))?;
        }
        if let Some(status) = shared.status.newer(&mut self.seen[2]) {
            client.send(Message::Text(status))?;
            self.told_at = Some(Instant::now());
        }
        if self.told_at.is_some_and(|at| at.elapsed() >= 4 * REPEAT) {
            self.told_at = Some(Instant::now());
            client.send(Message::Ping(tungstenite::Bytes::new()))?;
        }
        Ok(())
    }

    /// Handles one message of the client: queues its command, or refuses it.
    fn take(&mut self, message: &Message, socket: Socket, shared: &Shared) -> tungstenite::Result<()> {
        let standing = match (message, socket) {
            (Message::Close(_), _) => return Err(tungstenite::Error::ConnectionClosed),
            (Message::Text(_), Socket::Control(standing)) => standing,
            (Message::Ping(_) | Message::Pong(_), _) => return Ok(()),
            // The page sends no other messages, so this client is not the page.
            _ => {
                shared.refuse();
                return Err(tungstenite::Error::ConnectionClosed);
            }
        };
        let result = Command::parse(message.to_text()?).and_then(|command| {
            match shared.access.refuses(&command, standing) {
                Some(why) => Err(why.to_owned()),
                None if command == Command::Stop => {
                    shared.stop.store(true, Ordering::Release);
                    // The queued copy wakes a thread that waits for commands; if the queue is full, that thread is not
                    // waiting.
                    let _ = shared.commands.try_send(command);
                    Ok(())
                }
                None => shared.commands.try_send(command).map_err(|_| "too many commands wait: try again".to_owned()),
            }
        });
        if let Err(why) = result {
            shared.refuse();
            self.answers.push(json!({ "kind": "refused", "body": { "why": why } }).to_string());
        }
        Ok(())
    }
}

/// Returns whether a read error only means that no data has arrived.
fn is_nothing(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut)
}
