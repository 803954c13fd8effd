//! The command `murmurate replay --watch`: serves a page that plays a record, with a scrubber.

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};

use super::sights::{self, Keys, Shown};
use super::{Args, Files, rerun_observed};
use crate::record::chosen::{self, first_files, tell};
use crate::record::merge::into_file;
use crate::watch::feed::Feed;
use murmurate::config::shown::counted;
use murmurate::graph::event::Event;
use murmurate::messages::wire::Wire;
use murmurate::net::protocol::key::Key;
use murmurate::registry::Registry;
use murmurate::time::{Span, Time};
use murmurate_record::reader::{self, Opened};
use murmurate_record::share::trusted;
use murmurate_robot::output::talk;
use murmurate_robot::temporary::Temporary;
use murmurate_robot::{BadInput, Ended, bad, key, signals};
use murmurate_view::command::Command;
use murmurate_view::server::Publisher;
use murmurate_view::snapshot;
use murmurate_view::status::{PageStatus, Playback, PlayedRecord, Scene};
use murmurate_view::team_view::TeamView;
use murmurate_view::timeline::{Sight, Timeline};

/// Longest time that the player waits for a command of a page before it advances, and so the longest delay of updates
/// for pages.
const TURN: Duration = Duration::from_millis(10);

/// Runs `replay --watch`: serves a page that plays the records, until the user ends it by Ctrl-C.
pub fn watch(args: &Args, registry: &Registry) -> Result<Ended> {
    let name = match &args.records[..] {
        [only] => only.display().to_string(),
        several => format!("{} records", several.len()),
    };
    let shown = read(args, registry)?;
    if !shown.note.is_empty() {
        talk(&shown.note);
    }
    if shown.sights.is_empty() {
        return bad(format!("'{name}' has nothing to show: no messages and no states of robots"));
    }
    let (stop, _) = signals::listen()?;
    let scene = scene(&shown, &name);
    let homes = shown.stage.homes.clone();
    let blank = TeamView::new(scene.clone(), homes, shown.stage.hosts.len());
    let timeline = Timeline::new(blank, shown.sights);
    let record = PlayedRecord {
        name,
        duration_s: timeline.end().as_secs(),
        marks: timeline.marks().to_vec(),
        note: shown.note.clone(),
    };
    let (server, publisher) = args.page.open(Scene { record: Some(record), ..scene })?;
    let (view, taken) = timeline.picture(Time::ZERO);
    let view = Rc::new(RefCell::new(view));
    let feed = Feed::new(Rc::clone(&view), None);
    let player = Player { timeline, view, taken, feed, publisher, now: Time::ZERO, playing: true, rate: 1.0 };
    player.run(&stop);
    server.close();
    Ok(Ended::Done)
}

/// Reads the events of the named records for the page. A simulation is run again to get the links between robots (which
/// messages arrived at which robot); several records of hosts are merged on one time axis.
fn read(args: &Args, registry: &Registry) -> Result<Shown> {
    let named = &args.records;
    let mut paths = first_files(named)?;
    let of_team = args.key_file.as_deref().map(key::read).transpose()?.map(Key::new);
    let mut keys = Keys { of_team, ..Keys::default() };
    if paths.len() > 1 {
        let records = chosen::records(named)?.records;
        talk(&format!("reads the records of {} as one", counted(records.len(), "host")));
        for (path, _) in &records {
            note_shared(&mut keys, &reader::open(path)?);
        }
        if let [(only, _)] = &records[..] {
            return sights::read(only, &keys);
        }
        let mut merged = Temporary::new_in(&std::env::temp_dir(), 0o600).context("cannot write a temporary file")?;
        into_file(records, merged.seekable())?;
        return sights::read(merged.path(), &keys);
    }
    let path = paths.remove(0);
    let (identity, attached, messages) = reader::open_any(&path).map_err(|error| BadInput(error.to_string()))?;
    let zero = identity.as_ref().map_or(0, |identity| identity.anchor_ns);
    tell(messages.health(), zero);
    let opened = identity.map(|identity| Opened { identity, attached, messages });
    opened.iter().for_each(|opened| note_shared(&mut keys, opened));
    let mut shown = sights::read(&path, &keys)?;
    let Some(opened) = opened.filter(|opened| opened.identity.is_of_simulation()) else { return Ok(shown) };
    let identity = &opened.identity;
    if identity.build != murmurate_robot::build::digest() {
        talk("links between robots are not shown: the record was made by another build of this program");
        return Ok(shown);
    }
    let (files, mut arrivals) = (Files::extract(&opened)?, Vec::new());
    let instant = Rc::new(RefCell::new(Vec::new()));
    let arrived = Rc::clone(&instant);
    let compared = rerun_observed(
        opened,
        &files,
        registry,
        move |host, event| {
            if let Event::Message(Wire::Latent(latent)) = event {
                arrived.borrow_mut().push(Sight::Arrived(host, latent.robot));
            }
        },
        |now| arrivals.extend(instant.borrow_mut().drain(..).map(|sight| (now, sight))),
    )?;
    if let Some(difference) = compared.difference {
        talk(&format!(
            "links between robots are not shown: the simulation that is run again for them differs from the record at \
             {:.3} s, as after commands of a page",
            difference.at_s
        ));
        return Ok(shown);
    }
    shown.sights.append(&mut arrivals);
    shown.hears_links = true;
    Ok(shown)
}

