//! Event loop in real time: executes due events, runs the actors until every mailbox is empty, then sleeps until the
//! next event or until a file descriptor is readable. It uses one thread and no timers of tokio, which have a
//! resolution of a millisecond. Due events come before received datagrams, so a flood of datagrams delays a control
//! tick by at most one read. It contains no actor logic.

use std::cell::{Cell, RefCell};
use std::os::fd::AsFd;
use std::rc::Rc;
use std::time::Instant;

use super::clock::Clock;
use super::drive::Tasks;
#[cfg(not(target_os = "linux"))]
use super::poll::Watch;
use super::shell::in_system;
#[cfg(target_os = "linux")]
use super::watch::Watch;
use crate::time::{Span, Time};

/// Longest time for which the event loop sleeps if no file descriptor becomes readable.
const MAX_SLEEP: Span = Span::from_millis(1000);

/// File descriptors that the event loop of a run in real time watches, each with a function to call when it is
/// readable.
pub struct Readers {
    readers: Vec<Reader>,
    watch: Watch,
    /// Indices of readable file descriptors whose callback has not been called yet.
    ready: Vec<usize>,
    replaced: Replaced,
}

/// File descriptors of links to watch from the next turn on in place of those with the same index; `None` for none.
type Replaced = Rc<RefCell<Vec<(usize, Option<Rc<dyn AsFd>>)>>>;

/// Handle of a link's file descriptor in a [`Readers`], by which it is replaced.
#[derive(Clone)]
pub(crate) struct Watched {
    index: usize,
    replaced: Replaced,
}

impl Watched {
    /// Watches `source` in place of the descriptor before, from the next turn of the event loop on; with `None` nothing
    /// is watched.
    pub(crate) fn replace(&self, source: Option<Rc<dyn AsFd>>) {
        self.replaced.borrow_mut().push((self.index, source));
    }
}

struct Reader {
    /// `None` while there is nothing to watch.
    source: Option<Rc<dyn AsFd>>,
    /// Whether the reader waits until the other end of the source is closed, instead of for input.
    end: bool,
    /// Whether the closing of the source's other end has been reported.
    reported: Cell<bool>,
    notify: Box<dyn Fn()>,
    /// Function that returns the time until which the source is not read, or `None` if it may be read. `None` for a
    /// source that is never paused.
    paused_until: Option<Box<dyn Fn() -> Option<Time>>>,
}

impl Readers {
    /// Creates an empty set of file descriptors. Panics if the kernel has no descriptor left.
    pub(super) fn new() -> Readers {
        let (ready, replaced) = (Vec::new(), Replaced::default());
        Readers { readers: Vec::new(), watch: Watch::new(), ready, replaced }
    }

    /// Registers the file descriptor `source`: `notify` is called in each turn of the event loop in which it is
    /// readable, so again and again until all of it has been read.
    pub fn watch(&mut self, source: Rc<dyn AsFd>, notify: impl Fn() + 'static) {
        let source = Some(source);
        self.add(Reader {
            source,
            end: false,
            reported: Cell::new(false),
            notify: Box::new(notify),
            paused_until: None,
        });
    }

    /// Registers the file descriptor `source` of a link: `notify` is called in each turn of the event loop in which it
    /// is readable. `paused_until` returns the time until which the link is paused, or `None`. While any link is
    /// paused, no link is read. Returns a handle by which the descriptor is replaced when the link is opened again.
    pub(crate) fn watch_link(
        &mut self,
        source: Rc<dyn AsFd>,
        paused_until: impl Fn() -> Option<Time> + 'static,
        notify: impl Fn() + 'static,
    ) -> Watched {
        let (notify, paused_until) = (Box::new(notify), Some(Box::new(paused_until) as Box<dyn Fn() -> Option<Time>>));
        let handle = Watched { index: self.readers.len(), replaced: Rc::clone(&self.replaced) };
        self.add(Reader { source: Some(source), end: false, reported: Cell::new(false), notify, paused_until });
        handle
    }

    /// Registers a descriptor that is written to, such as a pipe: `notify` is called once when its other end is closed;
    /// for a regular file, which has no other end, never.
    pub fn watch_end(&mut self, source: Rc<dyn AsFd>, notify: impl Fn() + 'static) {
        self.add(Reader {
            source: Some(source),
            end: true,
            reported: Cell::new(false),
            notify: Box::new(notify),
            paused_until: None,
        });
    }

    fn add(&mut self, reader: Reader) {
        let index = self.readers.len();
        self.readers.push(reader);
        if !self.begin(index) {
            self.readers.pop();
        }
    }

