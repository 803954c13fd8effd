//! One end of the connection between a coordinator and a participant: one JSON object a line, each with a tag where the
//! team has a key. What is said is known in `mod.rs`.
//!
//! Each end first says a number that it has drawn. Tags are of both, of who speaks, of how many lines there were
//! before, and of the line itself: nobody without the key is believed, and nothing that was recorded.

use std::io::{BufRead, BufReader, ErrorKind, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail};
use serde::Serialize;
use serde::de::DeserializeOwned;
use socket2::{SockRef, TcpKeepalive};

use super::GREETING;

/// What the key is used for here, and nowhere else.
const CONTEXT: &str = "murmurate, study network, coordinator and participant, 1";
/// Bytes of the number that each end draws.
const DRAWN_BYTES: usize = 16;
/// How long the line with the other end's number may be, and the first with a tag: a name, before anything is known of
/// the other end \[bytes\].
const NUMBER_BYTES: usize = 256;
const FIRST_BYTES: usize = 4096;
/// How long a line may be once the other end has shown the key: what a station has found in a long case \[bytes\].
const LINE_BYTES: usize = 1 << 26;
/// How long an idle end is believed to be alive, and how often it is asked from then on.
const ALIVE: Duration = Duration::from_secs(10);

/// Whose end it is.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum End {
    Coordinator,
    Participant,
}

impl End {
    fn other(self) -> End {
        match self {
            End::Coordinator => End::Participant,
            End::Participant => End::Coordinator,
        }
    }
}

/// One end of a connection.
pub struct Line {
    reader: BufReader<TcpStream>,
    writer: TcpStream,
    end: End,
    /// The key of this connection; none where the team has none.
    key: Option<[u8; 32]>,
    said: u64,
    heard: u64,
}

impl Line {
    /// Opens this end of a connection of a team with this key.
    pub fn open(stream: TcpStream, end: End, team: Option<&[u8; 32]>) -> Result<Line> {
        stream.set_nodelay(true).context("cannot set up the connection")?;
        // An end whose machine has died says no more, and nobody is to wait for it for ever.
        let alive = TcpKeepalive::new().with_time(ALIVE).with_interval(ALIVE);
        SockRef::from(&stream).set_tcp_keepalive(&alive).context("cannot set up the connection")?;
        let mut writer = stream.try_clone().context("cannot set up the connection")?;
        let mut reader = BufReader::new(stream);
        let mut drawn = [0; DRAWN_BYTES];
        getrandom::fill(&mut drawn).map_err(|e| anyhow!("the operating system gives no random bytes: {e}"))?;
        let own = drawn.map(|byte| format!("{byte:02x}")).concat();
        writer.write_all(format!("{own}\n").as_bytes()).context("the other end has closed the connection")?;
        let theirs = read(&mut reader, NUMBER_BYTES, Some(GREETING))?;
        let both = match end {
            End::Coordinator => [own, theirs],
            End::Participant => [theirs, own],
        };
        let key = team
            .map(|key| *blake3::keyed_hash(&blake3::derive_key(CONTEXT, key), both.join(" ").as_bytes()).as_bytes());
        Ok(Line { reader, writer, end, key, said: 0, heard: 0 })
    }

    /// Says something.
    pub fn say(&mut self, what: &impl Serialize) -> Result<()> {
        let text = serde_json::to_string(what).context("it is plain data")?;
        let tag = self.key.map_or("-".to_owned(), |key| tag(&key, self.end, self.said, &text).to_hex().to_string());
        self.said += 1;
        self.writer.write_all(format!("{tag} {text}\n").as_bytes()).context("the other end has closed the connection")
    }

    /// The first thing that the other end says, which is short.
    pub fn hear_first<T: DeserializeOwned>(&mut self, within: Duration) -> Result<T> {
        let line = read(&mut self.reader, FIRST_BYTES, Some(within))?;
        self.understand(&line)
    }

    /// The next thing that the other end says, if it has said it within this time.
    pub fn hear<T: DeserializeOwned>(&mut self, within: Option<Duration>) -> Result<T> {
        let line = read(&mut self.reader, LINE_BYTES, within)?;
        self.understand(&line)
    }

