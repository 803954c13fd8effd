//! Worker of the source `gpsd`: a TCP client that subscribes to reports and passes the lines on unchanged.

use std::io;
use std::net::SocketAddr;
use std::pin::pin;
use std::time::Duration;

use actix::{Actor, ActorContext, ActorFutureExt, AsyncContext, Context, Handler, Recipient, Supervised, WrapFuture};
use futures_util::future::select;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpStream, lookup_host};
use tokio::time::timeout;

use murmurate::edge::{Input, Packet, PacketSender, Port, Seat, Worker};
use murmurate::messages::ids::RobotId;

/// Request that subscribes to reports (gpsd_json(5)).
const WATCH: &[u8] = b"?WATCH={\"enable\":true,\"json\":true};\n";
/// Longest accepted line \[bytes\]; the limit of gpsd itself is 10240. A longer line is cut, which makes it malformed.
const LONGEST: usize = 16_384;
/// Timeout for the TCP connection to gpsd to be opened.
const CONNECT: Duration = Duration::from_millis(500);
/// Time without a byte after which the connection counts as lost. Receivers report each second or faster.
const SILENT: Duration = Duration::from_secs(5);
/// Time without a byte after which the name of gpsd's host is resolved again. Another address ends the connection.
const UNSURE: Duration = Duration::from_secs(1);
/// Pause after the first failed connection to gpsd, and longest pause. The pause doubles after each further failure.
const PAUSES: [Duration; 2] = [Duration::from_millis(200), Duration::from_millis(3200)];

/// Worker of the source `gpsd`: a TCP client that receives the reports of gpsd and connects again after errors.
pub struct Subscriber {
    /// Address and TCP port of gpsd, or name of its host with the port. A name is resolved for each connection.
    pub address: String,
    /// Robot that the receiver is on, for log messages.
    pub robot: RobotId,
}

impl Worker for Subscriber {
    fn start(self: Box<Self>, seat: Seat) -> Recipient<Input> {
        seat.start(move |port| Client { config: *self, port, pause: Duration::ZERO, failures: 0 })
    }
}

/// Actor that receives the reports of gpsd. An end of the connection ends its life; then it is started again.
struct Client {
    config: Subscriber,
    port: Port,
    /// Pause before the next connection; zero before the first and after one that has had a line.
    pause: Duration,
    /// Number of connections that have failed or ended so far, since one has had a line.
    failures: u32,
}

impl Actor for Client {
    type Context = Context<Self>;

    fn started(&mut self, context: &mut Context<Self>) {
        self.port.resume(self.pause, context, Client::subscribe);
    }
}

impl Supervised for Client {
    fn restarting(&mut self, _: &mut Context<Self>) {
        self.pause = (2 * self.pause).clamp(PAUSES[0], PAUSES[1]);
    }
}

impl Handler<Input> for Client {
    type Result = ();

    fn handle(&mut self, input: Input, context: &mut Context<Self>) {
        if input == Input::Close {
            context.stop();
        }
    }
}

impl Client {
    fn subscribe(&mut self, context: &mut Context<Self>) {
        let (address, sender) = (self.config.address.clone(), self.port.sender());
        let following = async move {
            let mut lines = Lines::default();
            let error = match connect(&address).await {
                Ok(stream) => follow(stream, &address, &mut lines, &sender).await,
                Err(error) => error,
            };
            (lines.passed > 0, error)
        };
        context.spawn(following.into_actor(self).map(|(heard, error), client, context| {
            client.fail(heard, &error);
            context.stop();
        }));
    }

    /// Counts the end of a connection, and logs the ends 1, 2, 4, 8 and so on.
    fn fail(&mut self, heard: bool, error: &io::Error) {
        if heard {
            (self.pause, self.failures) = (Duration::ZERO, 0);
        }
        self.failures += 1;
        if self.failures.is_power_of_two() {
            let Subscriber { address, robot } = &self.config;
            tracing::warn!("no reports of gpsd at {address} for {robot}: {error}; does it run, with its receiver?");
        }
    }
}

/// Connects to gpsd at `address` and requests its reports.
async fn connect(address: &str) -> io::Result<TcpStream> {
    let mut connected = Err(io::Error::other("its name has no address"));
    for at in lookup_host(address).await? {
        connected = timeout(CONNECT, TcpStream::connect(at)).await.unwrap_or(Err(io::ErrorKind::TimedOut.into()));
        if connected.is_ok() {
            break;
        }
    }
    let mut stream = connected?;
    stream.write_all(WATCH).await?;
    Ok(stream)
}

/// Passes lines from gpsd to the source, until the connection ends or is silent. Returns the reason.
async fn follow(mut stream: TcpStream, address: &str, lines: &mut Lines, sender: &PacketSender) -> io::Error {
    let mut buffer = [0; 4096];
    let at = match stream.peer_addr() {
        Ok(at) => at,
        Err(error) => return error,
    };
    loop {
        let read = match timeout(UNSURE, stream.read(&mut buffer)).await {
            Ok(read) => read,
            // A resolver may take seconds, in which readings may come again.
            Err(_) => match timeout(SILENT - UNSURE, first(stream.read(&mut buffer), moved(address, at))).await {
                Ok(read) => read,
                Err(_) => return io::Error::other("it is silent"),
            },
        };
        match read {
            Ok(0) => return io::Error::other("it has closed the connection"),
            Ok(length) => lines.take(&buffer[..length], |line| sender.send(line)),
            Err(error) => return error,
        }
    }
}

/// Resolves the name of gpsd's host again. Is ready, with an error, only if the name has other addresses than `at` now.
async fn moved(address: &str, at: SocketAddr) -> io::Result<usize> {
    match lookup_host(address).await {
        Ok(mut now) => {
            if now.any(|now| now == at) {
                return std::future::pending().await;
            }
            Err(io::Error::other(format!("it is silent at {at}, and its name has another address now")))
        }
        Err(_) => std::future::pending().await,
    }
}

/// Returns the output of the future that is ready first.
async fn first<T>(one: impl Future<Output = T>, other: impl Future<Output = T>) -> T {
    select(pin!(one), pin!(other)).await.factor_first().0
}

/// Splitter of a byte stream into lines.
#[derive(Debug, Default)]
struct Lines {
    /// Bytes of the current, unfinished line.
    begun: Vec<u8>,
    /// Number of complete lines so far.
    passed: u64,
}

impl Lines {
    /// Takes the next bytes, and calls `each` with every line that they complete.
    fn take(&mut self, bytes: &[u8], mut each: impl FnMut(Packet)) {
        for byte in bytes {
            match byte {
                b'\n' => {
                    self.passed += 1;
                    each(Packet::from(std::mem::take(&mut self.begun)));
                }
                b'\r' => {}
                _ if self.begun.len() < LONGEST => self.begun.push(*byte),
                _ => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_put_together_and_a_long_one_is_cut() {
        let (mut lines, mut all) = (Lines::default(), Vec::new());
        for bytes in [&b"ab"[..], b"c\r\n\nd", b"e\n", &[b'x'; 20_000], b"\nf"] {
            lines.take(bytes, |line| all.push(line.into_vec()));
        }
        assert_eq!(all[..3], [b"abc".to_vec(), b"".to_vec(), b"de".to_vec()]);
        assert_eq!((all[3].len(), all.len(), lines.passed), (LONGEST, 4, 4));
    }
}
