//! Threads that keep a link usable: one opens its sockets again when their network interface or address has changed,
//! and one for each name of a host resolves it while the host is silent. They open and resolve, which may take long,
//! and leave the results to the control thread, which never waits for them.

use std::net::{SocketAddr, ToSocketAddrs};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;
use std::{io, mem};

use super::open::{Ends, OpenError, Sockets, look, open};
use super::socket::SocketConfig;
use crate::edge::Bell;
use crate::messages::ids::HostId;
use crate::net::transport::Filter;
use crate::net::transport::link_watch::{LinkWatch, Removed};

/// Longest time between two looks at the network interface, where the kernel tells of no change, or the sockets wait
/// for an interface.
const LOOK: Duration = Duration::from_millis(500);
/// The same while the sockets are open and the kernel tells of changes. A look asks for all interfaces and addresses,
/// which costs a host that hears twenty messages a second a tenth of its work if it looks twice a second.
const LOOK_IF_TOLD: Duration = Duration::from_secs(5);
/// Time between two attempts to open sockets on an interface that is fit.
const RETRY: Duration = Duration::from_millis(100);
/// Time between two attempts to resolve the name of a silent host, and between two looks whether it is silent.
const RESOLVE: Duration = Duration::from_millis(500);
/// Stack of a thread \[bytes\]. Resolvers of the C library load modules and need much of it.
const STACK_BYTES: usize = 512 << 10;

/// Result of a thread that keeps a link usable.
#[derive(Debug)]
pub(super) enum News {
    /// The sockets are of no use any more; the text says why. They have to be closed, since their address is needed.
    Closed(String),
    /// Sockets that were opened in place of the ones before.
    Open(Box<Sockets>),
    /// Address to which the name of a host was resolved.
    Resolved(HostId, SocketAddr),
}

/// Control thread's end of the threads that keep a link usable.
#[derive(Debug)]
pub(super) struct Keeper {
    news: Receiver<News>,
    bell: Arc<Bell>,
    sender: Sender,
    closed: Arc<AtomicBool>,
}

/// A thread's end.
#[derive(Clone, Debug)]
struct Sender {
    news: SyncSender<News>,
    bell: Arc<Bell>,
}

impl Sender {
    /// Passes on a result; waits while the control thread has not taken those before. Returns whether it is there.
    fn send(&self, news: News) -> bool {
        let sent = self.news.send(news).is_ok();
        self.bell.ring();
        sent
    }
}

impl Keeper {
    /// Makes the channel to the control thread. Fails if the operating system has no file descriptor left.
    pub(super) fn new() -> io::Result<Keeper> {
        let bell = Arc::new(Bell::new()?);
        // The thread of the interface and those of names wait rather than fill memory.
        let (sender, news) = sync_channel(4);
        let sender = Sender { news: sender, bell: Arc::clone(&bell) };
        Ok(Keeper { news, bell, sender, closed: Arc::default() })
    }

    /// Starts the thread that opens the sockets again; those of now have the ends `ends`.
    pub(super) fn keep_open(&self, config: &SocketConfig, filter: Filter, ends: Ends) -> io::Result<()> {
        let sockets = Open { config: config.clone(), filter, ends, sender: self.sender.clone(), is_open: true };
        let closed = Arc::clone(&self.closed);
        start("link", move || sockets.run(&closed))
    }

    /// Starts the thread that resolves the name of the host `host` while `unknown` is set; `v6` selects the family of
    /// the address.
    pub(super) fn resolve(
        &self,
        host: HostId,
        (name, port): (&str, u16),
        v6: bool,
        unknown: Arc<AtomicBool>,
    ) -> io::Result<()> {
        let (name, sender, closed) = (name.to_owned(), self.sender.clone(), Arc::clone(&self.closed));
        start("names", move || resolve(host, (&name, port), v6, (&unknown, &closed), &sender))
    }

    /// Returns the descriptor that is readable when there are results.
    pub(super) fn bell(&self) -> Arc<Bell> {
        Arc::clone(&self.bell)
    }

    /// Takes the results so far.
    pub(super) fn take(&self) -> Vec<News> {
        // Read before the results are taken, so that one that comes meanwhile signals again.
        self.bell.silence();
        self.news.try_iter().collect()
    }
}

impl Drop for Keeper {
    fn drop(&mut self) {
        self.closed.store(true, Ordering::Relaxed);
    }
}

fn start(name: &str, run: impl FnOnce() + Send + 'static) -> io::Result<()> {
    thread::Builder::new().name(name.to_owned()).stack_size(STACK_BYTES).spawn(run).map(drop)
}

/// Sockets of a link as their thread knows them.
struct Open {
    config: SocketConfig,
    filter: Filter,
    /// Ends of the last sockets.
    ends: Ends,
    sender: Sender,
    is_open: bool,
}

