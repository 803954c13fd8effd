//! The page in a browser, with snapshots of a made-up team: what is where, pixel by pixel.

use murmurate::messages::geometry::Vec2;
use murmurate::scenario::Solid;
use murmurate::time::{Span, Time};
use murmurate_view::access::Control;
use murmurate_view::snapshot::{RobotState, Snapshot, scale_m};
use murmurate_view::status::{Goals, Scene};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Duration;

use crate::browser::Browser;
use crate::http::server;

/// Positions of the robots before and after they have moved \[m\].
const PLACES: [[Vec2; 2]; 2] =
    [[Vec2::new(-1.0, 0.5), Vec2::new(1.25, -0.75)], [Vec2::new(0.5, 1.0), Vec2::new(-1.5, -1.0)]];

/// Function of the page that returns the colour of the canvas at a point of the world \[m\]. The transform is worked
/// out from the size of the canvas: 2.25 m and 1.75 m with the margin from the middle to the edges.
const PIXEL: &str = "window.pixel = (x, y) => { const c = document.querySelector('canvas'), \
    k = Math.min(c.width / (2 * 2.35), c.height / (2 * 1.85)); \
    return [...c.getContext('2d').getImageData(c.width / 2 + k * x, c.height / 2 - k * y, 1, 1).data].join() }; \
    window.colour = name => { const s = document.createElement('canvas').getContext('2d'); \
    s.fillStyle = getComputedStyle(document.documentElement).getPropertyValue(name); s.fillRect(0, 0, 1, 1); \
    return [...s.getImageData(0, 0, 1, 1).data].join() }; true";

#[test]
fn robots_walls_and_ground_are_drawn_at_the_right_pixels() {
    let Some(mut browser) = Browser::start() else { return };
    let scene = Scene {
        robots: 3,
        half_extent: [2.0, 1.5],
        walls: [[-0.2, -0.1, 0.3, 0.1], [1.6, 1.0, 1.8, 1.5], [-2.5, -1.2, -1.9, -1.0]].map(Solid::Rect).into(),
        hull_m: 0.2,
        scale_m: scale_m(4.0),
        hears_links: true,
        control: "stop",
        ..Scene::default()
    };
    let (server, publisher) = server(Control::StopOnly, false, &scene);
    let (over, moved) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU32::new(0)));
    let (end, place) = (Arc::clone(&over), Arc::clone(&moved));
    let publisher_goals = Arc::new(AtomicBool::new(false));
    let with_goals = Arc::clone(&publisher_goals);
    let publishing = std::thread::spawn(move || {
        let robot = |at| RobotState { position: Some(at), age: Some(Span::ZERO), ..RobotState::default() };
        while !end.load(Ordering::Relaxed) {
            let mut robots: Vec<RobotState> = PLACES[place.load(Ordering::Relaxed) as usize].map(robot).to_vec();
            // Nothing was heard of the third: it is not drawn.
            robots.push(RobotState::default());
            let snapshot = Snapshot { now: Time::ZERO, robots, ..Snapshot::default() };
            publisher.snapshot(snapshot.encode(scale_m(4.0)));
            if with_goals.swap(false, Ordering::Relaxed) {
                publisher.goals(Goals { goals: vec![Some([-0.3, 0.4]), Some([0.25, -0.4]), None] }.to_json());
            }
            publisher.wait(Duration::from_millis(50));
        }
    });
    browser.open(&format!("http://{}/", server.address()));
    browser.until("murmurate.view !== null");
    browser.eval(PIXEL);
    browser.eval("document.getElementById('show-trails').click()");
    let check = |browser: &mut Browser, at: Vec2, colour: &str| {
        let holds = format!("pixel({}, {}) === colour('--{colour}')", at.x, at.y);
        browser.until(&holds);
    };
    // Beside the number, inside and outside of the hull of 0.2 m.
    let inside = [Vec2::new(0.17, 0.0), Vec2::new(0.0, -0.17), Vec2::new(-0.12, 0.12)];
    let outside = [Vec2::new(0.24, 0.0), Vec2::new(0.0, 0.24), Vec2::new(-0.17, -0.17)];
    for step in [0, 1] {
        moved.store(step, Ordering::Relaxed);
        for at in PLACES[step as usize] {
            inside.iter().for_each(|off| check(&mut browser, at + *off, "robot"));
            outside.iter().for_each(|off| check(&mut browser, at + *off, "ground"));
        }
        for gone in PLACES[1 - step as usize] {
            check(&mut browser, gone, "ground");
        }
        check(&mut browser, Vec2::new(0.25, 0.05), "wall");
        check(&mut browser, Vec2::new(0.35, 0.05), "ground");
        // A wall at the edge goes on to the edge of the drawn ground, 0.2 m beyond, and one beyond it ends there.
        check(&mut browser, Vec2::new(1.7, 1.65), "wall");
        check(&mut browser, Vec2::new(-2.15, -1.1), "wall");
        browser.until("pixel(-2.28, -1.1) !== colour('--wall')");
    }
    browser.eval(
        "window.written = []; const write = pen.fillText.bind(pen); \
         pen.fillText = (text, x, y) => { written.push([text, (x - view.x) / view.k, (view.y - y) / view.k]); \
         write(text, x, y); }; true",
    );
    publisher_goals.store(true, Ordering::Relaxed);
    let beside = "written.some(([text, x, y]) => text === '1' && Math.hypot(x - 0.3, y + 0.4) < 0.1)";
    browser.until(beside);
    let note = browser.eval("document.getElementById('note').textContent");
    assert_eq!(note, "1 of 3 robots: no position heard; no heading heard: none is drawn");
    over.store(true, Ordering::Relaxed);
    publishing.join().unwrap();
    server.close();
    browser.until("document.documentElement.classList.contains('stale')");
}
