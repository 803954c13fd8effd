//! TCP connection between the coordinator and a participant of a measurement: one JSON object per line, with an
//! authentication tag if the team has a key. `mod.rs` defines the messages.
//!
//! Each side first sends a random nonce. A tag is a keyed hash of the sender's role, the sequence number of the line,
//! and the line itself; its key derives from the team's key and both nonces. So peers without the key and replays are
//! rejected.

use std::io::{BufRead, BufReader, ErrorKind, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail};
use data_encoding::HEXLOWER;
use serde::Serialize;
use serde::de::DeserializeOwned;
use socket2::{SockRef, TcpKeepalive};

use super::GREETING;

/// Context string for the derivation of the session key from the team's key, unique to these connections.
const CONTEXT: &str = "murmurate, study network, coordinator and participant, 1";
/// Length of the random nonce that each side of a connection sends \[bytes\].
const DRAWN_BYTES: usize = 16;
/// Largest lengths \[bytes\] of lines before the peer is authenticated: of the line with the nonce (`NUMBER_BYTES`),
/// and of the first line with a tag (`FIRST_BYTES`).
const NUMBER_BYTES: usize = 256;
const FIRST_BYTES: usize = 4096;
/// Largest length of a line of an authenticated peer \[bytes\], enough for a station's result of a long case.
const LINE_BYTES: usize = 1 << 26;
/// Idle time of a connection before TCP keepalive probes are sent, and the interval between them.
const ALIVE: Duration = Duration::from_secs(10);

/// Role of one end of a connection in a measurement between hosts.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The process that starts each case and collects the results.
    Coordinator,
    /// A host that sends and receives the messages of a case.
    Participant,
}

impl Side {
    fn other(self) -> Side {
        match self {
            Side::Coordinator => Side::Participant,
            Side::Participant => Side::Coordinator,
        }
    }
}

/// One end of the TCP connection between the coordinator and a participant of a measurement. It sends and receives JSON
/// lines with authentication tags.
pub struct Connection {
    reader: BufReader<TcpStream>,
    writer: TcpStream,
    side: Side,
    /// Session key for the tags of lines; `None` if the team has no key.
    key: Option<[u8; 32]>,
    sent: u64,
    received: u64,
}

impl Connection {
    /// Opens one end of a connection over `stream`: exchanges random numbers (nonces) with the other end, and derives
    /// the session key from them and `team`, the team's key (`None` if it has none). Fails if nothing arrives in time.
    pub fn open(stream: TcpStream, side: Side, team: Option<&[u8; 32]>) -> Result<Connection> {
        stream.set_nodelay(true).context("cannot set up the connection")?;
        // Keepalive detects a peer whose machine has died.
        let alive = TcpKeepalive::new().with_time(ALIVE).with_interval(ALIVE);
        SockRef::from(&stream).set_tcp_keepalive(&alive).context("cannot set up the connection")?;
        let mut writer = stream.try_clone().context("cannot set up the connection")?;
        let mut reader = BufReader::new(stream);
        let mut drawn = [0; DRAWN_BYTES];
        getrandom::fill(&mut drawn).map_err(|e| anyhow!("the operating system gives no random bytes: {e}"))?;
        let own = HEXLOWER.encode(&drawn);
        writer.write_all(format!("{own}\n").as_bytes()).context("the peer has closed the connection")?;
        let theirs = read(&mut reader, NUMBER_BYTES, Some(GREETING))?;
        let both = match side {
            Side::Coordinator => [own, theirs],
            Side::Participant => [theirs, own],
        };
        let key = team
            .map(|key| *blake3::keyed_hash(&blake3::derive_key(CONTEXT, key), both.join(" ").as_bytes()).as_bytes());
        Ok(Connection { reader, writer, side, key, sent: 0, received: 0 })
    }

    /// Sends a value as a JSON line, with an authentication tag if the team has a key. Fails if the other end has
    /// closed the connection.
    pub fn send(&mut self, what: &impl Serialize) -> Result<()> {
        let text = serde_json::to_string(what).context("it is plain data")?;
        let tag = self.key.map_or("-".to_owned(), |key| tag(&key, self.side, self.sent, &text).to_hex().to_string());
        self.sent += 1;
        self.writer.write_all(format!("{tag} {text}\n").as_bytes()).context("the peer has closed the connection")
    }

    /// Receives the first value from the other end, in a line of at most 4096 bytes. Fails if it does not arrive within
    /// the time `within`, or if its authentication tag is wrong.
    pub fn receive_first<T: DeserializeOwned>(&mut self, within: Duration) -> Result<T> {
        let line = read(&mut self.reader, FIRST_BYTES, Some(within))?;
        self.understand(&line)
    }

    /// Receives the next value from the other end. Fails if it does not arrive within the time `within` (`None` for no
    /// limit), or if its authentication tag is wrong.
    pub fn receive<T: DeserializeOwned>(&mut self, within: Option<Duration>) -> Result<T> {
        let line = read(&mut self.reader, LINE_BYTES, within)?;
        self.understand(&line)
    }

