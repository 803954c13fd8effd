//! The network study measured between hosts: a coordinator says what is measured when, each participant measures.
//!
//! They talk over TCP, one JSON object a line, while the network is otherwise idle: it carries no measured message, and
//! nothing on it is timed but the clocks. The clock of each participant is compared before each case: of several
//! questions and answers that with the shortest way there and back counts (RFC 5905, section 8), and half of that way
//! is how far off it may be. One-way delays are then differences of two such clocks.

mod coordinator;
mod participant;

pub use coordinator::measure;
pub use participant::{Part, participate};

use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use murmurate::study::network::peer::{Notes, Task};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// What the coordinator says.
#[derive(Debug, Serialize, Deserialize)]
enum Instruction {
    /// Say what your clock shows.
    Clock,
    /// Measure this; it begins then on your clock \[ns\].
    Measure(Task, u64),
    /// That was all.
    Done,
}

/// What a participant says.
#[derive(Debug, Serialize, Deserialize)]
enum Answer {
    /// Which host it is.
    Host(String),
    /// What its clock shows \[ns\].
    Clock(u64),
    /// What it has found.
    Found(Notes),
}

/// One end of a connection.
struct Line {
    reader: BufReader<TcpStream>,
    writer: TcpStream,
}

impl Line {
    fn new(stream: TcpStream) -> Result<Line> {
        stream.set_nodelay(true).context("cannot set up the connection")?;
        let writer = stream.try_clone().context("cannot set up the connection")?;
        Ok(Line { reader: BufReader::new(stream), writer })
    }

    fn say(&mut self, what: &impl Serialize) -> Result<()> {
        let text = serde_json::to_string(what).context("it is plain data")? + "\n";
        self.writer.write_all(text.as_bytes()).context("the other end has closed the connection")
    }

    /// The next thing that the other end says, if it says it within this time.
    fn hear<T: DeserializeOwned>(&mut self, within: Option<Duration>) -> Result<T> {
        self.writer.set_read_timeout(within).context("cannot set up the connection")?;
        let mut text = String::new();
        match self.reader.read_line(&mut text) {
            Ok(0) => Err(anyhow!("the other end has closed the connection")),
            Ok(_) => {
                serde_json::from_str(&text).context("the other end is no 'murmurate study network' of this version")
            }
            Err(error) => Err(error).context("the other end says nothing"),
        }
    }
}
