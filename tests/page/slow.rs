//! Pages that never read: the publisher does not wait, memory stays flat, and other pages get their pictures.

use std::time::{Duration, Instant};

use murmurate_view::access::Control;
use murmurate_view::status::Scene;
use tungstenite::Message;

use crate::http::{server, shown, socket, token};

/// Bytes of a snapshot of 1000 robots with 6000 links.
const SNAPSHOT: usize = 16 + 9 * 1000 + 6 * 6000;

fn resident_kb() -> usize {
    let text = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = text.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

#[test]
fn ten_pages_that_never_read_hold_up_nobody() {
    let (server, publisher) = server(Control::StopOnly, false, &Scene::default());
    let deaf: Vec<_> = (0..10).map(|_| socket(server.address(), "/view", &[])).collect();
    let mut deaf_control = socket(server.address(), "/control", &[shown(&token())]);
    let mut reader = socket(server.address(), "/view", &[]);
    let reading = std::thread::spawn(move || {
        let (mut frames, mut gap, mut last) = (0, Duration::ZERO, Instant::now());
        while let Ok(message) = reader.read() {
            if let Message::Binary(_) = message {
                (gap, last) = (gap.max(last.elapsed()), Instant::now());
                frames += 1;
            }
        }
        (frames, gap)
    });
    let (mut took, before) = (Vec::new(), resident_kb());
    let (began, mut refused) = (Instant::now(), 0);
    while began.elapsed() < Duration::from_secs(4) {
        let bytes = vec![0; SNAPSHOT];
        let at = Instant::now();
        refused += u32::from(!publisher.snapshot(bytes));
        publisher.status(format!(r#"{{"kind":"status","body":{{"x":"{}"}}}}"#, "a".repeat(20_000)));
        took.push(at.elapsed());
        // Forty times a second, and awake for commands.
        publisher.wait(Duration::from_millis(25));
    }
    let grown = resident_kb().saturating_sub(before);
    // The page that never reads can still stop the team.
    deaf_control.send(Message::text(r#"{"do":"stop"}"#)).unwrap();
    took.sort();
    let (count, worst) = (took.len(), took[took.len() - 1]);
    eprintln!(
        "{count} publications, {refused} put off, median {:?}, longest {worst:?}, {grown} kB more",
        took[count / 2]
    );
    assert!(took[count / 2] < Duration::from_micros(500) && worst < Duration::from_millis(100), "{worst:?}");
    assert!(grown < 8_000, "{grown} kB more");
    drop(deaf);
    server.close();
    let (frames, gap) = reading.join().unwrap();
    assert!(frames > 50 && gap < Duration::from_secs(1), "{frames} frames, longest gap {gap:?}");
}