impl Open {
    fn run(mut self, closed: &AtomicBool) {
        let watch = LinkWatch::open();
        let usual = if watch.is_told() { LOOK_IF_TOLD } else { LOOK };
        let mut pause = usual;
        let mut attempts = 0_u32;
        loop {
            let removed = watch.wait(pause);
            if closed.load(Ordering::Relaxed) {
                return;
            }
            (pause, attempts) = match self.step(&removed) {
                Ok(()) => (usual, 0),
                Err(error) => {
                    // What only a notice of the kernel ends needs no attempts.
                    let fit = !matches!(error, OpenError::Interface(_));
                    if attempts > 0 && attempts.is_power_of_two() && fit {
                        let interface = &self.config.interface;
                        tracing::warn!(attempts, "a link on '{interface}' cannot be opened again yet: {error}");
                    }
                    (if fit { RETRY } else { LOOK }, attempts.saturating_add(1))
                }
            };
        }
    }

    /// Compares the interface with the sockets, and opens them again if they are of no use. An error is the reason why
    /// they are not open.
    fn step(&mut self, removed: &Removed) -> Result<(), OpenError> {
        let now = match look(&self.config, Some(&self.ends)) {
            Ok(now) if self.is_open && now.is_same(&self.ends) && !removed.has(now.index) => return Ok(()),
            Ok(now) => now,
            Err(error) => {
                self.close(&error.to_string());
                return Err(error);
            }
        };
        let (was, is) = (self.ends.at.ip(), now.at.ip());
        self.close(&if was == is {
            format!("the network interface '{}' was made again", now.name)
        } else {
            format!("the network interface '{}' has the address {is} in place of {was}", now.name)
        });
        // The control thread closes the sockets before; until then, the address may be in use.
        let sockets = open(&self.config, self.filter, now.clone())?;
        (self.ends, self.is_open) = (now, true);
        warn_elsewhere(&self.config, &self.ends);
        self.sender.send(News::Open(Box::new(sockets)));
        Ok(())
    }

    fn close(&mut self, why: &str) {
        if mem::replace(&mut self.is_open, false) {
            self.sender.send(News::Closed(why.to_owned()));
        }
    }
}

/// Warns if a host listens at another address than the team file says, because its interface has no such address.
pub(super) fn warn_elsewhere(config: &SocketConfig, ends: &Ends) {
    if let Some(listen) = ends.is_elsewhere(config) {
        let Ends { name, at, .. } = ends;
        tracing::warn!(
            "this host is not at {listen}, as the file has it: '{name}' has {}. It listens at {at}, and the others \
             learn that from its datagrams; mend the file, or give it a name",
            at.ip()
        );
    }
}

/// Resolves the name of a host whenever `unknown` is set, until `closed` is.
fn resolve(
    host: HostId,
    (name, port): (&str, u16),
    v6: bool,
    (unknown, closed): (&AtomicBool, &AtomicBool),
    sender: &Sender,
) {
    let (mut last, mut failed) = (None, 0_u32);
    while !closed.load(Ordering::Relaxed) {
        if unknown.load(Ordering::Relaxed) {
            let found = (name, port).to_socket_addrs().and_then(|mut all| {
                let family = if v6 { "IPv6" } else { "IPv4" };
                all.find(|at| at.is_ipv6() == v6).ok_or_else(|| io::Error::other(format!("no {family} address")))
            });
            match found {
                Ok(at) if last == Some(at) => failed = 0,
                Ok(at) => {
                    tracing::info!("host {} is '{name}': {at}", host.0);
                    (last, failed) = (Some(at), 0);
                    sender.send(News::Resolved(host, at));
                }
                Err(error) => {
                    failed += 1;
                    if failed.is_power_of_two() {
                        tracing::warn!(
                            attempts = failed,
                            "the name '{name}' of host {} has no address: {error}",
                            host.0
                        );
                    }
                }
            }
        }
        thread::park_timeout(RESOLVE);
    }
}

#[cfg(test)]
mod tests {
    use std::os::fd::AsFd;

    use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

    use super::*;

    #[test]
    fn a_name_is_resolved_on_a_thread_and_its_address_is_told_once() {
        let keeper = Keeper::new().unwrap();
        let unknown = Arc::new(AtomicBool::new(true));
        keeper.resolve(HostId(3), ("localhost", 7700), false, Arc::clone(&unknown)).unwrap();
        let news = keeper.news.recv_timeout(Duration::from_secs(20)).expect("every machine has this name");
        let News::Resolved(host, at) = news else { panic!("it is no address: {news:?}") };
        assert_eq!((host, at), (HostId(3), SocketAddr::from(([127, 0, 0, 1], 7700))));
        let bell = keeper.bell();
        let rings = poll(&mut [PollFd::new(bell.as_fd(), PollFlags::POLLIN)], PollTimeout::from(20_000_u16));
        assert!(rings == Ok(1) && keeper.take().is_empty());
    }
}
