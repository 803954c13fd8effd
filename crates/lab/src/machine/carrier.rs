//! Event loop of a laboratory in real time: one thread that holds all TAP interfaces, and runs the medium by the
//! monotonic clock. It sleeps until the medium's next event, or until a station has sent a frame.
//!
//! The medium never waits for this thread: a frame is delivered at the time that the channel says, and if the thread
//! comes too late, the channel goes on as if it had been in time. How late each frame was written is counted.

use std::io::{self, ErrorKind, Write};
use std::os::fd::AsFd;
use std::os::unix::net::UnixListener;
use std::process::{Command, Stdio};
use std::time::{SystemTime, UNIX_EPOCH};

use nix::errno::Errno;
use nix::sys::epoll::{Epoll, EpollCreateFlags, EpollEvent, EpollFlags, EpollTimeout};
use nix::sys::time::TimeSpec;
use nix::sys::timerfd::{ClockId as TimerClock, Expiration, TimerFd, TimerFlags, TimerSetTimeFlags};
use nix::time::{ClockId, clock_gettime};
use tappers::Tap;

use super::error::{Context, Result};
use crate::capture::Capture;
use crate::ethernet::MAX_FRAME_BYTES;
use crate::file::Laboratory;
use crate::lateness::Lateness;
use crate::medium::{Found, Medium};
use crate::report::LabReport;
use murmurate::time::{Span, Time};

/// Frames that are read from a station before another one has its turn.
const BATCH: usize = 16;
/// Largest number of events that one wait reports; the next wait reports the others.
const MAX_EVENTS: usize = 64;
/// Bytes of a capture that are handed to its writer at once.
const CAPTURE_BYTES: usize = 1 << 14;
/// Time in which a sleeping thread wakes up after a frame was sent \[ns\], about as measured on a virtual machine.
const WAKE_UP_NS: u64 = 50_000;
/// Longest time that a wait takes if it does not sleep \[ns\].
const NO_SLEEP_NS: u64 = 5_000;
/// Keys of what is watched beside the stations, which have their numbers.
const TIMER: u64 = u64::MAX;
const CONTROL: u64 = u64::MAX - 1;
const STOP: u64 = u64::MAX - 2;

/// Returns the time of the monotonic clock \[ns\], which all processes of a machine share.
pub fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::CLOCK_MONOTONIC).expect("Linux has a monotonic clock");
    now.tv_sec().cast_unsigned() * 1_000_000_000 + now.tv_nsec().cast_unsigned()
}

/// Timer of the kernel that ends a sleep at a time of the monotonic clock.
pub struct Alarm {
    timer: TimerFd,
    /// Time for which the timer is set \[ns\]; zero before it is first set.
    set_for: u64,
}

impl Alarm {
    /// Makes the timer, and adds it to `epoll` under the key `key`.
    pub fn new(epoll: &Epoll, key: u64) -> Result<Alarm> {
        let flags = TimerFlags::TFD_NONBLOCK | TimerFlags::TFD_CLOEXEC;
        let timer = TimerFd::new(TimerClock::CLOCK_MONOTONIC, flags).context("cannot make a timer")?;
        // Edge-triggered, so that it need not be read before it is set again.
        let event = EpollEvent::new(EpollFlags::EPOLLIN | EpollFlags::EPOLLET, key);
        epoll.add(timer.as_fd(), event).context("cannot watch a timer")?;
        Ok(Alarm { timer, set_for: 0 })
    }

    /// Sets the timer for a time of the monotonic clock \[ns\], unless it is set for that time.
    pub fn set(&mut self, at_ns: u64) -> Result<()> {
        if self.set_for != at_ns {
            let at = TimeSpec::from_duration(std::time::Duration::from_nanos(at_ns.max(1)));
            let absolute = TimerSetTimeFlags::TFD_TIMER_ABSTIME;
            self.timer.set(Expiration::OneShot(at), absolute).context("cannot set a timer")?;
            self.set_for = at_ns;
        }
        Ok(())
    }
}

/// Gives the calling thread a priority above all ordinary threads of the machine (SCHED_FIFO). An error says why it
/// cannot.
pub fn prioritize(priority: u8) -> Result<(), String> {
    if priority == 0 {
        return Ok(());
    }
    let thread = nix::unistd::gettid().to_string();
    let mut command = Command::new("chrt");
    command.args(["--fifo", "--pid", &priority.to_string(), &thread]).stdin(Stdio::null()).stdout(Stdio::null());
    match command.stderr(Stdio::null()).status() {
        Ok(status) if status.success() => Ok(()),
        Ok(_) => Err("the machine does not permit it".to_owned()),
        Err(error) => Err(format!("'chrt' (package util-linux) cannot be started: {error}")),
    }
}

