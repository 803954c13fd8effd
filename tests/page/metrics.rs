//! `/metrics` and `/healthz`: of a page, and of a host alone, with and without a token.

use std::io::{BufRead, BufReader};
use std::process::Stdio;

use murmurate_view::access::{Access, Control, Token};
use murmurate_view::server::Server;
use murmurate_view::status::Scene;

use crate::http::{ask, server, token};
use crate::program::{murmurate, refuses};

#[test]
fn metrics_are_those_that_were_published_and_need_the_token_where_others_can_read_them() {
    let (open, publisher) = server(Control::StopOnly, false, &Scene::default());
    let at = open.address();
    let get = |path: &str, more: &str| ask(at, &format!("GET {path} HTTP/1.1\r\nHost: {at}\r\n{more}\r\n"));
    assert!(get("/metrics", "").starts_with("HTTP/1.1 404 "), "none yet");
    assert!(publisher.metrics("murmurate_test 1\n".to_owned()));
    let answer = get("/metrics", "");
    assert!(
        answer.contains("content-type: text/plain; version=0.0.4") && answer.ends_with("\r\n\r\nmurmurate_test 1\n")
    );
    assert!(get("/healthz", "").starts_with("HTTP/1.1 200 "));

    let access = Access {
        token: Token::new(&[0x5a; 16]),
        control: Control::StopOnly,
        guarded: true,
        foxglove: false,
        page: false,
    };
    let listen = "127.0.0.1:0".parse().expect("an address");
    let guarded = Server::open(listen, access, String::new()).expect("a server");
    assert!(guarded.1.metrics("murmurate_test 2\n".to_owned()));
    let at = guarded.0.address();
    let get = |path: &str, more: &str| ask(at, &format!("GET {path} HTTP/1.1\r\nHost: {at}\r\n{more}\r\n"));
    for wrong in ["", "Authorization: Bearer\r\n", "Authorization: Basic x\r\n", "Authorization: Bearer 5a\r\n"] {
        assert!(get("/metrics", wrong).starts_with("HTTP/1.1 401 "), "{wrong}");
    }
    let right = format!("Authorization: Bearer {}\r\n", token());
    assert!(get("/metrics", &right).ends_with("murmurate_test 2\n"));
    assert!(get("/healthz", "").starts_with("HTTP/1.1 200 "));
    for page in ["/", "/page.js", "/view", "/control"] {
        assert!(get(page, "").starts_with("HTTP/1.1 404 "), "{page}: a host has no page");
    }
}

#[test]
fn a_host_serves_its_metrics_while_it_runs() {
    let team = concat!(env!("CARGO_MANIFEST_DIR"), "/../../teams/offboard.toml");
    refuses(&["host", team, "--host", "agent-0", "--metrics", "0.0.0.0:0"], &["--metrics", "token"]);
    let number = format!("team={}", 1000 + (4 * std::process::id() + 1) % 60_000);
    let flags = ["host", team, "--host", "world", "--set", &number, "--metrics", "127.0.0.1:0", "--json"];
    let mut host = murmurate(&flags).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("a host");
    let mut lines = BufReader::new(host.stderr.take().expect("its stderr")).lines();
    let address = lines.find_map(|line| Some(line.expect("text").strip_prefix("metrics: http://")?.to_owned()));
    let address = address.expect("the host says where its metrics are");
    let at: std::net::SocketAddr = address.trim_end_matches("/metrics").parse().expect("an address");
    let ready = BufReader::new(host.stdout.take().expect("its stdout")).lines().next();
    assert!(ready.is_some_and(|line| line.expect("text").contains("ready")));
    // The first text comes with the first turn of its event loop.
    let mut text = String::new();
    while !text.starts_with("HTTP/1.1 200 ") {
        text = ask(at, &format!("GET /metrics HTTP/1.1\r\nHost: {at}\r\n\r\n"));
        assert!(host.try_wait().expect("a child").is_none(), "the host runs on: {text}");
    }
    assert!(
        text.contains("murmurate_emergency_stop_engaged ") && text.contains("murmurate_ticks_late_total{robot=\"0\"}")
    );
    host.kill().expect("a child");
    host.wait().expect("a child");
}
