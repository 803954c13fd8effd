//! Every row of the table of threats in docs/watch.md, against the real server.

use std::io::Write;
use std::time::{Duration, Instant};

use murmurate_view::access::{Access, Control, Ends, Socket, Standing, Token, Wanted};
use murmurate_view::command::Command;
use murmurate_view::request;
use murmurate_view::server::MAX_CONNECTIONS;
use murmurate_view::status::Scene;
use tungstenite::Message;
use tungstenite::http::{HeaderName, HeaderValue};

use crate::http::{ask, connect, next, own, read_kind, server, shown, socket, token, upgrade};

#[test]
fn requests_for_another_host_are_misdirected() {
    let (server, _publisher) = server(Control::Emulation, false, &Scene::default());
    let at = server.address();
    let port = at.port();
    for host in [format!("evil.example:{port}"), "127.0.0.1".to_owned(), format!("192.168.0.1:{port}"), String::new()] {
        let page = ask(at, &format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n"));
        assert!(page.starts_with("HTTP/1.1 421 "), "{host}: {page}");
        // DNS rebinding: the browser believes that the page and the server are of one origin.
        let rebound =
            upgrade("/control", &[format!("Host: {host}"), format!("Origin: http://{host}"), shown(&token())]);
        assert!(ask(at, &rebound).starts_with("HTTP/1.1 421 "), "{host}");
    }
    assert!(ask(at, "GET / HTTP/1.1\r\n\r\n").starts_with("HTTP/1.1 421 "));
    assert!(ask(at, &format!("GET / HTTP/1.1\r\nHost: {at}\r\nHost: evil\r\n\r\n")).starts_with("HTTP/1.1 421 "));
    assert!(ask(at, &format!("GET / HTTP/1.1\r\nHost: localhost:{port}\r\n\r\n")).starts_with("HTTP/1.1 200 "));
    assert_eq!(server.refused(), 10);
}

#[test]
fn web_sockets_of_other_pages_are_forbidden() {
    let (server, _publisher) = server(Control::Emulation, false, &Scene::default());
    let at = server.address();
    for path in ["/view", "/control"] {
        for origin in ["http://evil.example", "null", "https://localhost", "http://127.0.0.1", ""] {
            let headers = [format!("Host: {at}"), format!("Origin: {origin}"), shown(&token())];
            assert!(ask(at, &upgrade(path, &headers)).starts_with("HTTP/1.1 403 "), "{path} {origin}");
        }
        let none = upgrade(path, &[format!("Host: {at}")]);
        assert!(ask(at, &none).starts_with("HTTP/1.1 403 "), "{path} without an origin");
        drop(socket(at, path, &[]));
    }
}

/// Parts of the headers that every answer has.
const HEADERS: [&str; 5] =
    ["frame-ancestors 'none'", "default-src 'none'", "nosniff", "no-store", "x-frame-options: DENY"];

#[test]
fn other_methods_paths_and_shapes_are_refused_and_every_answer_has_the_headers() {
    let (server, _publisher) = server(Control::Emulation, false, &Scene::default());
    let at = server.address();
    let asks = |line: &str| ask(at, &format!("{line} HTTP/1.1\r\nHost: {at}\r\n\r\n"));
    for (request, status) in [
        ("GET /", "200"),
        ("GET /page.js", "200"),
        ("POST /", "405"),
        ("OPTIONS /control", "405"),
        ("GET /../Cargo.toml", "404"),
        ("GET /view/", "404"),
        ("GET /control", "403"),
        ("GET", "400"),
    ] {
        let answer = asks(request);
        assert!(answer.starts_with(&format!("HTTP/1.1 {status} ")), "{request}: {answer}");
        // What is no request has an answer without content.
        let needed = if status == "400" { &["content-length: 0"][..] } else { &HEADERS };
        for header in needed {
            assert!(answer.contains(header), "{request}: {header} in {answer}");
        }
        assert!(!answer.to_lowercase().contains("access-control"), "no other origin may read it");
    }
    assert!(ask(at, "\x16\x03\x01 junk\r\n\r\n").starts_with("HTTP/1.1 400 "));
    let large = format!("GET / HTTP/1.1\r\nHost: {at}\r\nX: {}\r\n\r\n", "a".repeat(9000));
    assert!(ask(at, &large).starts_with("HTTP/1.1 431 "));
    let mut plain = own(at);
    plain.push("Upgrade: h2c".to_owned());
    assert!(ask(at, &upgrade("/view", &plain)).starts_with("HTTP/1.1 400 "), "two values of Upgrade");
}

#[test]
fn the_page_names_no_other_address() {
    let (server, _publisher) = server(Control::StopOnly, false, &Scene::default());
    let at = server.address();
    for path in ["/", "/page.css", "/page.js"] {
        let file = ask(at, &format!("GET {path} HTTP/1.1\r\nHost: {at}\r\n\r\n"));
        let body = file.split_once("\r\n\r\n").unwrap().1;
        for word in ["http:", "https:", "//cdn", "@import", "url(", "eval(", "innerHTML", " style=", "onclick="] {
            assert!(!body.contains(word), "{path}: {word}");
        }
        assert_eq!(body.matches("ws:").count(), usize::from(path == "/page.js"), "{path}");
    }
}

#[test]
fn a_stop_needs_no_token_and_everything_else_does() {
    let (server, publisher) = server(Control::Emulation, false, &Scene::default());
    let at = server.address();
    let rearm = || Message::text(r#"{"do":"rearm"}"#);
    for more in [vec![], vec![shown(&"00".repeat(16))], vec![shown("")]] {
        let mut page = socket(at, "/control", &more);
        assert_eq!(read_kind(&mut page, "hello")["holder"], false);
        page.send(rearm()).unwrap();
        assert!(read_kind(&mut page, "refused")["why"].as_str().unwrap().contains("no token"));
        page.send(Message::text(r#"{"do":"stop"}"#)).unwrap();
        assert_eq!(publisher.wait(Duration::from_secs(20)), Some(Command::Stop));
        while publisher.command().is_some() {}
    }
    let mut page = socket(at, "/control", &[shown(&token())]);
    assert_eq!(read_kind(&mut page, "hello")["holder"], true);
    page.send(rearm()).unwrap();
    assert_eq!(publisher.wait(Duration::from_secs(20)), Some(Command::Rearm));
    page.send(Message::text("no JSON")).unwrap();
    assert!(read_kind(&mut page, "refused")["why"].as_str().unwrap().contains("no command"));
}

#[test]
fn without_control_a_page_can_stop_and_with_a_real_team_it_can_inject_no_fault() {
    for (control, word) in [(Control::StopOnly, "--control"), (Control::Team, "emulated")] {
        let (server, publisher) = server(control, false, &Scene::default());
        let mut page = socket(server.address(), "/control", &[shown(&token())]);
        page.send(Message::text(r#"{"do":"kill","role":"body","robot":0}"#)).unwrap();
        assert!(read_kind(&mut page, "refused")["why"].as_str().unwrap().contains(word));
        page.send(Message::text(r#"{"do":"stop"}"#)).unwrap();
        assert_eq!(publisher.wait(Duration::from_secs(20)), Some(Command::Stop));
    }
}

#[test]
fn a_server_that_others_reach_shows_nothing_without_the_token() {
    let (server, publisher) = server(Control::Team, true, &Scene::default());
    let at = server.address();
    assert!(ask(at, &upgrade("/view", &own(at))).starts_with("HTTP/1.1 401 "));
    drop(socket(at, "/view", &[shown(&token())]));
    assert!(publisher.status(r#"{"kind":"status","body":{}}"#.to_owned()));
    let mut page = socket(at, "/control", &[]);
    page.send(Message::text(r#"{"do":"pause"}"#)).unwrap();
    let kinds: Vec<String> = (0..2).map(|_| next(&mut page).into_text().unwrap().to_string()).collect();
    assert!(kinds[0].contains("hello") && kinds[1].contains("refused"), "no scene and no status: {kinds:?}");
    page.send(Message::text(r#"{"do":"stop"}"#)).unwrap();
    assert_eq!(publisher.wait(Duration::from_secs(20)), Some(Command::Stop), "a stop is never refused");
}

#[test]
fn a_stop_from_another_machine_needs_the_token_where_others_reach_the_server() {
    let access =
        Access { token: Token::new(&[0x5a; 16]), control: Control::Team, guarded: true, foxglove: false, page: true };
    let local = "192.168.1.5:8137".parse().unwrap();
    let asks = |peer: &str, wanted: Wanted, more: &[String]| {
        let lines = [own(local), more.to_vec()].concat();
        let headers = lines.iter().map(|line| {
            let (name, value) = line.split_once(": ").unwrap();
            (name.parse::<HeaderName>().unwrap(), value.parse::<HeaderValue>().unwrap())
        });
        request::admit(wanted, &headers.collect(), Ends { local, peer: peer.parse().unwrap() }, &access)
    };
    for wanted in [Wanted::View, Wanted::Control] {
        for more in [vec![], vec![shown(&"00".repeat(16))]] {
            let refusal = asks("192.168.1.7", wanted, &more).expect_err("it is open");
            assert_eq!(refusal.status, 401, "{wanted:?}");
        }
        let opened = asks("192.168.1.7", wanted, &[shown(&token())]);
        assert!(opened.as_ref().is_ok_and(|socket| socket.is_holder()), "{wanted:?}: {opened:?}");
    }
    // A program on this machine stops the team without the token, as ever.
    let near = asks("127.0.0.1", Wanted::Control, &[]);
    assert_eq!(near, Ok(Socket::Control(Standing::Near)));
}

#[test]
fn who_has_the_token_finds_a_place_however_many_others_there_are() {
    let (server, publisher) = server(Control::Team, false, &Scene::default());
    let at = server.address();
    // WebSockets without the token, until there is no place for more; and connections that say nothing.
    let mut others = Vec::new();
    let refused = (0..100).find_map(|_| {
        let mut stream = connect(at);
        stream.write_all(upgrade("/view", &own(at)).as_bytes()).unwrap();
        let mut answer = [0; 12];
        std::io::Read::read_exact(&mut stream, &mut answer).unwrap();
        others.push(stream);
        (&answer != b"HTTP/1.1 101").then_some(answer)
    });
    assert_eq!(refused.as_ref(), Some(b"HTTP/1.1 503"), "their number is limited");
    let mute: Vec<_> = (0..MAX_CONNECTIONS).map(|_| connect(at)).collect();
    let mut page = socket(at, "/control", &[shown(&token())]);
    assert_eq!(read_kind(&mut page, "hello")["holder"], true);
    drop(socket(at, "/view", &[shown(&token())]));
    page.send(Message::text(r#"{"do":"rearm"}"#)).unwrap();
    assert_eq!(publisher.wait(Duration::from_secs(20)), Some(Command::Rearm));
    drop((mute, others));
}

#[test]
fn messages_are_small_and_of_text() {
    let (server, publisher) = server(Control::Emulation, false, &Scene::default());
    let at = server.address();
    let large = format!(r#"{{"do":"stop","x":"{}"}}"#, "a".repeat(5000));
    let messages = [Message::text(large), Message::binary(vec![0; 10]), Message::binary(vec![0; 100_000])];
    for message in messages {
        let mut page = socket(at, "/control", &[shown(&token())]);
        // The server may have closed it before all was sent.
        let _ = page.send(message);
        while page.read().is_ok() {}
    }
    assert_eq!(publisher.command(), None);
    let mut view = socket(at, "/view", &[]);
    view.send(Message::text(r#"{"do":"stop"}"#)).unwrap();
    while view.read().is_ok() {}
    assert_eq!(publisher.command(), None, "the socket of snapshots takes nothing");
}

#[test]
fn connections_are_limited_and_a_header_has_five_seconds() {
    let (server, _publisher) = server(Control::StopOnly, false, &Scene::default());
    let at = server.address();
    let began = Instant::now();
    let mut idle: Vec<_> = (0..MAX_CONNECTIONS).map(|_| connect(at)).collect();
    // The oldest of one address have been ended for newer ones.
    idle.iter_mut().for_each(|stream| drop(stream.write_all(b"GET / HTTP/1.1\r\nX: ")));
    assert!(server.connections() < MAX_CONNECTIONS, "{}", server.connections());
    assert!(ask(at, &format!("GET / HTTP/1.1\r\nHost: {at}\r\n\r\n")).starts_with("HTTP/1.1 200 "), "beside them");
    // A byte now and then does not keep a connection.
    let mut slow = idle.pop().unwrap();
    slow.set_read_timeout(Some(Duration::from_millis(500))).unwrap();
    let mut byte = [0];
    loop {
        let _ = slow.write_all(b"a");
        match std::io::Read::read(&mut slow, &mut byte) {
            Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {
                assert!(began.elapsed().as_secs() < 120, "a byte now and then keeps a connection");
            }
            _ => break,
        }
    }
    assert!(began.elapsed() >= Duration::from_secs(4), "{:?}", began.elapsed());
    for stream in &mut idle {
        while std::io::Read::read(stream, &mut byte).is_ok_and(|count| count > 0) {}
    }
    assert!(
        ask(at, &format!("GET / HTTP/1.1\r\nHost: {at}\r\n\r\n")).starts_with("HTTP/1.1 200 "),
        "places are free again"
    );
}
