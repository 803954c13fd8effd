//! Requests to the page's server, answered as a well-known server answers them.
//!
//! The lists were put to nginx 1.22 once, with the same files. It answers alike, but: it answers 400 to a path out of
//! its folder, `Range` with 206, `If-None-Match: *` to what has no version here with 304, HTTP/2.0 with 505, a long
//! path with 414, long headers and a second `Host` with 400; it takes 100 header lines, and any host; and its 405 has
//! no `Allow`.

use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::time::Duration;

use murmurate_view::access::Control;
use murmurate_view::command::Command;
use murmurate_view::server::{Publisher, Server};
use murmurate_view::status::Scene;
use tungstenite::Message;

use crate::http::{connect, own, read_kind, server, shown, socket, token, upgrade};

/// An answer: its status, its headers with names in small letters, and its body.
struct Answer {
    status: u16,
    head: String,
    body: Vec<u8>,
}

impl Answer {
    fn header(&self, name: &str) -> Option<&str> {
        let is = |line: &&str| line.split_once(": ").is_some_and(|(other, _)| other.eq_ignore_ascii_case(name));
        self.head.lines().find(is).and_then(|line| line.split_once(": ")).map(|(_, value)| value)
    }
}

/// A connection on which requests follow each other.
struct Kept(BufReader<TcpStream>);

impl Kept {
    fn open(at: SocketAddr) -> Kept {
        Kept(BufReader::new(connect(at)))
    }

    fn send(&mut self, text: &str) {
        self.0.get_mut().write_all(text.as_bytes()).unwrap();
    }

    /// Reads an answer, of which the body is as long as its header says; `None` at the end of the connection.
    fn read(&mut self, has_body: bool) -> Option<Answer> {
        let mut head = String::new();
        while !head.ends_with("\r\n\r\n") {
            if self.0.read_line(&mut head).ok()? == 0 {
                return None;
            }
        }
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        let mut answer = Answer { status, head, body: Vec::new() };
        let length = answer.header("content-length").map_or(0, |length| length.parse().unwrap());
        if has_body {
            answer.body = vec![0; length];
            self.0.read_exact(&mut answer.body).unwrap();
        }
        Some(answer)
    }
}

fn running() -> (Server, Publisher, SocketAddr) {
    let (server, publisher) = server(Control::Team, false, &Scene::default());
    assert!(publisher.metrics("murmurate_test 1\n".to_owned()));
    let at = server.address();
    (server, publisher, at)
}

/// Requests by their first line and further headers, with the status of the answer, all on one connection.
const REQUESTS: [(&str, &str, u16); 24] = [
    ("GET / HTTP/1.1", "", 200),
    ("GET /?a=b HTTP/1.1", "", 200),
    ("GET /page.css?v=1&v=2 HTTP/1.1", "", 200),
    ("GET /page.js HTTP/1.1", "Accept: text/html\r\nAccept-Encoding: br, gzip\r\n", 200),
    ("GET /metrics HTTP/1.1", "", 200),
    ("GET /metrics?x=1 HTTP/1.1", "", 200),
    ("GET /healthz?verbose HTTP/1.1", "", 200),
    ("HEAD / HTTP/1.1", "", 200),
    ("HEAD /metrics?x=1 HTTP/1.1", "", 200),
    ("HEAD /healthz HTTP/1.1", "", 200),
    ("HEAD /nothing HTTP/1.1", "", 404),
    ("GET /nothing HTTP/1.1", "", 404),
    ("GET /page.js/ HTTP/1.1", "", 404),
    ("GET /../Cargo.toml HTTP/1.1", "", 404),
    ("GET /%2e%2e/Cargo.toml HTTP/1.1", "", 404),
    ("DELETE / HTTP/1.1", "", 405),
    ("FOO /page.js HTTP/1.1", "", 405),
    ("OPTIONS /metrics HTTP/1.1", "", 405),
    ("POST / HTTP/1.1", "Content-Length: 0\r\n", 405),
    ("GET / HTTP/1.1", "If-None-Match: \"another\", W/\"one more\"\r\n", 200),
    ("GET /metrics HTTP/1.1", "If-None-Match: *\r\n", 200),
    ("GET /page.js HTTP/1.1", "If-None-Match: *\r\n", 304),
    // What is left out of a file is for the server to choose: it sends all of it.
    ("GET /page.js HTTP/1.1", "Range: bytes=0-9\r\n", 200),
    ("GET / HTTP/1.1", "Expect: 100-continue\r\n", 200),
];