/// Notes the list of valid tags in a copy of a record that was shared without the key.
fn note_shared(keys: &mut Keys, opened: &Opened) {
    if let (Some(host), Some(key)) = (&opened.identity.host, trusted(&opened.attached)) {
        keys.of_records.insert(format!("{}-{:08x}", host.name, host.incarnation), key);
    }
}

fn scene(shown: &Shown, name: &str) -> Scene {
    let Shown { stage, hears_links, hears_results, .. } = shown;
    let [x, y] = stage.half_extent;
    Scene {
        scenario: stage.scenario.clone(),
        mode: stage.mode.clone(),
        policy: name.to_owned(),
        robots: stage.robots,
        half_extent: stage.half_extent,
        walls: stage.walls.clone(),
        hull_m: stage.hull_m,
        range_m: stage.range_m,
        scale_m: snapshot::scale_m(x.max(y) + 2.0),
        hears_links: *hears_links,
        hears_results: *hears_results,
        ..Scene::default()
    }
}

/// Player of a record: the current time, and the state of the team at that time.
struct Player {
    timeline: Timeline,
    view: Rc<RefCell<TeamView>>,
    /// Number of events of the record that are included in the shown state.
    taken: usize,
    feed: Feed,
    publisher: Publisher,
    now: Time,
    playing: bool,
    /// Playback speed: seconds of the record for each second of real time.
    rate: f64,
}

impl Player {
    fn run(mut self, stop: &AtomicUsize) {
        let mut before = Instant::now();
        while stop.load(Ordering::Relaxed) == 0 {
            let mut command = self.publisher.wait(TURN);
            while let Some(given) = command {
                self.obey(&given);
                command = self.publisher.command();
            }
            let present = Instant::now();
            if self.playing {
                let passed = (present - before).as_secs_f64() * self.rate;
                let to = (self.now + Span::from_secs(passed)).min(self.timeline.end());
                self.timeline.advance(&mut self.view.borrow_mut(), &mut self.taken, to);
                self.playing = to < self.timeline.end();
                self.now = to;
            }
            before = present;
            let (playing, rate) = (self.playing, self.rate);
            let fill = |status: &mut PageStatus| status.playback = Some(Playback { playing, rate });
            self.feed.publish(&self.publisher, self.now, if playing { "playing" } else { "paused" }, fill);
        }
    }

    fn obey(&mut self, command: &Command) {
        match command {
            Command::Play { on, rate } => {
                if *on && !self.playing && self.now >= self.timeline.end() {
                    self.show(Time::ZERO);
                }
                (self.playing, self.rate) = (*on, *rate);
            }
            Command::Seek { at_s } => self.show(Time::ZERO + Span::from_secs(*at_s)),
            Command::Step { back } => {
                self.playing = false;
                self.show(self.timeline.step(self.now, *back));
            }
            // Not reached: these commands are refused before, because there is no team.
            _ => {}
        }
    }

    /// Jumps to a time of the record and shows the team's state at that time.
    fn show(&mut self, at: Time) {
        self.now = at.min(self.timeline.end());
        let (view, taken) = self.timeline.picture(self.now);
        (*self.view.borrow_mut(), self.taken) = (view, taken);
        self.feed.at_once();
    }
}