/// Function that is called with each warning for the user, as one line of text.
pub type Warn = fn(&str);

/// Destination of a capture. It never waits for a disk.
pub trait CaptureWriter: Send {
    /// Takes a piece of the file, to be written whole; returns false if it was dropped.
    fn push(&self, piece: Vec<u8>) -> bool;

    /// Waits a short time until everything is written.
    fn flush(&self);
}

/// The stations' interfaces and the medium between them.
pub struct Carrier {
    lab: Laboratory,
    /// Interface of each station; `None` if it is gone.
    taps: Vec<Option<Tap>>,
    medium: Medium,
    lateness: Lateness,
    /// Late deliveries to each station, and frames that its interface did not accept.
    late: Vec<u64>,
    unwritten: Vec<u64>,
    /// Time of the monotonic clock at which the laboratory's time is zero \[ns\].
    origin_ns: u64,
    longest_turn_ns: u64,
    capture: Option<Recording>,
    warn: Warn,
}

/// A capture file that is being written.
struct Recording {
    encoder: Capture,
    writer: Box<dyn CaptureWriter>,
    bytes: Vec<u8>,
    /// Transmissions in `bytes`, and those that are missing in the file.
    pending: u64,
    missing: u64,
}

impl Recording {
    fn hand_over(&mut self) {
        if !self.writer.push(std::mem::take(&mut self.bytes)) {
            self.missing += self.pending;
        }
        self.pending = 0;
    }
}

/// Descriptors that a laboratory watches beside its stations: a socket on which it answers with its counters, if there
/// is one, and a descriptor that becomes readable when it is to end.
pub struct Outside<'a, S> {
    /// Socket for commands.
    pub control: Option<UnixListener>,
    /// Becomes readable when the laboratory is to end.
    pub stop: &'a S,
}

impl Carrier {
    /// Returns a laboratory whose time begins now. Transmissions are captured by `writer`, if there is one, and `warn`
    /// is called with warnings.
    pub fn new(lab: &Laboratory, taps: Vec<Tap>, writer: Option<Box<dyn CaptureWriter>>, warn: Warn) -> Carrier {
        let mut medium = Medium::new(lab);
        let began = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let capture = writer.map(|writer| {
            medium.record_transmissions();
            writer.push(Capture::header());
            let encoder = Capture::new(&lab.radio, began.as_nanos() as u64);
            Recording { encoder, writer, bytes: Vec::new(), pending: 0, missing: 0 }
        });
        let stations = taps.len();
        Carrier {
            lab: lab.clone(),
            taps: taps.into_iter().map(Some).collect(),
            medium,
            lateness: Lateness::new(lab.late),
            late: vec![0; stations],
            unwritten: vec![0; stations],
            origin_ns: monotonic_ns(),
            longest_turn_ns: 0,
            capture,
            warn,
        }
    }

    fn now(&self) -> Time {
        Time::from_nanos(monotonic_ns() - self.origin_ns)
    }

    /// Returns the counters so far.
    pub fn report(&self) -> LabReport {
        let mut report = LabReport::of(&self.lab, &self.medium, &self.lateness, self.now());
        report.pid = std::process::id();
        report.longest_turn_us = self.longest_turn_ns / 1000;
        report.uncaptured = self.capture.as_ref().map_or(0, |capture| capture.missing);
        for (at, station) in report.stations.iter_mut().enumerate() {
            (station.late, station.unwritten) = (self.late[at], self.unwritten[at]);
            station.gone = self.taps[at].is_none();
        }
        report
    }

