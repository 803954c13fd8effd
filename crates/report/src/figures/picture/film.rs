//! Animation of an episode as an HTML page: `player.html` with the episode's data.

use std::collections::BTreeSet;

use serde_json::{Value, json};

use super::scene::{Backdrop, Scan, Scene, SceneFrame};
use super::sheet::{LOOK, escaped, walls};
use super::{movers, space};
use murmurate::messages::geometry::Vec2;
use murmurate::scenario::course::Course;
use murmurate::scenario::{Mover, Solid};
use murmurate::time::Span;

/// HTML of the page, with `{title}`, `{look}` and `{data}` to be filled in.
const PLAYER: &str = include_str!("player.html");
/// Number of steps of a link's age up to the window. Each is encoded as a letter.
const LETTERS: u64 = 24;
/// Size of the data \[bytes\] above which frames are left out.
const ROOM: usize = 260_000;
/// Strides of the frames that are kept, tried in turn until the data fits. The last keeps one frame per second.
const STRIDES: [usize; 4] = [2, 4, 10, 20];

/// Returns an HTML page that plays the episode, with a slider, a choice of speed and keys. The page loads no other
/// file.
pub fn film(scene: &Scene) -> String {
    let mut data = json(scene, 1);
    for stride in STRIDES {
        if data.len() > ROOM {
            data = json(scene, stride);
        }
    }
    PLAYER.replacen("{title}", &escaped(&scene.stage.title), 1).replacen("{look}", LOOK, 1).replacen("{data}", &data, 1)
}

/// Converts metres to millimetres.
fn mm(metres: f32) -> i64 {
    (f64::from(metres) * 1000.0).round() as i64
}

fn point(at: Vec2) -> [i64; 2] {
    [mm(at.x), mm(at.y)]
}

fn ms(span: Span) -> u64 {
    (span.as_secs() * 1000.0).round() as u64
}

/// Returns a wall in integer millimetres: a list of coordinates for a rectangle, an object for other shapes.
fn wall(wall: &Solid) -> Value {
    match wall {
        Solid::Rect(corners) => json!(corners.map(mm)),
        Solid::Disc { disc } => json!({ "disc": disc.map(mm) }),
        Solid::Polygon { polygon } => json!({ "polygon": polygon.iter().map(|at| at.map(mm)).collect::<Vec<_>>() }),
    }
}

/// Returns the data of every `stride`th frame and of the last one, in integer millimetres and milliseconds.
fn json(scene: &Scene, stride: usize) -> String {
    let stage = &scene.stage;
    let last = scene.frames.len() - 1;
    let shown = |(at, _): &(usize, &SceneFrame)| at.is_multiple_of(stride) || *at == last;
    let frames: Vec<&SceneFrame> = scene.frames.iter().enumerate().filter(shown).map(|(_, frame)| frame).collect();
    let walls: Vec<Value> = walls(stage).iter().map(wall).collect();
    let rings: Vec<Value> = scene
        .ending
        .rings
        .iter()
        .map(|ring| json!([ms(ring.from), mm(ring.at.x), mm(ring.at.y), mm(ring.radius_m)]))
        .collect();
    let data = json!({
        "title": stage.title,
        "caption": stage.caption,
        "half": point(stage.arena.half_extent),
        "radius": mm(stage.radius_m),
        "arrival": mm(stage.rules.arrival_m),
        "walls": walls,
        "movers": moving(stage, &frames),
        "goals": stage.tasks.iter().map(|task| point(task.goal)).collect::<Vec<_>>(),
        "waypoints": stage.courses.iter().map(waypoints).collect::<Vec<_>>(),
        "unlabelled": stage.goals.are_unlabelled(),
        "arrivals": scene.arrivals().into_iter().map(|at| at.map(ms)).collect::<Vec<_>>(),
        "window": ms(stage.window),
        "letters": LETTERS,
        "times": differences(frames.iter().map(|frame| ms(frame.time) as i64)),
        "paths": (0..scene.robots()).map(|robot| path(&frames, robot)).collect::<Vec<_>>(),
        "links": scene.pairs().into_iter().map(|pair| link(&frames, pair, stage.window)).collect::<Vec<_>>(),
        "sensed": sensed(scene, shown),
        "scans": scans(&frames),
        "success": scene.ending.success,
        "verdict": scene.ending.text,
        "rings": rings,
    });
    // A closing script tag would end the script, even within a string.
    data.to_string().replace('<', "\\u003c")
}

