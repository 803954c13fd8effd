//! The live page's server as an actor, on an arbiter (a thread with an asynchronous runtime) of its own, which it
//! shares with no driver. It accepts connections and says when there are newer values; each connection is a task beside
//! it.
//!
//! A connection is HTTP/1.1 by hyper, within the limits that [the page on
//! threats](https://github.com/murmurate/murmurate/blob/main/docs/watch.md) lists.

use std::convert::Infallible;
use std::io;
use std::net::TcpListener;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::Builder;
use std::time::Duration;

use actix::{
    Actor, Addr, AsyncContext, Context, Handler, Message, SpawnHandle, StreamHandler, Supervised, Supervisor, System,
};
use axum::Router;
use futures_util::stream::{self, Stream};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::net::TcpStream;
use tokio::runtime;
use tokio::sync::oneshot;
use tokio_io_timeout::TimeoutStream;
use tower::ServiceExt as _;

use murmurate::edge::EndsProcess;

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

/// A server that runs on its own thread.
pub(super) struct Running {
    page: Addr<Page>,
    /// Closed when the thread ends; nothing is ever sent.
    ended: Receiver<Infallible>,
}

impl Running {
    /// Starts the server on a thread of its own.
    pub fn start(listener: TcpListener, shared: Arc<Shared>) -> io::Result<Running> {
        let runtime = runtime::Builder::new_current_thread().enable_all().build()?;
        listener.set_nonblocking(true)?;
        let listener = {
            let _inside = runtime.enter();
            tokio::net::TcpListener::from_std(listener)?
        };
        let (started, page) = sync_channel(1);
        let (end, ended) = sync_channel(0);
        Builder::new().name("page".to_owned()).spawn(move || {
            let (_guard, _end) = (EndsProcess(PAGE), end);
            let system = System::with_tokio_rt(move || runtime);
            let router = request::router(Arc::clone(&shared));
            let page = Page { listener: Arc::new(listener), router, shared, seen: [0; 3], accepting: None };
            let _ = started.send(system.block_on(async { Supervisor::start(|_| page) }));
            // It ends when the actor stops the system.
            let _ = system.run();
        })?;
        Ok(Running { page: page.recv().map_err(io::Error::other)?, ended })
    }

    /// Closes the server, and waits until it has ended, but not for long.
    pub fn close(self) {
        if self.page.try_send(Close).is_ok() {
            // Closed or too late: it ends either way.
            let _ = self.ended.recv_timeout(2 * CLOSING);
        }
    }
}

/// Message to the server: send the last status, and end.
struct Close;

impl Message for Close {
    type Result = ();
}

/// The server as an actor.
struct Page {
    listener: Arc<tokio::net::TcpListener>,
    router: Router,
    shared: Arc<Shared>,
    /// Version numbers of the values that connections know of.
    seen: [u64; 3],
    /// Stream of new connections; `None` once the server is being closed.
    accepting: Option<SpawnHandle>,
}

impl Actor for Page {
    type Context = Context<Self>;

    fn started(&mut self, context: &mut Self::Context) {
        self.accepting = Some(context.add_stream(accept(Arc::clone(&self.listener))));
        context.run_interval(LOOK, |page, _| page.look());
    }
}

impl Supervised for Page {}

/// Connections that arrive at `listener`.
fn accept(listener: Arc<tokio::net::TcpListener>) -> impl Stream<Item = TcpStream> {
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
        let _guard = EndsProcess(PAGE);
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

impl Handler<Close> for Page {
    type Result = ();

    fn handle(&mut self, _: Close, context: &mut Self::Context) {
        let _guard = EndsProcess(PAGE);
        if let Some(accepting) = self.accepting.take() {
            context.cancel_future(accepting);
        }
        self.shared.closing.store(true, Ordering::Release);
        self.shared.news.notify_waiters();
        context.run_later(CLOSING, |_, _| System::current().stop());
    }
}

impl Page {
    /// Wakes the connections if there are newer values; ends the closing server when all connections have ended.
    fn look(&mut self) {
        let _guard = EndsProcess(PAGE);
        let numbers = self.shared.numbers();
        if numbers != self.seen {
            self.seen = numbers;
            self.shared.news.notify_waiters();
        }
        if self.shared.is_closing() && self.shared.places().len() == 0 {
            System::current().stop();
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
