//! Pages that never read: the publisher does not wait, memory stays flat, and other pages get their pictures.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use murmurate_view::access::Control;
use murmurate_view::status::Scene;
use tungstenite::Message;

use crate::http::{server, shown, socket, token};

/// Bytes of a snapshot of 1000 robots with 6000 links.
const SNAPSHOT: usize = 16 + 9 * 1000 + 6 * 6000;
/// Longest time for what takes seconds.
const HANGS: Duration = Duration::from_secs(120);

fn resident_kb() -> usize {
    let text = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = text.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

/// How often this thread has waited for something, such as a lock or a socket.
fn waits() -> u64 {
    let text = std::fs::read_to_string("/proc/thread-self/status").unwrap();
    let line = text.lines().find_map(|line| line.strip_prefix("voluntary_ctxt_switches:")).unwrap();
    line.trim().parse().unwrap()
}

#[test]
fn ten_pages_that_never_read_hold_up_nobody() {
    // In a process of its own, since the memory that it measures is that of a process.
    if std::env::var_os("MURMURATE_TEST_ALONE").is_none() {
        let this = std::env::current_exe().expect("a test knows where it is");
        let arguments = ["--exact", "slow::ten_pages_that_never_read_hold_up_nobody", "--nocapture"];
        let output = std::process::Command::new(this).args(arguments).env("MURMURATE_TEST_ALONE", "1").output();
        let output = output.expect("the test starts itself");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && said.contains("publications"), "{said}");
        return;
    }
    let (server, publisher) = server(Control::StopOnly, false, &Scene::default());
    let deaf: Vec<_> = (0..10).map(|_| socket(server.address(), "/view", &[])).collect();
    let mut deaf_control = socket(server.address(), "/control", &[shown(&token())]);
    let mut reader = socket(server.address(), "/view", &[]);
    let frames = Arc::new(AtomicU64::new(0));
    let shown = Arc::clone(&frames);
    let reading = std::thread::spawn(move || {
        while let Ok(message) = reader.read() {
            shown.fetch_add(u64::from(matches!(message, Message::Binary(_))), Ordering::Relaxed);
        }
    });
    let (mut count, mut refused, mut waited, before) = (0, 0, 0, resident_kb());
    let began = Instant::now();
    // By then the sockets of the pages that never read are full.
    while frames.load(Ordering::Relaxed) < 100 {
        let (bytes, status) = (vec![0; SNAPSHOT], "a".repeat(20_000));
        let at = waits();
        refused += u32::from(!publisher.snapshot(bytes));
        publisher.status(format!(r#"{{"kind":"status","body":{{"x":"{status}"}}}}"#));
        (count, waited) = (count + 1, waited + (waits() - at));
        assert!(began.elapsed() < HANGS, "the page that reads gets {frames:?} of {count} pictures");
        // Forty times a second, and awake for commands.
        publisher.wait(Duration::from_millis(25));
    }
    let grown = resident_kb().saturating_sub(before);
    // The page that never reads can still stop the team.
    deaf_control.send(Message::text(r#"{"do":"stop"}"#)).unwrap();
    eprintln!("{count} publications, {refused} put off, {waited} waits in them, {grown} kB more");
    // A lock of the allocator may be held now and then.
    assert!(10 * waited <= count, "{waited} waits in {count} publications");
    assert!(grown < 8_000, "{grown} kB more");
    drop(deaf);
    server.close();
    reading.join().unwrap();
}