#[test]
fn a_connection_takes_one_request_after_another() {
    let (_server, _publisher, at) = running();
    let mut kept = Kept::open(at);
    for (line, more, status) in REQUESTS {
        kept.send(&format!("{line}\r\nHost: {at}\r\n{more}\r\n"));
        let answer = kept.read(!line.starts_with("HEAD") && status != 304);
        let answer = answer.unwrap_or_else(|| panic!("{line} {more}: the connection has ended"));
        assert_eq!(answer.status, status, "{line} {more}");
        assert_eq!(answer.header("allow"), (status == 405).then_some("GET,HEAD"), "{line}");
        assert!(answer.header("date").is_some(), "{line}");
        let length: usize = answer.header("content-length").map_or(0, |length| length.parse().unwrap());
        assert_eq!(status == 200, length > 0 && status < 400, "{line}: {}", answer.head);
    }
    // Two at once, and the last.
    kept.send(&format!("GET /healthz HTTP/1.1\r\nHost: {at}\r\n\r\nGET / HTTP/1.1\r\nHost: {at}\r\n\r\n"));
    assert_eq!(kept.read(true).map(|answer| answer.body), Some(b"ok\n".to_vec()));
    assert!(kept.read(true).is_some_and(|answer| answer.body.starts_with(b"<!doctype html>")));
    kept.send(&format!("GET /healthz HTTP/1.1\r\nHost: {at}\r\nConnection: close\r\n\r\n"));
    assert!(kept.read(true).is_some_and(|answer| answer.header("connection") == Some("close")));
    assert!(kept.read(true).is_none(), "it ends");
}

#[test]
fn a_file_that_the_browser_has_is_not_sent_again() {
    let (_server, _publisher, at) = running();
    let mut kept = Kept::open(at);
    for path in ["/", "/page.css", "/page.js"] {
        kept.send(&format!("GET {path} HTTP/1.1\r\nHost: {at}\r\n\r\n"));
        let whole = kept.read(true).unwrap();
        let version = whole.header("etag").expect("a version").to_owned();
        kept.send(&format!("HEAD {path} HTTP/1.1\r\nHost: {at}\r\n\r\n"));
        let head = kept.read(false).unwrap();
        let same = |name| whole.header(name).is_some() && whole.header(name) == head.header(name);
        assert!(["etag", "content-type", "content-length", "cache-control"].into_iter().all(same), "{}", head.head);
        for known in [version.clone(), format!("W/{version}"), format!("\"a\", {version}")] {
            for method in ["GET", "HEAD"] {
                kept.send(&format!("{method} {path} HTTP/1.1\r\nHost: {at}\r\nIf-None-Match: {known}\r\n\r\n"));
                let answer = kept.read(false).unwrap();
                assert_eq!((answer.status, answer.header("etag")), (304, Some(&*version)), "{known}");
            }
        }
    }
}

#[test]
fn old_and_odd_requests_are_answered_or_refused() {
    let (_server, _publisher, at) = running();
    let host = format!("Host: {at}\r\n");
    for (request, status) in [
        // It ends the connection, as the version asks for.
        (format!("GET /healthz HTTP/1.0\r\n{host}\r\n"), 200),
        (format!("GET http://{at}/healthz HTTP/1.1\r\n{host}Connection: close\r\n\r\n"), 200),
        (format!("GET http://evil.example/ HTTP/1.1\r\n{host}Connection: close\r\n\r\n"), 421),
        ("GET /healthz HTTP/1.0\r\n\r\n".to_owned(), 421),
        (format!("GET / HTTP/2.0\r\n{host}\r\n"), 400),
        (format!("GET / HTTP/1.1\r\n{host}Bad Name: x\r\n\r\n"), 400),
        (format!("GET / HTTP/1.1\r\n{host}{}\r\n", "X: y\r\n".repeat(100)), 431),
        (format!("GET /{} HTTP/1.1\r\n{host}\r\n", "a".repeat(9000)), 431),
        // A body that never comes is not waited for.
        (format!("POST / HTTP/1.1\r\n{host}Content-Length: 1000000\r\n\r\n"), 405),
        (format!("GET /view HTTP/1.1\r\n{host}Origin: http://{at}\r\nConnection: close\r\n\r\n"), 400),
    ] {
        let mut kept = Kept::open(at);
        kept.send(&request);
        let answer = kept.read(true).unwrap_or_else(|| panic!("{request}: no answer"));
        assert_eq!(answer.status, status, "{request}");
        assert!(kept.read(true).is_none(), "{request}: it ends");
    }
}

#[test]
fn who_reads_slowly_gets_all_of_it() {
    let (_server, publisher, at) = running();
    let text = "murmurate_test 1\n".repeat(200_000);
    assert!(publisher.metrics(text.clone()));
    let mut kept = Kept::open(at);
    kept.send(&format!("GET /metrics HTTP/1.1\r\nHost: {at}\r\n\r\n"));
    // Others are served meanwhile.
    let mut other = Kept::open(at);
    other.send(&format!("GET /healthz HTTP/1.1\r\nHost: {at}\r\n\r\n"));
    assert_eq!(other.read(true).map(|answer| answer.status), Some(200));
    assert!(kept.read(true).is_some_and(|answer| answer.body == text.as_bytes()));
}

