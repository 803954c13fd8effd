//! Worker of the driver and of the source `mavlink`: an actor that has the link with one autopilot, by UDP or a serial
//! line. It numbers and signs what is sent, checks what is received, and leaves out what is not read here.
//!
//! When a motion's validity ends without a newer packet, it makes the vehicle stand for a second. After that, what the
//! autopilot does without setpoints is better than what a host does whose control thread hangs.

use std::io::{self, Read};
use std::net::SocketAddr;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::rc::Rc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use actix::{Actor, ActorContext, AsyncContext, Context, Handler, Recipient, SpawnHandle, StreamHandler, Supervised};
use mavlink::dialects::common::MavMessage;
use murmurate::config::{ConfigError, regular};
use murmurate::edge::{Input, Port, Seat, Worker};
use tokio::net::UdpSocket;

use super::address::Address;
use super::frames::{Found, Framer, Splitter, Version, header, parse, raw};
use super::link::{FromWorker, Hold, REFUSALS, Refusal, ToWorker};
use super::orders::WANTED;
use super::settings::{AUTOPILOT, LinkSettings};
use super::signing::{Key, Signer, Unsound};
use super::sockets::{self, Link, Received};

/// Pause before a link that cannot be opened, or was lost, is opened again.
const PAUSE: Duration = Duration::from_secs(1);
/// Period of the frames that make a vehicle stand whose motion has expired, and their number.
const STAND: (Duration, u32) = (Duration::from_millis(100), 10);
/// Longest validity of a motion, equal to that of a motor command on a link.
const LONGEST_HOLD: Duration = Duration::from_millis(1000);
/// Period at which the same refusal is reported again.
const REFUSED: Duration = Duration::from_millis(200);
/// Silence of an autopilot after which another address may be its new one.
const MOVED: Duration = Duration::from_secs(3);
/// Period of what a source says to its autopilot: heartbeats, and so many of them to a request for messages.
const REMINDERS: (Duration, u32) = (Duration::from_secs(1), 5);
/// Largest file of a key \[bytes\].
const LARGEST_KEY: u64 = 4096;
/// Beginning of the year 2015, from which signatures count \[s since 1970\] (MAVLink guide, "Message Signing").
const YEAR_2015_S: u64 = 1_420_070_400;

/// Worker of one link with an autopilot.
pub struct Endpoint {
    /// Settings of the link.
    pub link: LinkSettings,
    /// Frames that are sent to the autopilot by themselves: a heartbeat, and requests. Empty for a driver, which says
    /// it.
    pub reminders: Vec<MavMessage>,
}

impl Endpoint {
    /// Returns the key of the link's signatures, from its file. The error names the setting.
    fn key(&self) -> Result<Option<Key>, ConfigError> {
        let Some(path) = &self.link.key_file else { return Ok(None) };
        let wrong = |why: String| ConfigError::field("signing_key_file", format!("{path}: {why}"));
        let read = || {
            let file = regular::open(Path::new(path))?;
            let (mode, mut text) = (file.metadata()?.permissions().mode(), Vec::new());
            file.take(LARGEST_KEY).read_to_end(&mut text)?;
            Ok::<_, io::Error>((mode, text))
        };
        let (mode, text) = read().map_err(|error| wrong(error.to_string()))?;
        if mode & 0o077 != 0 {
            return Err(wrong(format!(
                "others may read it (mode {:04o}); make it private with chmod 600",
                mode & 0o777
            )));
        }
        Key::read(&text).map(Some).map_err(wrong)
    }
}

impl Worker for Endpoint {
    fn check(&self) -> Result<(), ConfigError> {
        self.key().map(drop)
    }

    fn claim(&self) -> Option<String> {
        // Several hosts of a machine may send to one address.
        (!matches!(self.link.address, Address::Out(_))).then(|| format!("address {}", self.link.address))
    }

    fn start(self: Box<Self>, seat: Seat) -> Recipient<Input> {
        seat.start(move |port| Talker::new(*self, port))
    }
}