    /// Carries frames until the laboratory is to end. Returns the final counters.
    pub fn carry<S: AsFd>(mut self, outside: &Outside<'_, S>) -> Result<LabReport> {
        if let Err(why) = prioritize(self.lab.priority) {
            (self.warn)(&format!("warning: the lab has no real-time priority, so frames may be late: {why}"));
        }
        let epoll = Epoll::new(EpollCreateFlags::EPOLL_CLOEXEC).context("cannot watch interfaces")?;
        let watch = |source: &dyn AsFd, key| epoll.add(source.as_fd(), EpollEvent::new(EpollFlags::EPOLLIN, key));
        for (station, tap) in self.taps.iter().enumerate() {
            watch(tap.as_ref().expect("nothing is gone yet"), station as u64).context("cannot watch an interface")?;
        }
        watch(outside.stop, STOP).context("cannot watch for the end")?;
        if let Some(control) = &outside.control {
            control.set_nonblocking(true).context("cannot make a socket non-blocking")?;
            watch(control, CONTROL).context("cannot watch a socket")?;
        }
        let mut alarm = Alarm::new(&epoll, TIMER)?;
        let mut events = [EpollEvent::empty(); MAX_EVENTS];
        let mut buffer = [0; MAX_FRAME_BYTES + 1];
        let mut woken = monotonic_ns();
        loop {
            let now = self.now();
            self.medium.wake(now);
            self.deliver(&epoll);
            self.record();
            let timeout = match self.medium.wake_at() {
                Some(due) if due <= self.now() => EpollTimeout::ZERO,
                Some(due) => {
                    alarm.set(self.origin_ns + due.as_nanos())?;
                    EpollTimeout::NONE
                }
                None => EpollTimeout::NONE,
            };
            let asleep = monotonic_ns();
            self.longest_turn_ns = self.longest_turn_ns.max(asleep - woken);
            let count = match epoll.wait(&mut events, timeout) {
                Ok(count) => count,
                Err(Errno::EINTR) => 0,
                Err(error) => return Err(error).context("cannot wait for frames"),
            };
            let before = std::mem::replace(&mut woken, monotonic_ns());
            let mut found = Vec::new();
            for event in &events[..count] {
                match event.data() {
                    TIMER => {}
                    STOP => return Ok(self.end()),
                    CONTROL => self.answer(outside.control.as_ref().expect("it is watched")),
                    station => self.read(station as usize, &epoll, &mut buffer, &mut found),
                }
            }
            // Nothing was there when a sleep began; without one, frames have come since the last look.
            let slept = woken - asleep;
            let window = if slept > NO_SLEEP_NS { slept.min(WAKE_UP_NS) } else { woken - before };
            let woken_at = Time::from_nanos(woken - self.origin_ns);
            self.medium.take_together(woken_at, Span::from_nanos(window), found);
        }
    }

    /// Reads up to [`BATCH`] frames of a station.
    fn read(&mut self, station: usize, epoll: &Epoll, buffer: &mut [u8], found: &mut Vec<Found>) {
        for _ in 0..BATCH {
            let Some(tap) = &self.taps[station] else { return };
            match tap.recv(buffer) {
                Ok(length) => found.push(Found { station: station as u16, bytes: buffer[..length].to_vec() }),
                Err(error) if [ErrorKind::WouldBlock, ErrorKind::Interrupted].contains(&error.kind()) => return,
                Err(error) => return self.lose(station, epoll, &error),
            }
        }
    }

    /// Writes the frames that have arrived to the interfaces of their receivers, and counts those that are late.
    fn deliver(&mut self, epoll: &Epoll) {
        let mut lost = Vec::new();
        for delivery in self.medium.deliveries() {
            let to = usize::from(delivery.to);
            let Some(tap) = &self.taps[to] else { continue };
            match tap.send(&delivery.token.bytes) {
                Ok(_) => {
                    let made = Time::from_nanos(monotonic_ns() - self.origin_ns);
                    self.late[to] += u64::from(self.lateness.count(delivery.at, made));
                }
                Err(error) => {
                    self.unwritten[to] += 1;
                    // An interface that is down takes no frames, and may come up again.
                    if Errno::from_raw(error.raw_os_error().unwrap_or(0)) == Errno::EBADFD {
                        lost.push((to, error));
                    }
                }
            }
        }
        for (station, error) in lost {
            self.lose(station, epoll, &error);
        }
    }

    /// Goes on without a station whose interface is gone.
    fn lose(&mut self, station: usize, epoll: &Epoll, error: &io::Error) {
        let Some(tap) = self.taps[station].take() else { return };
        // An error means that it is not watched any more, which is the aim.
        let _ = epoll.delete(tap.as_fd());
        (self.warn)(&format!(
            "warning: the interface of station {station} is gone ({error}); the other stations go on without it"
        ));
    }

    /// Encodes new transmissions, and hands them to the capture's writer.
    fn record(&mut self) {
        let Some(capture) = &mut self.capture else { return };
        for sent in self.medium.transmissions() {
            capture.encoder.append(&sent, &mut capture.bytes);
            capture.pending += 1;
        }
        if capture.bytes.len() > CAPTURE_BYTES {
            capture.hand_over();
        }
    }

    /// Answers a command on the socket with the counters.
    fn answer(&mut self, control: &UnixListener) {
        let Ok((mut stream, _)) = control.accept() else { return };
        if let (Ok(()), Ok(text)) = (stream.set_nonblocking(true), serde_json::to_vec(&self.report())) {
            // A client that does not read gets nothing.
            let _ = stream.write_all(&text);
        }
    }

    /// Returns the final counters, after the capture is written.
    fn end(mut self) -> LabReport {
        if let Some(capture) = &mut self.capture {
            capture.hand_over();
            capture.writer.flush();
        }
        self.report()
    }
}