/// Returns for each moving obstacle its shape at the start of the episode, the points of its path, and its offsets from
/// there in each frame, in integer millimetres.
fn moving(stage: &Backdrop, frames: &[&SceneFrame]) -> Vec<Value> {
    let offsets: Vec<Vec<Vec2>> = frames.iter().map(|frame| movers::offsets(stage, frame.time)).collect();
    let offsets = |at: usize, axis: usize| differences(offsets.iter().map(|all| point(all[at])[axis]));
    let mover = |(at, mover): (usize, &Mover)| {
        let round: Vec<[i64; 2]> = mover.round().iter().map(|at| point(*at)).collect();
        let body = wall(&mover.block(Span::ZERO).solid());
        json!({ "body": body, "round": round, "offsets": [offsets(at, 0), offsets(at, 1)] })
    };
    stage.arena.movers.iter().enumerate().map(mover).collect()
}

/// Returns the waypoints of a robot in integer millimetres.
fn waypoints(course: &Course) -> Vec<[i64; 2]> {
    course.waypoints().iter().map(|at| point(*at)).collect()
}

/// Returns the scans of each frame: for each, the number of the robot, the place of the sense \[mm\], and the place of
/// each echo from there \[cm\]. Empty if there are none.
fn scans(frames: &[&SceneFrame]) -> Vec<Vec<Vec<i64>>> {
    if frames.iter().all(|frame| frame.scans.is_empty()) {
        return Vec::new();
    }
    let cm = |metres: f32| (f64::from(metres) * 100.0).round() as i64;
    let scan = |scan: &Scan| {
        let [x, y] = point(scan.from);
        let head = [scan.robot as i64, x, y];
        head.into_iter()
            .chain(scan.echoes.iter().map(|at| at - scan.from).flat_map(|to| [cm(to.x), cm(to.y)]))
            .collect()
    };
    frames.iter().map(|frame| frame.scans.iter().map(scan).collect()).collect()
}

/// Returns the first number and then the differences between successive numbers.
fn differences(numbers: impl Iterator<Item = i64>) -> Vec<i64> {
    let mut before = 0;
    numbers.map(|number| number - std::mem::replace(&mut before, number)).collect()
}

fn path(frames: &[&SceneFrame], robot: usize) -> [Vec<i64>; 2] {
    [
        differences(frames.iter().map(|frame| mm(frame.at[robot].x))),
        differences(frames.iter().map(|frame| mm(frame.at[robot].y))),
    ]
}

/// Returns the pairs of robots that only sense each other: for each, the first frame in which they do, and from there
/// an `s` or a dot for each frame that is shown.
fn sensed(scene: &Scene, shown: impl Fn(&(usize, &SceneFrame)) -> bool) -> Vec<Value> {
    let frames = space::sensed(scene).into_iter().zip(&scene.frames).enumerate();
    let frames: Vec<_> = frames.filter(|(at, (_, frame))| shown(&(*at, *frame))).map(|(_, (pairs, _))| pairs).collect();
    let all: BTreeSet<(usize, usize)> = frames.iter().flatten().copied().collect();
    let letter = |pair: &(usize, usize), frame: &Vec<_>| if frame.binary_search(pair).is_ok() { 's' } else { '.' };
    let of_pair = |pair: (usize, usize)| {
        let letters: String = frames.iter().map(|frame| letter(&pair, frame)).collect();
        let begin = letters.find('s').unwrap_or(0);
        json!([pair.0, pair.1, begin, letters[begin..].trim_end_matches('.')])
    };
    all.into_iter().map(of_pair).collect()
}

/// Returns a pair of robots, the first frame in which one uses a message of the other, and from there one letter per
/// frame. The letter is the age step of the message; it is a capital if only one of them uses a message, and a dot if
/// none does.
fn link(frames: &[&SceneFrame], (one, other): (usize, usize), window: Span) -> Value {
    let letter = |frame: &&SceneFrame| match frame.links.iter().find(|link| (link.one, link.other) == (one, other)) {
        None => '.',
        Some(link) => {
            let step = (link.age.as_nanos() * LETTERS / window.as_nanos().max(1)).min(LETTERS);
            let first = if link.mutual { b'a' } else { b'A' };
            char::from(first + u8::try_from(step).expect("there are fewer letters than in the alphabet"))
        }
    };
    let ages: String = frames.iter().map(letter).collect();
    let begin = ages.find(|letter| letter != '.').unwrap_or(ages.len());
    json!([one, other, begin, ages[begin..].trim_end_matches('.')])
}
