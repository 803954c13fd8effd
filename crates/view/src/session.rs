//! One WebSocket connection of the live page: sends snapshots, or sends goals and status and receives commands. It
//! receives while it sends, so that a stop arrives from a browser that does not read.

use std::sync::atomic::Ordering;
use std::time::Duration;

use axum::Error;
use axum::body::Bytes;
use axum::extract::ws::{Message, WebSocket};
use futures_util::stream::{SplitSink, SplitStream};
use futures_util::{SinkExt as _, StreamExt as _};
use serde_json::json;
use tokio::sync::mpsc::{self, Receiver, Sender};

use murmurate::edge::EndsProcess;

use super::access::{Socket, Standing};
use super::command::Command;
use super::shared::{PAGE, Shared};

/// Time after which a ping checks a WebSocket connection on which nothing was sent.
const SILENCE: Duration = Duration::from_secs(2);
/// Largest number of refusals that wait to be sent to a browser. It is not read further until it takes them.
const ANSWERS: usize = 8;

/// Serves a WebSocket connection of the kind `socket` until either side ends it.
pub(super) async fn run(client: WebSocket, socket: Socket, shared: &Shared) {
    let _guard = EndsProcess(PAGE);
    let (to, from) = client.split();
    let (refusals, answers) = mpsc::channel(ANSWERS);
    // Any error ends the connection; the page then opens another.
    tokio::select! {
        _ = tell(to, answers, socket, shared) => {}
        () = hear(from, refusals, socket, shared) => {}
    }
}

/// Sends the newest values and the answers to commands, until the server closes.
async fn tell(
    mut to: SplitSink<WebSocket, Message>,
    mut answers: Receiver<String>,
    socket: Socket,
    shared: &Shared,
) -> Result<(), Error> {
    let shows = socket.is_holder() || !shared.access.guarded;
    if let Socket::Control(standing) = socket {
        let hello = json!({ "kind": "hello", "body": { "holder": standing.is_holder() } });
        to.send(Message::text(hello.to_string())).await?;
        if shows {
            to.send(Message::Text(shared.scene.clone())).await?;
        }
    }
    let mut seen = [0; 3];
    loop {
        // From here on, no news is missed.
        let newer = shared.news.notified();
        // Read before the status is sent, so that the last status is sent before the connection ends.
        let closing = shared.is_closing();
        let news = match socket {
            _ if !shows => [None, None],
            Socket::View { .. } => [shared.snapshot.newer(&mut seen[0]).map(Message::Binary), None],
            Socket::Control(_) => [shared.goals.newer(&mut seen[1]), shared.status.newer(&mut seen[2])]
                .map(|text| text.map(Message::Text)),
        };
        for message in news.into_iter().flatten() {
            to.send(message).await?;
        }
        if closing {
            return to.close().await;
        }
        tokio::select! {
            Some(answer) = answers.recv() => to.send(Message::text(answer)).await?,
            () = newer => {}
            () = tokio::time::sleep(SILENCE) => to.send(Message::Ping(Bytes::new())).await?,
        }
    }
}

/// Receives commands until the client ends the connection, or sends what the page would not.
async fn hear(mut from: SplitStream<WebSocket>, refusals: Sender<String>, socket: Socket, shared: &Shared) {
    while let Some(Ok(message)) = from.next().await {
        match (message, socket) {
            // The library answers them.
            (Message::Close(_) | Message::Ping(_) | Message::Pong(_), _) => {}
            (Message::Text(text), Socket::Control(standing)) => {
                if let Err(why) = take(&text, standing, shared) {
                    shared.refuse();
                    let answer = json!({ "kind": "refused", "body": { "why": why } });
                    let _ = refusals.send(answer.to_string()).await;
                }
            }
            // The page sends no other messages, so this client is not the page.
            _ => return shared.refuse(),
        }
    }
}

/// Queues the command of a client, or returns why it is refused.
fn take(text: &str, standing: Standing, shared: &Shared) -> Result<(), String> {
    let command = Command::parse(text)?;
    if let Some(why) = shared.access.refuses(&command, standing) {
        return Err(why.to_owned());
    }
    if command == Command::Stop {
        shared.stop.store(true, Ordering::Release);
        // The queued copy wakes a thread that waits for commands; if the queue is full, that thread is not waiting.
        let _ = shared.commands.try_send(command);
        return Ok(());
    }
    shared.commands.try_send(command).map_err(|_| "too many commands wait: try again".to_owned())
}