    fn understand<T: DeserializeOwned>(&mut self, line: &str) -> Result<T> {
        let (shown, text) = line.split_once(' ').context(WRONG_PEER)?;
        match (self.key, shown) {
            (None, "-") => {}
            (None, _) => bail!("the peer has a key and this host has none: name one key_file in both team files"),
            (Some(_), "-") => bail!("the peer has no key and this host has one: name one key_file in both team files"),
            (Some(key), shown) => {
                let shown = blake3::Hash::from_hex(shown).map_err(|_| anyhow!(WRONG_PEER))?;
                // Hashes are compared in constant time.
                if shown != tag(&key, self.side.other(), self.received, text) {
                    bail!("the peer has another key: copy the team's key there");
                }
            }
        }
        self.received += 1;
        serde_json::from_str(text).map_err(|_| anyhow!(WRONG_PEER))
    }
}

const WRONG_PEER: &str = "the peer is not a 'study network' of this version";

fn tag(key: &[u8; 32], from: Side, number: u64, text: &str) -> blake3::Hash {
    blake3::keyed_hash(key, format!("{} {number} {text}", u8::from(from == Side::Coordinator)).as_bytes())
}

/// Reads a line of at most `most` bytes from a connection, within the time `within` (`None`: no limit). Returns it
/// without its newline.
fn read(reader: &mut BufReader<TcpStream>, most: usize, within: Option<Duration>) -> Result<String> {
    let deadline = within.map(|within| Instant::now() + within);
    let mut line = Vec::new();
    loop {
        let left = deadline.map(|deadline| deadline.saturating_duration_since(Instant::now()));
        // A timeout of zero would mean no timeout.
        let left = left.map(|left| left.max(Duration::from_micros(1)));
        reader.get_ref().set_read_timeout(left).context("cannot set up the connection")?;
        let there = match reader.fill_buf() {
            Ok([]) => bail!("the peer has closed the connection"),
            Ok(there) => there,
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            Err(error) => return Err(error).context("the peer sends nothing"),
        };
        let end = there.iter().position(|byte| *byte == b'\n');
        let taken = end.map_or(there.len(), |end| end + 1);
        line.extend_from_slice(&there[..end.unwrap_or(taken)]);
        reader.consume(taken);
        if line.len() > most {
            bail!(WRONG_PEER);
        }
        if end.is_some() {
            return String::from_utf8(line).map_err(|_| anyhow!(WRONG_PEER));
        }
        if deadline.is_some_and(|deadline| Instant::now() >= deadline) {
            bail!("the peer is too slow");
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read;
    use std::net::TcpListener;

    use super::*;

    /// Returns the results of two receptions by a coordinator from a participant, given the keys of both.
    fn received(here: Option<[u8; 32]>, there: Option<[u8; 32]>) -> Result<(String, String)> {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let participant = std::thread::spawn(move || {
            let mut connection =
                Connection::open(TcpStream::connect(address).unwrap(), Side::Participant, there.as_ref()).unwrap();
            connection.send(&"first").unwrap();
            connection.send(&"second").unwrap();
        });
        let mut connection = Connection::open(listener.accept().unwrap().0, Side::Coordinator, here.as_ref())?;
        let words =
            connection.receive(Some(GREETING)).and_then(|first| Ok((first, connection.receive(Some(GREETING))?)));
        participant.join().unwrap();
        words
    }

    #[test]
    fn messages_are_accepted_with_the_key_only() {
        let words = ("first".to_owned(), "second".to_owned());
        assert_eq!(received(Some([7; 32]), Some([7; 32])).unwrap(), words);
        assert_eq!(received(None, None).unwrap(), words);
        let refused = |here, there| received(here, there).unwrap_err().to_string();
        assert!(refused(Some([7; 32]), Some([8; 32])).contains("another key"));
        assert!(refused(Some([7; 32]), None).contains("no key"));
        assert!(refused(None, Some([7; 32])).contains("has a key"));
    }

    #[test]
    fn a_replay_from_another_connection_is_rejected() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let key = [7; 32];
        let record = std::thread::spawn(move || {
            let mut stream = TcpStream::connect(address).unwrap();
            let mut other = [0; 2 * DRAWN_BYTES + 1];
            stream.read_exact(&mut other).unwrap();
            // A message sent with the right key to another coordinator.
            let both = [std::str::from_utf8(&[b'0'; 2 * DRAWN_BYTES]).unwrap(), "11"].join(" ");
            let session = *blake3::keyed_hash(&blake3::derive_key(CONTEXT, &key), both.as_bytes()).as_bytes();
            let tag = tag(&session, Side::Participant, 0, "\"first\"").to_hex();
            stream.write_all(format!("11\n{tag} \"first\"\n").as_bytes()).unwrap();
        });
        let mut connection = Connection::open(listener.accept().unwrap().0, Side::Coordinator, Some(&key)).unwrap();
        assert!(connection.receive::<String>(Some(GREETING)).unwrap_err().to_string().contains("another key"));
        record.join().unwrap();
    }
}
