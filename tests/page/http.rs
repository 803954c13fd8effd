//! Requests to a server of the page over plain TCP, and the server of a made-up team.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use murmurate_view::access::{Access, Control, Token};
use murmurate_view::server::{Publisher, Server};
use murmurate_view::status::Scene;
use tungstenite::protocol::Role;
use tungstenite::{Message, WebSocket};

/// Token of all servers here.
pub fn token() -> String {
    "5a".repeat(16)
}

/// Starts a server to which Foxglove may connect.
#[cfg(feature = "foxglove")]
pub fn server_for_foxglove(scene: &Scene) -> (Server, Publisher) {
    let (token, control) = (Token::new(&[0x5a; 16]), Control::Team);
    let access = Access { token, control, guarded: false, foxglove: true, page: true };
    Server::open("127.0.0.1:0".parse().unwrap(), access, scene.to_json()).unwrap()
}

/// Starts a server at a free port of the loopback interface.
pub fn server(control: Control, guarded: bool, scene: &Scene) -> (Server, Publisher) {
    let access = Access { token: Token::new(&[0x5a; 16]), control, guarded, foxglove: false, page: true };
    Server::open("127.0.0.1:0".parse().unwrap(), access, scene.to_json()).unwrap()
}

pub fn connect(to: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(to).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    stream
}

/// Sends bytes, a request of which is said to be the last, and returns everything that comes back until the server ends
/// the connection.
pub fn ask(to: SocketAddr, request: &str) -> String {
    let mut stream = connect(to);
    let request = request.replacen("\r\n\r\n", "\r\nConnection: close\r\n\r\n", 1);
    // The server may have refused before it has all of it.
    let _ = stream.write_all(request.as_bytes());
    let mut all = Vec::new();
    let _ = stream.read_to_end(&mut all);
    String::from_utf8_lossy(&all).into_owned()
}

/// Returns the request of a WebSocket. Each header is a line without its end.
pub fn upgrade(path: &str, headers: &[String]) -> String {
    let own = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n\
               Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
    let lines: String = headers.iter().map(|line| format!("{line}\r\n")).collect();
    format!("GET {path} HTTP/1.1\r\n{lines}{own}\r\n")
}

/// Headers of a page of the server itself.
pub fn own(to: SocketAddr) -> Vec<String> {
    vec![format!("Host: {to}"), format!("Origin: http://{to}")]
}

/// Header that shows this token.
pub fn shown(token: &str) -> String {
    format!("Sec-WebSocket-Protocol: murmurate, token.{token}")
}

/// Opens a WebSocket as the page does, with further headers.
pub fn socket(to: SocketAddr, path: &str, more: &[String]) -> WebSocket<TcpStream> {
    let mut stream = connect(to);
    stream.write_all(upgrade(path, &[own(to), more.to_vec()].concat()).as_bytes()).unwrap();
    let (mut head, mut byte) = (Vec::new(), [0]);
    while !head.ends_with(b"\r\n\r\n") {
        stream.read_exact(&mut byte).unwrap();
        head.push(byte[0]);
    }
    assert!(head.starts_with(b"HTTP/1.1 101 "), "{}", String::from_utf8_lossy(&head));
    WebSocket::from_raw_socket(stream, Role::Client, None)
}

/// Returns the next message of a WebSocket. A machine that is halted and goes on interrupts a read with a time limit.
pub fn next(socket: &mut WebSocket<TcpStream>) -> Message {
    loop {
        match socket.read() {
            Err(tungstenite::Error::Io(error)) if error.kind() == std::io::ErrorKind::Interrupted => {}
            read => return read.unwrap(),
        }
    }
}

/// Reads messages of a WebSocket until one of this kind.
pub fn read_kind(socket: &mut WebSocket<TcpStream>, kind: &str) -> serde_json::Value {
    loop {
        let Message::Text(text) = next(socket) else { continue };
        let message: serde_json::Value = serde_json::from_str(&text).unwrap();
        if message["kind"] == kind {
            return message["body"].clone();
        }
    }
}