/// Actor that has the link with one autopilot. Its life ends with an error of the link; then it is started again.
struct Talker {
    endpoint: Endpoint,
    port: Port,
    framer: Framer,
    link: Option<Link>,
    splitter: Splitter,
    /// Address of the autopilot, and when it was heard from there last; `None` before, and on a serial line.
    peer: Option<(SocketAddr, Option<Instant>)>,
    /// Socket for copies of the autopilot's frames.
    copies: Option<Rc<UdpSocket>>,
    /// Frame that makes the vehicle stand; empty before the driver has given it.
    stand: Vec<u8>,
    /// Timer of the end of a motion's validity.
    timer: Option<SpawnHandle>,
    /// Number of refused frames for each reason, and when the reason was reported last.
    refused: [(u64, Option<Instant>); REFUSALS.len()],
    pause: Duration,
    /// Last reason for which the link was closed, which is logged once.
    logged: String,
}

impl Actor for Talker {
    type Context = Context<Self>;

    fn started(&mut self, context: &mut Context<Self>) {
        self.port.resume(std::mem::take(&mut self.pause), context, Talker::open);
    }
}

impl Supervised for Talker {
    fn restarting(&mut self, _: &mut Context<Self>) {
        (self.link, self.copies, self.timer, self.splitter) = (None, None, None, Splitter::default());
    }
}

impl Handler<Input> for Talker {
    type Result = ();

    fn handle(&mut self, input: Input, context: &mut Context<Self>) {
        match input {
            Input::Packet(packet) => self.carry_out(&packet, context),
            Input::Close => {
                if self.timer.is_some() {
                    self.make_stand();
                }
                context.stop();
            }
        }
    }
}

impl StreamHandler<Received> for Talker {
    fn handle(&mut self, received: Received, context: &mut Context<Self>) {
        match received {
            Ok((from, bytes)) => self.take(from, &bytes),
            Err(error) => self.lose(&error, context),
        }
    }

    /// A link has no end of its own.
    fn finished(&mut self, _: &mut Context<Self>) {}
}

impl Talker {
    fn new(endpoint: Endpoint, port: Port) -> Talker {
        let (system, component) = endpoint.link.own;
        let version = if endpoint.link.version == 1 { Version::One } else { Version::Two };
        Talker {
            framer: Framer::new(system, component, version),
            endpoint,
            port,
            link: None,
            splitter: Splitter::default(),
            peer: None,
            copies: None,
            stand: Vec::new(),
            timer: None,
            refused: [(0, None); REFUSALS.len()],
            pause: Duration::ZERO,
            logged: String::new(),
        }
    }

    /// Opens the link and begins to receive.
    fn open(&mut self, context: &mut Context<Self>) {
        // Stamps go on growing, also over a new life.
        if self.framer.signer.is_none() {
            match self.endpoint.key() {
                Ok(key) => self.framer.signer = key.map(Signer::new),
                Err(error) => return self.lose(&io::Error::other(error.to_string()), context),
            }
        }
        if let Address::Out(to) = &self.endpoint.link.address {
            self.peer = Some((SocketAddr::V4(*to), None));
        }
        let link = match Link::open(&self.endpoint.link.address) {
            Ok(link) => link,
            Err(error) => return self.lose(&error, context),
        };
        if self.endpoint.link.forward.is_some() {
            match sockets::any() {
                Ok(socket) => self.copies = Some(socket),
                Err(error) => return self.lose(&error, context),
            }
        }
        context.add_stream(sockets::received(link.clone()));
        self.link = Some(link);
        self.logged.clear();
        self.port.send(FromWorker::Opened.encode());
        if !self.endpoint.reminders.is_empty() {
            let mut beats = 0;
            context.run_interval(REMINDERS.0, move |talker, _| {
                let all = beats % REMINDERS.1 == 0;
                beats += 1;
                talker.remind(all);
            });
        }
    }

