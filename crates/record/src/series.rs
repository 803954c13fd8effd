//! Files of one record: a single file, several files limited in size, or excerpts of the seconds around triggers.

use std::collections::{BTreeMap, VecDeque};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use mcap::McapError;

use super::Event;
use super::file::{Beginning, RecordError, RecordFile, broken};
use super::stage::Stage;
use super::topics::Topic;
use murmurate::config::regular;
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::{Kind, Wire};
use murmurate::net::protocol::codec::{self, Content};
use murmurate::scenario::judge::Verdict;
use murmurate::time::Span;

/// Largest size of the messages held in memory until a trigger \[bytes\].
const RING_BYTES: usize = 256 << 20;

/// Choice of what is stored of a run in its record: the whole run or only the time around triggers, and the size of
/// files.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Retention {
    /// Time before and after a trigger that is stored; a trigger is an emergency stop, an aborted episode or a request.
    /// `None` stores the whole run.
    pub last: Option<Span>,
    /// Size of a file after which another file begins \[bytes\]; `None` for a single file.
    pub most_bytes: Option<u64>,
}

/// Writer of the files of one record: one file, several of limited size, or excerpts of the time around triggers.
pub struct Series {
    path: PathBuf,
    beginning: Beginning,
    stage: Stage,
    retention: Retention,
    file: Option<RecordFile>,
    /// Messages of the last seconds with topic and time \[ns\], held in memory until a trigger.
    ring: VecDeque<(Topic, u64, Vec<u8>)>,
    ring_bytes: usize,
    /// Time at which the current excerpt ends \[ns\], on the time axis of the messages. Used only if `retention.last`
    /// is set.
    until: u64,
}

impl Series {
    /// Begins a record; `path` is the path of its first file. The file is created now, unless only excerpts around
    /// triggers are stored.
    pub fn begin(
        path: &Path,
        mut beginning: Beginning,
        stage: &Stage,
        retention: Retention,
    ) -> Result<Series, RecordError> {
        let (excerpts, mut file) = (retention.last.is_some(), None);
        beginning.identity.excerpt = excerpts;
        if !excerpts {
            file = Some(RecordFile::create(path, &beginning, stage)?);
        }
        let (path, stage, ring) = (path.to_owned(), stage.clone(), VecDeque::new());
        Ok(Series { path, beginning, stage, retention, file, ring, ring_bytes: 0, until: 0 })
    }

    /// Adds a message of the time `at` \[ns\], since 1970 or the start of a simulation, to the current file. A record
    /// of excerpts has no file between them: the message is held in memory for a coming trigger.
    pub fn write(&mut self, topic: Topic, at: u64, data: &[u8]) -> Result<(), McapError> {
        if let Some(file) = &mut self.file {
            return file.write(&self.stage, topic, at, data);
        }
        self.ring.push_back((topic, at, data.to_vec()));
        self.ring_bytes += data.len();
        let oldest = at.saturating_sub(self.retention.last.map_or(0, Span::as_nanos));
        while self.ring.front().is_some_and(|(_, at, _)| *at < oldest || self.ring_bytes > RING_BYTES) {
            self.ring_bytes -= self.ring.pop_front().map_or(0, |(.., data)| data.len());
        }
        Ok(())
    }

    /// Handles a trigger at the time `at` \[ns\] in a record of excerpts: stores the messages held in memory in a new
    /// file, and the following ones until `Retention::last` has passed without a trigger. A record of the whole run
    /// ignores it.
    pub fn keep(&mut self, at: u64) -> Result<(), McapError> {
        let Some(last) = self.retention.last else { return Ok(()) };
        self.until = at + last.as_nanos();
        if self.file.is_some() {
            return Ok(());
        }
        let mut file = self.next_file()?;
        for (topic, at, data) in self.ring.drain(..) {
            file.write(&self.stage, topic, at, &data)?;
        }
        self.ring_bytes = 0;
        file.flush()?;
        self.file = Some(file);
        Ok(())
    }

    /// Ends the turn of the event loop at the time `at` \[ns\]: closes the file if its excerpt is over, and begins
    /// another one if the file is full.
    pub fn end_instant(&mut self, at: u64) -> Result<(), McapError> {
        let Some(file) = &self.file else { return Ok(()) };
        let over = self.retention.last.is_some() && at >= self.until;
        let full = self.retention.most_bytes.is_some_and(|most| file.bytes() >= most);
        if !over && !full {
            return Ok(());
        }
        self.file.take().expect("it was there").finish()?;
        if !over {
            self.file = Some(self.next_file()?);
        }
        Ok(())
    }