    /// Starts to watch the descriptor of the reader with this index. Returns whether it can be watched: the end of a
    /// regular file cannot.
    fn begin(&mut self, index: usize) -> bool {
        let Reader { source, end, paused_until, .. } = &self.readers[index];
        source.as_ref().is_none_or(|source| self.watch.add(index, source, *end, paused_until.is_some()))
    }

    /// Replaces the descriptors of links that were opened again or closed.
    fn replace(&mut self) {
        let replaced = std::mem::take(&mut *self.replaced.borrow_mut());
        for (index, source) in replaced {
            if let Some(former) = std::mem::replace(&mut self.readers[index].source, source) {
                self.watch.remove(index, &former);
            }
            self.begin(index);
        }
    }

    /// Returns the latest time until which a link is paused; `None` if no link is paused at `now`.
    fn paused(&self, now: Time) -> Option<Time> {
        self.readers.iter().filter_map(|reader| reader.paused_until.as_ref()?()).filter(|until| *until > now).max()
    }

    /// Sleeps until a descriptor is readable, the time `next` has come or the pause of links ends, and adds readable
    /// descriptors to `ready`. Does not sleep if `next` has already come. `elapsed` returns the time of the real clock.
    fn sleep(&mut self, now: Time, next: Time, elapsed: impl Fn() -> Time) {
        let pause = self.paused(now);
        let until = pause.map_or(next, |pause| pause.min(next));
        self.watch.wait((now, until.min(now + MAX_SLEEP)), pause.is_some(), elapsed, &mut self.ready);
    }

    /// Calls the callbacks of the file descriptors that the last sleep found readable.
    fn notify(&mut self) {
        for (index, reader) in self.ready.iter().map(|index| (*index, &self.readers[*index])) {
            if reader.end && !reader.reported.replace(true) {
                reader.source.iter().for_each(|source| self.watch.remove(index, source));
            }
            (reader.notify)();
        }
        self.ready.clear();
        self.replace();
    }
}