#[test]
fn who_never_reads_is_let_go() {
    let (server, publisher, at) = running();
    // More than all buffers on the way hold.
    assert!(publisher.metrics("murmurate_test 1\n".repeat(3_000_000)));
    let mut kept = Kept::open(at);
    kept.send(&format!("GET /metrics HTTP/1.1\r\nHost: {at}\r\n\r\n"));
    let mut byte = [0];
    kept.0.get_mut().read_exact(&mut byte).unwrap();
    assert_eq!(server.connections(), 1);
    let mut turns = 0;
    while server.connections() > 0 {
        publisher.wait(Duration::from_millis(100));
        turns += 1;
        assert!(turns < 1200, "it keeps its place");
    }
}

#[test]
fn who_falls_silent_is_let_go_and_a_stop_arrives_meanwhile() {
    let (_server, publisher, at) = running();
    let mut page = socket(at, "/control", &[shown(&token())]);
    assert_eq!(read_kind(&mut page, "hello")["holder"], true);
    // Before a request, within it, and after it.
    let whole = format!("GET /healthz HTTP/1.1\r\nHost: {at}\r\n\r\n");
    let mut silent = ["", &whole[..20], &whole].map(|text| {
        let mut kept = Kept::open(at);
        kept.send(text);
        kept
    });
    assert_eq!(silent[2].read(true).map(|answer| answer.status), Some(200));
    page.send(Message::text(r#"{"do":"stop"}"#)).unwrap();
    assert_eq!(publisher.wait(Duration::from_secs(20)), Some(Command::Stop));
    for kept in &silent {
        let waits = kept.0.get_ref().read(&mut [0]).is_err_and(|error| error.kind() == ErrorKind::WouldBlock);
        assert!(!waits, "it keeps its place");
    }
    page.send(Message::text(r#"{"do":"stop"}"#)).unwrap();
    assert_eq!(publisher.wait(Duration::from_secs(20)), Some(Command::Stop), "one with the token keeps its place");
}

#[test]
fn of_a_thousand_connections_the_stated_number_is_served() {
    let (server, publisher, at) = running();
    let mut page = socket(at, "/control", &[shown(&token())]);
    assert_eq!(read_kind(&mut page, "hello")["holder"], true);
    // Connections that say nothing: a hundred at once, as many as wait to be accepted.
    for _ in 0..10 {
        let mute: Vec<TcpStream> = (0..100).map(|_| connect(at)).collect();
        let mut kept = Kept::open(at);
        kept.send(&format!("GET /healthz HTTP/1.1\r\nHost: {at}\r\n\r\n"));
        assert_eq!(kept.read(true).map(|answer| answer.status), Some(200), "the newest is served");
        assert!(server.connections() <= 1 + 16, "{}", server.connections());
        let has_ended = |stream: &TcpStream| {
            stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
            !matches!((&*stream).read(&mut [0]), Err(error) if error.kind() == ErrorKind::WouldBlock)
        };
        assert!(mute[..100 - 15].iter().all(has_ended), "all but the newest are ended");
    }
    // WebSockets without the token.
    let mut others = Vec::new();
    let statuses: Vec<u16> = (0..1000).map(|_| open_view(at, &mut others)).collect();
    let number = |status| statuses.iter().filter(|other| **other == status).count();
    assert_eq!((number(101), number(503)), (16, 984));
    // Those with the token, one of which is there already.
    let mut holders: Vec<_> = (0..31).map(|_| socket(at, "/control", &[shown(&token())])).collect();
    let mut further = Kept::open(at);
    further.send(&upgrade("/control", &[own(at), vec![shown(&token())]].concat()));
    assert_eq!(further.read(true).map(|answer| answer.status), Some(503));
    page.send(Message::text(r#"{"do":"stop"}"#)).unwrap();
    holders.iter_mut().for_each(|holder| holder.send(Message::text(r#"{"do":"rearm"}"#)).unwrap());
    assert_eq!(publisher.wait(Duration::from_secs(20)), Some(Command::Stop));
}

/// Asks for a WebSocket without the token, and keeps it if it is granted. Returns the status.
fn open_view(at: SocketAddr, kept: &mut Vec<Kept>) -> u16 {
    let mut one = Kept::open(at);
    one.send(&upgrade("/view", &own(at)));
    let status = one.read(true).map_or(0, |answer| answer.status);
    if status == 101 {
        kept.push(one);
    } else {
        let _ = one.0.get_ref().shutdown(Shutdown::Both);
    }
    status
}