    fn next_file(&mut self) -> Result<RecordFile, McapError> {
        self.beginning.identity.part += 1;
        let path = part_of(&self.path, self.beginning.identity.part);
        RecordFile::create(&path, &self.beginning, &self.stage).map_err(broken)
    }

    /// Writes everything in memory buffers of the current file to it, so that a crash of the program does not lose it.
    pub fn flush(&mut self) -> Result<(), McapError> {
        self.file.as_mut().map_or(Ok(()), RecordFile::flush)
    }

    /// Gives up the current file after a write has failed, as on a full disk: it ends with its last whole chunk. What
    /// cannot be cut off stays; readers find the end of what is intact.
    pub fn salvage(self) {
        if let Some(file) = self.file {
            file.salvage();
        }
    }

    /// Ends the record and finishes its current file.
    pub fn finish(self) -> Result<(), McapError> {
        self.file.map_or(Ok(()), RecordFile::finish)
    }
}

/// Returns the path of the file with the index `part` of a record whose first file is `path`: for 1 after `NAME.mcap`
/// it is `NAME.1.mcap`.
pub fn part_of(path: &Path, part: u32) -> PathBuf {
    match part {
        0 => path.to_owned(),
        _ => path.with_extension(format!("{part}.mcap")),
    }
}

/// Returns the indices of those files after the first one, `path`, that are in its folder, in order.
pub fn further_parts(path: &Path) -> Vec<u32> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let of_record = |name: &str| {
        let (_, part) = name.strip_suffix(".mcap")?.rsplit_once('.')?;
        let part = part.parse().ok().filter(|part| *part > 0)?;
        (part_of(path, part).file_name() == Some(OsStr::new(name))).then_some(part)
    };
    // A folder may allow its files to be opened and not its names to be listed.
    let Ok(names) = regular::names(folder) else {
        return (1..).take_while(|part| part_of(path, *part).exists()).collect();
    };
    let mut parts: Vec<u32> = names.iter().filter_map(|name| of_record(name)).collect();
    parts.sort_unstable();
    parts
}

/// Returns the path of the first file of the record to which the file `path` belongs; `None` if `path` is a first file.
pub fn first_of(path: &Path) -> Option<PathBuf> {
    let stem = path.file_stem()?.to_str()?;
    let (name, part) = stem.rsplit_once('.')?;
    part.parse::<u32>().ok().filter(|part| *part > 0).map(|_| path.with_file_name(format!("{name}.mcap")))
}

/// Detector of triggers: emergency stops, aborted episodes and requests, at which an excerpt of the run is stored.
#[derive(Default)]
pub struct Triggers {
    stops: BTreeMap<RobotId, u64>,
    engaged: bool,
}

impl Triggers {
    /// Returns whether an event is a trigger: an emergency stop, an aborted episode, or a request.
    pub fn sees(&mut self, event: &Event) -> bool {
        match event {
            Event::Keep => true,
            Event::Episode(episode) => episode.verdict == Verdict::Aborted,
            Event::Guard(robot, counts) => self.stops.insert(*robot, counts.stop).unwrap_or(0) < counts.stop,
            Event::Delivered(message) => self.engages_stop(message),
            Event::Published(_, frame) if codec::first(frame) == Ok(Content::Message(Kind::Mode)) => {
                codec::decode(frame).is_ok_and(|(_, message)| self.engages_stop(&message))
            }
            _ => false,
        }
    }

    fn engages_stop(&mut self, message: &Wire) -> bool {
        let Wire::Mode(mode) = message else { return false };
        let before = std::mem::replace(&mut self.engaged, mode.latch.is_engaged());
        self.engaged && !before
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_named_by_their_number() {
        let first = Path::new("runs/agent-0-00c0ffee.mcap");
        assert_eq!(part_of(first, 0), first);
        let third = part_of(first, 3);
        assert_eq!(third, Path::new("runs/agent-0-00c0ffee.3.mcap"));
        assert_eq!(first_of(&third).as_deref(), Some(first));
        assert_eq!(part_of(first, 12), part_of(first, 12));
        assert_eq!(first_of(first), None);
        assert_eq!(first_of(Path::new("runs/v1.0.mcap")), None);
    }
}
