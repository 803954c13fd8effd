//! Waiting for file descriptors and a time where there is no `epoll`, such as on macOS: by `poll`. For work at a desk:
//! a wait ends up to a millisecond late, and costs more the more descriptors there are.

use std::os::fd::AsFd;
use std::rc::Rc;

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

use crate::time::Time;

/// File descriptors that are watched, each with an index.
pub(super) struct Watch(Vec<Watched>);

struct Watched {
    index: usize,
    source: Rc<dyn AsFd>,
    end: bool,
    pausable: bool,
}

impl Watch {
    /// Creates an empty set.
    pub(super) fn new() -> Watch {
        Watch(Vec::new())
    }

    /// Starts to watch `source`, which has this index: until it is readable or, with `end`, until its other end is
    /// closed, which a regular file never is.
    pub(super) fn add(&mut self, index: usize, source: &Rc<dyn AsFd>, end: bool, pausable: bool) -> bool {
        self.0.push(Watched { index, source: Rc::clone(source), end, pausable });
        true
    }

    /// Ends the watch of the descriptor with this index.
    pub(super) fn remove(&mut self, index: usize, _: &Rc<dyn AsFd>) {
        self.0.retain(|watched| watched.index != index);
    }

    /// Sleeps until a descriptor is ready or the time `until` has come, and appends the indices of those that are to
    /// `ready`. Does not sleep if `until` is not after `now`. While `paused`, pausable descriptors are not watched.
    /// `elapsed` returns the time of the real clock.
    pub(super) fn wait(
        &mut self,
        (now, until): (Time, Time),
        paused: bool,
        elapsed: impl Fn() -> Time,
        ready: &mut Vec<usize>,
    ) {
        let left = if until <= now { 0 } else { until.since(elapsed()).as_nanos().div_ceil(1_000_000) };
        let watched: Vec<&Watched> = self.0.iter().filter(|watched| !(paused && watched.pausable)).collect();
        let flags = |end| if end { PollFlags::empty() } else { PollFlags::POLLIN };
        let mut polled: Vec<PollFd> =
            watched.iter().map(|watched| PollFd::new(watched.source.as_fd(), flags(watched.end))).collect();
        match poll(&mut polled, PollTimeout::from(u16::try_from(left).unwrap_or(u16::MAX))) {
            Ok(_) => {}
            // What is ready is found by the next wait.
            Err(Errno::EINTR) => return,
            Err(error) => panic!("the kernel does not watch descriptors that are open: {error}"),
        }
        let found = watched.iter().zip(&polled).filter(|(_, polled)| polled.any().unwrap_or(true));
        ready.extend(found.map(|(watched, _)| watched.index));
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::os::unix::net::UnixStream;
    use std::time::Instant;

    use super::*;
    use crate::time::Span;

    #[test]
    fn descriptors_are_ready_until_they_are_read_ended_or_paused_and_the_time_ends_a_wait() {
        let origin = Instant::now();
        let elapsed = || Time::from_nanos(u64::try_from(origin.elapsed().as_nanos()).expect("it is short"));
        let (mut near, far) = UnixStream::pair().unwrap();
        let (pipe, writer) = std::io::pipe().unwrap();
        let (far, writer) = (Rc::new(far), Rc::new(writer));
        let mut watch = Watch::new();
        assert!(watch.add(0, &(Rc::clone(&far) as Rc<dyn AsFd>), false, true));
        assert!(watch.add(1, &(writer as Rc<dyn AsFd>), true, false));
        let wait = |watch: &mut Watch, paused| {
            let (mut ready, now) = (Vec::new(), elapsed());
            watch.wait((now, now + Span::from_nanos(1_500_000)), paused, elapsed, &mut ready);
            (ready.clone(), ready.is_empty() && elapsed() >= now + Span::from_nanos(1_500_000))
        };
        assert_eq!(wait(&mut watch, false), (vec![], true), "not before its time");
        near.write_all(&[1]).unwrap();
        assert_eq!(wait(&mut watch, true), (vec![], true), "paused");
        assert_eq!((wait(&mut watch, false).0, wait(&mut watch, false).0), (vec![0], vec![0]));
        (&*far).read_exact(&mut [0]).unwrap();
        drop(pipe);
        // A process that another test starts just now has the other end for a moment, too.
        let ended = (0..10_000).map(|_| wait(&mut watch, false).0).find(|ready| !ready.is_empty());
        assert_eq!(ended, Some(vec![1]), "its other end is closed");
        watch.remove(1, &(Rc::clone(&far) as Rc<dyn AsFd>));
        assert_eq!(wait(&mut watch, false), (vec![], true));
    }
}