    fn understand<T: DeserializeOwned>(&mut self, line: &str) -> Result<T> {
        let (shown, text) = line.split_once(' ').context(STRANGER)?;
        match (self.key, shown) {
            (None, "-") => {}
            (None, _) => bail!("the other end has a key and this one has none: name one key_file in both team files"),
            (Some(_), "-") => bail!("the other end has no key and this one has: name one key_file in both team files"),
            (Some(key), shown) => {
                let shown = blake3::Hash::from_hex(shown).map_err(|_| anyhow!(STRANGER))?;
                // Hashes compare in constant time.
                if shown != tag(&key, self.end.other(), self.heard, text) {
                    bail!("the other end has another key: copy the team's key there");
                }
            }
        }
        self.heard += 1;
        serde_json::from_str(text).map_err(|_| anyhow!(STRANGER))
    }
}

const STRANGER: &str = "the other end is no 'murmurate study network' of this version";

fn tag(key: &[u8; 32], from: End, number: u64, text: &str) -> blake3::Hash {
    blake3::keyed_hash(key, format!("{} {number} {text}", u8::from(from == End::Coordinator)).as_bytes())
}

/// A line without its end, of so many bytes at the most, if all of it has come within this time.
fn read(reader: &mut BufReader<TcpStream>, most: usize, within: Option<Duration>) -> Result<String> {
    let deadline = within.map(|within| Instant::now() + within);
    let mut line = Vec::new();
    loop {
        let left = deadline.map(|deadline| deadline.saturating_duration_since(Instant::now()));
        // No time left would be taken for no limit.
        let left = left.map(|left| left.max(Duration::from_micros(1)));
        reader.get_ref().set_read_timeout(left).context("cannot set up the connection")?;
        let there = match reader.fill_buf() {
            Ok([]) => bail!("the other end has closed the connection"),
            Ok(there) => there,
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            Err(error) => return Err(error).context("the other end says nothing"),
        };
        let end = there.iter().position(|byte| *byte == b'\n');
        let taken = end.map_or(there.len(), |end| end + 1);
        line.extend_from_slice(&there[..end.unwrap_or(taken)]);
        reader.consume(taken);
        if line.len() > most {
            bail!(STRANGER);
        }
        if end.is_some() {
            return String::from_utf8(line).map_err(|_| anyhow!(STRANGER));
        }
        if deadline.is_some_and(|deadline| Instant::now() >= deadline) {
            bail!("the other end is too slow");
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read;
    use std::net::TcpListener;

    use super::*;

    /// What the coordinator makes of a word of a participant, each with its key.
    fn heard(here: Option<[u8; 32]>, there: Option<[u8; 32]>) -> Result<(String, String)> {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let participant = std::thread::spawn(move || {
            let mut line = Line::open(TcpStream::connect(address).unwrap(), End::Participant, there.as_ref()).unwrap();
            line.say(&"first").unwrap();
            line.say(&"second").unwrap();
        });
        let mut line = Line::open(listener.accept().unwrap().0, End::Coordinator, here.as_ref())?;
        let words = line.hear(Some(GREETING)).and_then(|first| Ok((first, line.hear(Some(GREETING))?)));
        participant.join().unwrap();
        words
    }

    #[test]
    fn whoever_has_the_key_is_heard_and_nobody_else() {
        let words = ("first".to_owned(), "second".to_owned());
        assert_eq!(heard(Some([7; 32]), Some([7; 32])).unwrap(), words);
        assert_eq!(heard(None, None).unwrap(), words);
        let refused = |here, there| heard(here, there).unwrap_err().to_string();
        assert!(refused(Some([7; 32]), Some([8; 32])).contains("another key"));
        assert!(refused(Some([7; 32]), None).contains("no key"));
        assert!(refused(None, Some([7; 32])).contains("has a key"));
    }

    #[test]
    fn what_was_recorded_of_another_connection_is_nothing() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let key = [7; 32];
        let record = std::thread::spawn(move || {
            let mut stream = TcpStream::connect(address).unwrap();
            let mut other = [0; 2 * DRAWN_BYTES + 1];
            stream.read_exact(&mut other).unwrap();
            // As one with the key would have said it to another coordinator.
            let both = [std::str::from_utf8(&[b'0'; 2 * DRAWN_BYTES]).unwrap(), "11"].join(" ");
            let session = *blake3::keyed_hash(&blake3::derive_key(CONTEXT, &key), both.as_bytes()).as_bytes();
            let tag = tag(&session, End::Participant, 0, "\"first\"").to_hex();
            stream.write_all(format!("11\n{tag} \"first\"\n").as_bytes()).unwrap();
        });
        let mut line = Line::open(listener.accept().unwrap().0, End::Coordinator, Some(&key)).unwrap();
        assert!(line.hear::<String>(Some(GREETING)).unwrap_err().to_string().contains("another key"));
        record.join().unwrap();
    }
}
