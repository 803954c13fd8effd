//! The live page's server as an actor, on an arbiter (a thread with an asynchronous runtime) of its own, which it
//! shares with no driver. It accepts connections and says when there are newer values; each connection is a task beside
//! it.
//!
//! A connection is HTTP/1.1 by hyper, within the limits that [the page on
//! threats](https://github.com/murmurate/murmurate/blob/main/docs/watch.md) lists.

use std::net::TcpListener;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use actix::{Actor, ActorContext, AsyncContext, Context, Handler, Recipient, SpawnHandle, StreamHandler, Supervised};
use axum::Router;
use futures_util::stream::{self, Stream};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::net::TcpStream;
use tokio::sync::oneshot;
use tokio_io_timeout::TimeoutStream;
use tower::ServiceExt as _;

use murmurate::edge::{EndsProcess, Input, Port, Seat, Worker};

use super::access::Ends;
use super::request;
use super::shared::{Connection, PAGE, Place, Shared};

/// Period at which the server looks for new values.
const LOOK: Duration = Duration::from_millis(20);
/// Longest time that the closing server waits for connections to send the last status.
const CLOSING: Duration = Duration::from_millis(500);
/// Largest header of an HTTP request that is accepted \[bytes\].
const MAX_HEADER_BYTES: usize = 8192;
/// Largest number of header lines.
const MAX_HEADERS: usize = 64;
/// Longest time in which the whole header of an HTTP request must arrive, and for which a connection may lie idle.
const HEADER_TIME: Duration = Duration::from_secs(5);
/// Write timeout: a connection is closed if its client does not read for this long.
const WRITE_TIME: Duration = Duration::from_secs(5);

/// The server before it is started: a listening socket, which does not block, and what it shares with the control
/// thread.
pub(super) struct Listening {
    /// Socket that the server accepts connections from.
    pub listener: TcpListener,
    /// State shared with the control thread.
    pub shared: Arc<Shared>,
}

impl Worker for Listening {
    fn start(self: Box<Self>, seat: Seat) -> Recipient<Input> {
        let Listening { listener, shared } = *self;
        seat.start(move |port| {
            let router = request::router(Arc::clone(&shared));
            Page { listener, router, shared, seen: [0; 3], accepting: None, _port: port }
        })
    }
}

/// The server as an actor.
struct Page {
    listener: TcpListener,
    router: Router,
    shared: Arc<Shared>,
    /// Version numbers of the values that connections know of.
    seen: [u64; 3],
    /// Stream of new connections; `None` once the server is being closed.
    accepting: Option<SpawnHandle>,
    _port: Port,
}

impl Actor for Page {
    type Context = Context<Self>;

    fn started(&mut self, context: &mut Self::Context) {
        // `started` is called again if the closed server stops while its mailbox still exists.
        if self.shared.is_closing() {
            return context.stop();
        }
        match self.listener.try_clone().and_then(tokio::net::TcpListener::from_std) {
            Ok(listener) => self.accepting = Some(context.add_stream(accept(listener))),
            Err(error) => tracing::error!("the live page cannot be opened: {error}; start the program again for it"),
        }
        context.run_interval(LOOK, Page::look);
    }
}

impl Supervised for Page {}

/// Connections that arrive at `listener`.
fn accept(listener: tokio::net::TcpListener) -> impl Stream<Item = TcpStream> {
    stream::unfold(listener, async |listener| {
        loop {
            match listener.accept().await {
                Ok((stream, _)) => return Some((stream, listener)),
                // Probably no file descriptors are left: try again later.
                Err(_) => tokio::time::sleep(LOOK).await,
            }
        }
    })
}

impl StreamHandler<TcpStream> for Page {
    fn handle(&mut self, stream: TcpStream, _: &mut Self::Context) {
        // An error means that the client has ended it already.
        let (Ok(local), Ok(peer), Ok(())) = (stream.local_addr(), stream.peer_addr(), stream.set_nodelay(true)) else {
            return;
        };
        let (end, ended) = oneshot::channel();
        let ends = Ends { local, peer: peer.ip() };
        let connection = Connection { ends, place: Place::take(&self.shared, ends.peer, end) };
        tokio::spawn(serve(stream, ended, connection, (self.router.clone(), Arc::clone(&self.shared))));
    }
}

impl Handler<Input> for Page {
    type Result = ();

    /// Closes the server: sends the last status, and ends. There are no packets to it.
    fn handle(&mut self, input: Input, context: &mut Self::Context) {
        if input != Input::Close || self.shared.is_closing() {
            return;
        }
        if let Some(accepting) = self.accepting.take() {
            context.cancel_future(accepting);
        }
        self.shared.closing.store(true, Ordering::Release);
        self.shared.news.notify_waiters();
        context.run_later(CLOSING, |_, context| context.stop());
    }
}

impl Page {
    /// Wakes the connections if there are newer values; ends the closing server when all connections have ended.
    fn look(&mut self, context: &mut Context<Page>) {
        let numbers = self.shared.numbers();
        if numbers != self.seen {
            self.seen = numbers;
            self.shared.news.notify_waiters();
        }
        if self.shared.is_closing() && self.shared.places().len() == 0 {
            context.stop();
        }
    }
}

/// Serves the requests of one connection until either side ends it, or its place is taken away, which ends `ended`.
async fn serve(
    stream: TcpStream,
    ended: oneshot::Receiver<()>,
    connection: Connection,
    (router, shared): (Router, Arc<Shared>),
) {
    let _guard = EndsProcess(PAGE);
    let mut stream = Box::pin(TimeoutStream::new(stream));
    stream.as_mut().set_write_timeout_pinned(Some(WRITE_TIME));
    let service = service_fn(move |mut request| {
        request.extensions_mut().insert(connection.clone());
        router.clone().oneshot(request)
    });
    let mut served = pin!(
        http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(HEADER_TIME)
            .max_buf_size(MAX_HEADER_BYTES)
            .max_header_size(MAX_HEADER_BYTES)
            .max_headers(MAX_HEADERS)
            .serve_connection(TokioIo::new(stream), service)
            .with_upgrades()
    );
    let outcome = tokio::select! {
        outcome = served.as_mut() => outcome,
        _ = ended => return,
        () = shared.closed() => {
            served.as_mut().graceful_shutdown();
            served.await
        }
    };
    if outcome.is_err_and(|error| error.is_parse()) {
        shared.refuse();
    }
}