    /// Ends this life of the actor after an error of the link.
    fn lose(&mut self, error: &io::Error, context: &mut Context<Self>) {
        let address = &self.endpoint.link.address;
        let advice = match address {
            Address::In(_) => "does another program listen there? (`ss -ulnp` names it)",
            Address::Out(_) => "is the network up?",
            Address::Serial { .. } => "is the autopilot plugged in, and is this user in the group dialout?",
        };
        let why = format!("{address}: {error}; {advice}");
        if self.logged != why {
            tracing::error!("no link with the autopilot by {why}");
            self.logged.clone_from(&why);
        }
        self.port.send(FromWorker::Closed(why.as_bytes()).encode());
        self.pause = PAUSE;
        context.stop();
    }

    fn carry_out(&mut self, packet: &[u8], context: &mut Context<Self>) {
        match ToWorker::decode(packet) {
            Some(ToWorker::Send(hold, frames)) => {
                match hold {
                    Hold::Keep => {}
                    Hold::Standing => self.stand_after(None, context),
                    Hold::For(span) => {
                        let hold = Duration::from_nanos(span.as_nanos()).min(LONGEST_HOLD);
                        self.stand_after(Some((hold, STAND.1)), context);
                    }
                }
                self.write(frames);
            }
            Some(ToWorker::Stand(frame)) => self.stand = frame.to_vec(),
            None => tracing::error!("the driver's packet is not understood"),
        }
    }

    /// Sets the time after which the vehicle is made to stand without a newer packet, and how often; `None` for never.
    fn stand_after(&mut self, hold: Option<(Duration, u32)>, context: &mut Context<Self>) {
        if let Some(timer) = self.timer.take() {
            context.cancel_future(timer);
        }
        self.timer = hold.map(|(hold, times)| {
            context.run_later(hold, move |talker, context| {
                if times == STAND.1 {
                    tracing::error!("the control thread is silent: the vehicle is made to stand");
                }
                talker.make_stand();
                let next = (times > 1).then_some((STAND.0, times - 1));
                talker.stand_after(next, context);
            })
        });
    }

    fn make_stand(&mut self) {
        let stand = std::mem::take(&mut self.stand);
        self.write(&stand);
        self.stand = stand;
    }

    fn remind(&mut self, all: bool) {
        let count = if all { self.endpoint.reminders.len() } else { 1 };
        let messages: Vec<MavMessage> = self.endpoint.reminders.iter().take(count).cloned().collect();
        messages.iter().for_each(|message| self.say(message));
    }

    /// Sends frames of the driver under numbers of this link, signed if the link is.
    fn write(&mut self, frames: &[u8]) {
        let (mut splitter, mut messages) = (Splitter::default(), Vec::new());
        splitter.take(frames, |found| {
            if let Found::Frame(frame) = found {
                messages.extend(parse(frame));
            }
        });
        messages.iter().for_each(|received| self.say(&received.message));
    }

    /// Sends a message, if the autopilot's address is known. A link that takes no more loses it: the next one comes.
    fn say(&mut self, message: &MavMessage) {
        let frame = self.framer.frame(now(), message);
        if let Some(link) = &self.link {
            link.send(&frame, self.peer.map(|(peer, _)| peer));
        }
    }

    /// Takes bytes that the link has received: a datagram of a sender, or a piece of a serial line's.
    fn take(&mut self, from: Option<SocketAddr>, bytes: &[u8]) {
        let mut splitter = std::mem::take(&mut self.splitter);
        let (mut kept, mut copied) = (Vec::new(), Vec::new());
        let mut damaged = false;
        splitter.take(bytes, |found| match found {
            Found::Frame(frame) => {
                if let Some(wanted) = self.judge(from, frame) {
                    copied.extend_from_slice(frame);
                    if wanted {
                        kept.extend_from_slice(frame);
                    }
                }
            }
            Found::Unknown => {}
            Found::Damaged => damaged = true,
        });
        damaged |= from.is_some() && splitter.end();
        self.splitter = splitter;
        if damaged {
            self.refuse(Refusal::Damaged);
        }
        if !kept.is_empty() {
            self.port.send(FromWorker::Frames(&kept).encode());
        }
        if let (Some(to), Some(socket)) = (self.endpoint.link.forward, &self.copies)
            && !copied.is_empty()
        {
            // A program that does not listen misses it.
            let _ = socket.try_send_to(&copied, to.into());
        }
    }