/// Runs actors in real time on the calling thread. `build` starts the actors, registers the file descriptors to watch,
/// and returns the owner of the actors, which is returned at the end. Time counts from `origin`. The run ends when
/// `done`, called in each turn of the event loop, returns true.
pub fn run_real<W>(
    origin: Instant,
    build: impl FnOnce(&Clock, &mut Readers) -> W,
    mut done: impl FnMut(&W, Time) -> bool,
) -> W {
    let elapsed = || Time::from_nanos(u64::try_from(origin.elapsed().as_nanos()).expect("a run is below 500 years"));
    in_system(|| {
        let (clock, mut readers, mut actors) = (Clock::default(), Readers::new(), Tasks::new());
        clock.set(elapsed());
        let world = {
            let _inside = actors.enter();
            build(&clock, &mut readers)
        };
        loop {
            let now = elapsed();
            clock.set(now);
            while clock.catch_up() {}
            actors.drain(&clock);
            readers.notify();
            actors.drain(&clock);
            if done(&world, now) {
                break;
            }
            readers.sleep(now, clock.latest().unwrap_or(Time::MAX), elapsed);
        }
        clock.clear();
        world
    })
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;
    use std::io::{Read, Write};
    use std::os::unix::net::UnixStream;

    use super::*;

    /// Limit of a run that ends by itself: a loaded machine may take longer than the events.
    const LONG: Span = Span::from_millis(5000);

    /// Runs what `build` starts for 5 ms of real time at least.
    fn run(build: impl FnOnce(&Clock, &mut Readers)) {
        run_until(Span::from_millis(5), build, || false);
    }

    /// Runs what `build` starts until `done`, for `limit` of real time at most.
    fn run_until(limit: Span, build: impl FnOnce(&Clock, &mut Readers), done: impl Fn() -> bool) {
        let until = Time::ZERO + limit;
        run_real(
            Instant::now(),
            |clock, readers| {
                build(clock, readers);
                clock.call(until, Box::new(|| {}));
            },
            |(), now| now >= until || done(),
        );
    }

    #[test]
    fn a_descriptor_calls_until_it_is_read() {
        let (mut here, there) = UnixStream::pair().unwrap();
        here.write_all(b"ab").unwrap();
        let read = Rc::new(RefCell::new(Vec::new()));
        let (said, source) = (Rc::clone(&read), Rc::new(there));
        let build = move |_: &Clock, readers: &mut Readers| {
            let from = Rc::clone(&source);
            readers.watch(source, move || {
                let mut byte = [0];
                (&*from).read_exact(&mut byte).unwrap();
                said.borrow_mut().push(byte[0]);
            });
        };
        run_until(LONG, build, || read.borrow().len() == 2);
        assert_eq!(*read.borrow(), b"ab");
    }

    #[test]
    fn a_paused_link_is_not_read_and_delays_nothing() {
        let (mut here, there) = UnixStream::pair().unwrap();
        here.write_all(b"a").unwrap();
        let (calls, called) = (Rc::new(Cell::new(0)), Rc::new(Cell::new(false)));
        let (notify, call) = (Rc::clone(&calls), Rc::clone(&called));
        run(move |clock, readers| {
            readers.watch_link(Rc::new(there), || Some(Time::MAX), move || notify.set(notify.get() + 1));
            clock.call(Time::ZERO + Span::from_millis(2), Box::new(move || call.set(true)));
        });
        assert_eq!((calls.get(), called.get()), (0, true));
    }

    #[test]
    fn the_end_of_a_pipe_is_reported_once_and_a_regular_file_has_none() {
        let (here, there) = UnixStream::pair().unwrap();
        drop(there);
        let (calls, over) = (Rc::new(Cell::new(0)), Rc::new(Cell::new(false)));
        let (notify, end) = (Rc::clone(&calls), Rc::clone(&over));
        let build = move |clock: &Clock, readers: &mut Readers| {
            let later = clock.clone();
            let ended = move || {
                notify.set(notify.get() + 1);
                // A second report would come at once.
                let end = Rc::clone(&end);
                later.call(later.now() + Span::from_millis(5), Box::new(move || end.set(true)));
            };
            readers.watch_end(Rc::new(here), ended);
            readers.watch_end(Rc::new(tempfile::tempfile().unwrap()), || panic!("a file does not end"));
        };
        run_until(LONG, build, || over.get());
        assert_eq!(calls.get(), 1);
    }

    #[test]
    fn a_link_that_was_opened_again_is_watched_in_place_of_the_one_before() {
        let ((_, old), (mut here, new)) = (UnixStream::pair().unwrap(), UnixStream::pair().unwrap());
        here.write_all(b"a").unwrap();
        // The other end of the first is closed, so it stays readable until it is not watched any more.
        let (calls, over) = (Rc::new(Cell::new(0)), Rc::new(Cell::new(false)));
        let (seen, end, new) = (Rc::clone(&calls), Rc::clone(&over), Rc::new(new));
        let build = move |clock: &Clock, readers: &mut Readers| {
            let handle: Rc<RefCell<Option<Watched>>> = Rc::default();
            let (replace, later, notify) = (Rc::clone(&handle), clock.clone(), Rc::clone(&seen));
            let notify = move || {
                notify.set(notify.get() + 1);
                let handle = replace.borrow().clone().expect("it is registered");
                if notify.get() > 1 {
                    (&*new).read_exact(&mut [0]).expect("the second is read");
                    let end = Rc::clone(&end);
                    later.call(later.now() + Span::from_millis(5), Box::new(move || end.set(true)));
                    return;
                }
                handle.replace(None);
                let again = Rc::clone(&new);
                later.call(later.now() + Span::from_millis(1), Box::new(move || handle.replace(Some(again))));
            };
            *handle.borrow_mut() = Some(readers.watch_link(Rc::new(old), || None, notify));
        };
        run_until(LONG, build, || over.get());
        assert_eq!(calls.get(), 2);
    }

    #[test]
    fn what_is_due_comes_before_what_has_arrived() {
        let (here, there) = UnixStream::pair().unwrap();
        let here = Rc::new(here);
        let write = Rc::clone(&here);
        let order = Rc::new(RefCell::new(Vec::new()));
        let (first, second, source) = (Rc::clone(&order), Rc::clone(&order), Rc::new(there));
        let build = move |clock: &Clock, readers: &mut Readers| {
            let from = Rc::clone(&source);
            readers.watch(source, move || {
                (&*from).read_exact(&mut [0]).unwrap();
                second.borrow_mut().push("arrived");
            });
            // Held up here until another event is due and a byte has arrived: both wait when the next turn begins.
            let due = clock.clone();
            let act = move || {
                (&*write).write_all(b"a").unwrap();
                due.call(due.now() + Span::from_nanos(1), Box::new(move || first.borrow_mut().push("due")));
            };
            clock.call(Time::ZERO + Span::from_millis(1), Box::new(act));
        };
        run_until(LONG, build, || order.borrow().len() == 2);
        assert_eq!(*order.borrow(), ["due", "arrived"]);
    }
}
