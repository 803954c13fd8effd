//! The command `murmurate replay --watch`: serves a page that plays a record, with a scrubber.

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};

use super::{Args, rerun};
use crate::record::chosen::{self, first_files, print_damage, wrong};
use crate::record::merge::into_file;
use crate::watch::feed::Feed;
use murmurate::config::shown::counted;
use murmurate::graph::event::Event;
use murmurate::messages::wire::Wire;
use murmurate::registry::Registry;
use murmurate_record::reader::{self, Opened};
use murmurate_record::share::trusted;
use murmurate_record::stage::StageSense;
use murmurate_replay::files::Files;
use murmurate_replay::sights::{self, Keys, Shown};
use murmurate_robot::output::talk;
use murmurate_robot::temporary;
use murmurate_robot::{BadInput, Ended, bad, key, signals};
use murmurate_view::player::Player;
use murmurate_view::scans::ScanForm;
use murmurate_view::server::Publisher;
use murmurate_view::snapshot;
use murmurate_view::status::{PageStatus, PlayedRecord, Scene};
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
    let player = Player::new(timeline);
    let mut feed = Feed::new(player.view(), None);
    play(player, &mut feed, &publisher, &stop);
    server.close();
    Ok(Ended::Done)
}

/// Reads the events of the named records for the page. A simulation is run again to get the links between robots (which
/// messages arrived at which robot); several records of hosts are merged on one time axis.
fn read(args: &Args, registry: &Registry) -> Result<Shown> {
    let named = &args.records;
    let mut paths = first_files(named)?;
    let of_team = args.key_file.as_deref().map(key::read).transpose()?.map(|file| file.key_of_records());
    let mut keys = Keys { of_team, ..Keys::default() };
    if paths.len() > 1 {
        let records = chosen::records(named)?.records;
        talk(&format!("reads the records of {} as one", counted(records.len(), "host")));
        for (path, _) in &records {
            add_shared(&mut keys, &reader::open(path)?);
        }
        if let [(only, _)] = &records[..] {
            return Ok(sights::read(only, &keys).map_err(wrong)?);
        }
        let mut merged = temporary::file_in(&std::env::temp_dir(), 0o600).context("cannot write a temporary file")?;
        into_file(records, keys.of_team.as_ref(), merged.as_file_mut())?;
        return Ok(sights::read(merged.path(), &keys).map_err(wrong)?);
    }
    let path = paths.remove(0);
    let (identity, attached, messages) = reader::open_any(&path).map_err(|error| BadInput(error.to_string()))?;
    let zero = identity.as_ref().map_or(0, |identity| identity.anchor_ns);
    print_damage(messages.health(), zero);
    let opened = identity.map(|identity| Opened { identity, attached, messages });
    opened.iter().for_each(|opened| add_shared(&mut keys, opened));
    let mut shown = sights::read(&path, &keys).map_err(wrong)?;
    let Some(opened) = opened.filter(|opened| opened.identity.is_of_simulation()) else { return Ok(shown) };
    let identity = &opened.identity;
    if identity.build != murmurate_robot::build::digest() {
        talk("links between robots are not shown: the record was made by another build of this program");
        return Ok(shown);
    }
    let (files, mut arrivals) = (Files::extract(&opened)?, Vec::new());
    let instant = Rc::new(RefCell::new(Vec::new()));
    let arrived = Rc::clone(&instant);
    let compared = rerun(
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

/// Adds the list of valid tags in a copy of a record that was shared without the key.
fn add_shared(keys: &mut Keys, opened: &Opened) {
    if let (Some(host), Some(key)) = (&opened.identity.host, trusted(&opened.attached)) {
        keys.of_records.insert(host.process_name(), key);
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
        drawn: stage.drawn.clone(),
        movers: stage.movers.clone(),
        waypoints: stage.waypoints.clone(),
        unlabelled: stage.unlabelled,
        hull_m: stage.hull_m,
        range_m: stage.range_m,
        scale_m: snapshot::scale_m(x.max(y) + 2.0),
        scans: {
            let form = |(sense, of): (u8, &StageSense)| {
                of.rays_rad.map(|rays_rad| ScanForm { sense, rays_rad, mount_m: of.mount_m })
            };
            (0..).zip(&stage.senses).filter_map(form).collect()
        },
        hears_links: *hears_links,
        hears_results: *hears_results,
        ..Scene::default()
    }
}

/// Plays the record for the pages until the user ends the command.
fn play(mut player: Player, feed: &mut Feed, publisher: &Publisher, stop: &AtomicUsize) {
    let mut before = Instant::now();
    while stop.load(Ordering::Relaxed) == 0 {
        let mut command = publisher.wait(TURN);
        while let Some(given) = command {
            if player.take(&given) {
                feed.at_once();
            }
            command = publisher.command();
        }
        let present = Instant::now();
        player.pass((present - before).as_secs_f64());
        before = present;
        let playback = player.playback();
        let fill = |status: &mut PageStatus| status.playback = Some(playback);
        feed.publish(publisher, player.now(), if playback.playing { "playing" } else { "paused" }, fill);
    }
}