    /// Judges a frame: `None` if it is not of the autopilot or is refused, and else whether it is one that is read.
    fn judge(&mut self, from: Option<SocketAddr>, frame: &[u8]) -> Option<bool> {
        let header = header(frame)?;
        if (header.system, header.component) != (self.endpoint.link.system, AUTOPILOT) {
            return None;
        }
        let judged = match &mut self.framer.signer {
            None if header.signed => Err(Refusal::Signed),
            None => Ok(()),
            Some(_) if header.version == Version::One => Err(Refusal::Unsigned),
            Some(signer) => signer.check(now(), &raw(frame)).map_err(|unsound| match unsound {
                Unsound::Unsigned => Refusal::Unsigned,
                Unsound::Forged => Refusal::Forged,
                Unsound::Stale => Refusal::Stale,
            }),
        };
        // An autopilot without a clock learns the time from signed frames of this host, so it has to get some.
        if let (Err(Refusal::Stale), None, Some(from)) = (judged, self.peer, from) {
            self.peer = Some((from, None));
        }
        let judged = judged.and_then(|()| self.comes_from(from));
        if let Err(refusal) = judged {
            self.refuse(refusal);
            return None;
        }
        Some(WANTED.contains(&header.id))
    }

    /// Takes over that a sound frame came from an address, unless the autopilot was heard from another one just now.
    fn comes_from(&mut self, from: Option<SocketAddr>) -> Result<(), Refusal> {
        let Some(from) = from else { return Ok(()) };
        let now = Instant::now();
        match self.peer {
            Some((peer, Some(at))) if peer != from && now.duration_since(at) < MOVED => Err(Refusal::Second),
            // Where this host sends to is fixed: another sender is none.
            Some((peer, _)) if peer != from && matches!(self.endpoint.link.address, Address::Out(_)) => {
                Err(Refusal::Second)
            }
            _ => {
                self.peer = Some((from, Some(now)));
                Ok(())
            }
        }
    }

    /// Counts a refused frame, logs it if its number is 1, 2, 4, 8 and so on, and reports it at most every 0.2 s.
    fn refuse(&mut self, refusal: Refusal) {
        let at = REFUSALS.iter().position(|one| *one == refusal).expect("all are in the table");
        let (count, reported) = &mut self.refused[at];
        *count += 1;
        if count.is_power_of_two() {
            tracing::warn!(refused = *count, "{}: {}", self.endpoint.link.address, refusal.why());
        }
        if reported.is_none_or(|at| at.elapsed() >= REFUSED) {
            *reported = Some(Instant::now());
            self.port.send(FromWorker::Refused(refusal).encode());
        }
    }
}

/// Returns the time for signatures: units of 10 us since the beginning of 2015.
fn now() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.saturating_sub(Duration::from_secs(YEAR_2015_S)).as_micros() / 10).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_file_is_private_whole_and_never_quoted() {
        let folder = tempfile::TempDir::new().expect("a folder");
        let path = folder.path().join("link.key");
        let digits = "5a".repeat(32);
        let link = LinkSettings {
            address: "udpin://127.0.0.1:14540".parse().expect("an address"),
            system: 1,
            own: (1, 191),
            version: 2,
            key_file: Some(path.to_string_lossy().into_owned()),
            forward: None,
        };
        let endpoint = Endpoint { link, reminders: Vec::new() };
        let refused = |part: &str| {
            let error = endpoint.check().expect_err(part).to_string();
            assert!(error.starts_with("signing_key_file: ") && error.contains(part), "{error}");
            assert!(!error.contains(&digits[..16]) && !error.contains('\n'), "{error}");
        };
        refused("No such file");
        std::fs::write(&path, format!("{digits}\n")).expect("it is written");
        let may = |mode| std::fs::set_permissions(&path, PermissionsExt::from_mode(mode)).expect("it is ours");
        may(0o640);
        refused("chmod 600");
        may(0o600);
        endpoint.check().expect("a key");
        std::fs::write(&path, &digits[1..]).expect("it is written");
        refused("64 hexadecimal digits");
    }
}
