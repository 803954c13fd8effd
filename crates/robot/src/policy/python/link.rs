//! Connection to the process of a policy in Python: frames to it, and its answers within their time.

use std::collections::BTreeMap;
use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use murmurate::messages::ids::RobotId;
use murmurate_onnx::frames::{self, Kind};

use super::child::{Child, shortened};

/// Longest time for one call. A robot does not wait for it: its Agent gives a step up after half a period.
pub const CALL: Duration = Duration::from_secs(10);

/// Connection to the process.
#[derive(Default)]
pub struct Link {
    /// Its socket; `None` before the first call, and after it has ended.
    pub stream: Option<UnixStream>,
    /// The process, if this program has started it.
    pub child: Option<Child>,
    /// Whether there was a connection before.
    pub opened: bool,
    number: u32,
    /// Number of times that it has ended, without a minute between two of them.
    pub failures: usize,
    /// Time at which it was last started because it had ended.
    pub failed: Option<Instant>,
    /// Seed with which each robot has begun anew last.
    pub seeds: BTreeMap<RobotId, u64>,
}

impl Link {
    /// Sends a frame, which is not answered.
    pub fn send(&mut self, kind: Kind, body: &[u8]) -> Result<(), String> {
        let frame = frames::frame(kind, self.number, body)?;
        let stream = self.stream.as_mut().ok_or("there is no process")?;
        stream.set_write_timeout(Some(CALL)).and_then(|()| stream.write_all(&frame)).map_err(|error| error.to_string())
    }

    /// Sends a frame and returns the body of its answer. Ends the connection if there is none in time.
    pub fn exchange(&mut self, kind: Kind, body: &[u8], longest: Duration) -> Result<Vec<u8>, String> {
        self.number = self.number.wrapping_add(1);
        let answer = self.send(kind, body).and_then(|()| self.receive(Instant::now() + longest));
        match answer {
            Ok((kind, text)) if kind == Kind::Error as u8 => Err(shortened(&String::from_utf8_lossy(&text))),
            Ok((kind, body)) if kind == Kind::Answer as u8 => Ok(body),
            Ok((other, _)) => Err(format!("it has answered by a frame of kind {other}")),
            Err(why) => {
                let status = self.end();
                Err(status.map_or(why.clone(), |status| format!("{why} ({status})")))
            }
        }
    }

    /// Receives the answer to the present call; late ones to calls before it are dropped.
    fn receive(&mut self, until: Instant) -> Result<(u8, Vec<u8>), String> {
        let stream = self.stream.as_mut().ok_or("there is no process")?;
        let mut read = |bytes: &mut [u8]| -> Result<(), String> {
            let mut at = 0;
            while at < bytes.len() {
                let left = until.saturating_duration_since(Instant::now());
                if left.is_zero() {
                    return Err("it does not answer".to_owned());
                }
                stream.set_read_timeout(Some(left)).map_err(|error| error.to_string())?;
                match stream.read(&mut bytes[at..]) {
                    Ok(0) => return Err("it has ended".to_owned()),
                    Ok(count) => at += count,
                    Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                    Err(error) if error.kind() == ErrorKind::Interrupted => {}
                    Err(error) => return Err(error.to_string()),
                }
            }
            Ok(())
        };
        loop {
            let mut head = [0; frames::HEAD];
            read(&mut head)?;
            let head = frames::head(head)?;
            let mut body = vec![0; head.body];
            read(&mut body)?;
            if head.number == self.number {
                return Ok((head.kind, body));
            }
        }
    }

    /// Ends the connection and the process. Returns how it has ended, if it had before.
    pub fn end(&mut self) -> Option<String> {
        self.stream = None;
        let child = self.child.take()?;
        let ended = child.group.has_ended();
        child.group.finish().filter(|_| ended).map(|status| status.to_string())
    }
}
