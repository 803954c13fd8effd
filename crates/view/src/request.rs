//! HTTP requests of the live page: reads a header within a time limit, and makes the response.

use std::io::{self, Read};
use std::net::{IpAddr, SocketAddr, TcpStream};
use std::time::{Duration, Instant};

use data_encoding::BASE64;
use sha1_smol::Sha1;

use super::access::{self, Access, Standing};

/// Largest header of an HTTP request that is accepted \[bytes\].
pub const MAX_HEADER_BYTES: usize = 8192;
/// Largest number of header lines.
const MAX_HEADERS: usize = 64;
/// Longest time in which the whole header of an HTTP request must arrive.
pub const HEADER_TIME: Duration = Duration::from_secs(5);

/// Time without a sign of life of the thread that drives the team after which the program counts as unhealthy.
const HEALTHY: Duration = Duration::from_secs(3);

/// Name of the WebSocket subprotocol of the live page.
const PROTOCOL: &str = "murmurate";

/// Headers of every response. They forbid caching, content sniffing, embedding in other pages and loading from
/// elsewhere.
const SECURITY: &str = "Cache-Control: no-store\r\n\
    X-Content-Type-Options: nosniff\r\n\
    X-Frame-Options: DENY\r\n\
    Referrer-Policy: no-referrer\r\n\
    Cross-Origin-Resource-Policy: same-origin\r\n\
    Content-Security-Policy: default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; \
    frame-ancestors 'none'; base-uri 'none'; form-action 'none'\r\n";

/// Files of the live page: path, media type, content.
const FILES: [(&str, &str, &str); 3] = [
    ("/", "text/html; charset=utf-8", include_str!("page/index.html")),
    ("/page.css", "text/css; charset=utf-8", include_str!("page/page.css")),
    ("/page.js", "text/javascript; charset=utf-8", include_str!("page/page.js")),
];

/// Kind of a WebSocket connection of the live page, by its path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Socket {
    /// Snapshots of the team in binary form, from the server to the browser.
    View {
        /// Whether the browser has sent the page's token.
        holder: bool,
    },
    /// Goals and status from the server, and commands from the browser. It is separate from the snapshots, so that a
    /// command never waits behind them.
    Control(Standing),
}

impl Socket {
    /// Whether the browser has sent the page's token.
    pub fn is_holder(self) -> bool {
        match self {
            Socket::View { holder } => holder,
            Socket::Control(standing) => standing.is_holder(),
        }
    }
}

/// Response to an HTTP request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Response {
    /// Complete response with a file or an error, as bytes.
    Whole(Vec<u8>),
    /// Answer to a request for the metrics, which the server has to make.
    Metrics,
    /// Answer to a request for the health of the program, which the server has to make.
    Health,
    /// Accepted WebSocket connection: its kind, and the bytes of the response to the handshake.
    Upgrade(Socket, Vec<u8>),
}

/// Received header of an HTTP request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    /// Bytes of the header, including the empty line at its end.
    pub bytes: Vec<u8>,
    /// Bytes that were received after the header.
    pub rest: Vec<u8>,
}

/// Reads the header of an HTTP request within [`HEADER_TIME`]. The error is the response to a header that is too large,
/// or `None` if the connection has ended or was too slow.
pub fn read_header(stream: &mut TcpStream) -> Result<Header, Option<Vec<u8>>> {
    let until = Instant::now() + HEADER_TIME;
    let mut bytes = Vec::new();
    let mut part = [0; 1024];
    loop {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() || stream.set_read_timeout(Some(left)).is_err() {
            return Err(None);
        }
        let count = match stream.read(&mut part) {
            Ok(0) => return Err(None),
            Ok(count) => count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(_) => return Err(None),
        };
        // The end of the header may span two reads.
        let from = bytes.len().saturating_sub(3);
        bytes.extend_from_slice(&part[..count]);
        if let Some(end) = bytes[from..].windows(4).position(|four| four == b"\r\n\r\n") {
            let rest = bytes.split_off(from + end + 4);
            return if bytes.len() > MAX_HEADER_BYTES { Err(Some(too_large())) } else { Ok(Header { bytes, rest }) };
        }
        if bytes.len() > MAX_HEADER_BYTES {
            return Err(Some(too_large()));
        }
    }
}

fn too_large() -> Vec<u8> {
    refusal("431 Request Header Fields Too Large", "the header is larger than 8 kB")
}

/// Returns the response to a connection that exceeds the largest number of connections.
pub fn too_many() -> Vec<u8> {
    refusal("503 Service Unavailable", "too many connections: close other pages")
}

/// Returns the response to a request with the header `header` that was received at the server's address `local` from a
/// browser at `peer`. `access` has the rules of who may request what.
pub fn respond(header: &[u8], (local, peer): (SocketAddr, IpAddr), access: &Access) -> Response {
    let mut headers = [httparse::EMPTY_HEADER; MAX_HEADERS];
    let mut request = httparse::Request::new(&mut headers);
    if !matches!(request.parse(header), Ok(httparse::Status::Complete(_))) {
        return refused("400 Bad Request", "this is no HTTP request");
    }
    let request = Request(&request);
    let host = request.header("host").unwrap_or_default();
    if !access::is_host(host, local) {
        let why = format!("the request is for another host; open http://{local}/ (a tunnel keeps the port number)");
        return refused("421 Misdirected Request", &why);
    }
    if request.0.method != Some("GET") {
        return refused("405 Method Not Allowed", "this server answers to GET alone");
    }
    let path = request.0.path.unwrap_or_default();
    match path {
        "/healthz" => return Response::Health,
        "/metrics"
            if access.guarded && !access.token.is_borne_by(request.header("authorization").unwrap_or_default()) =>
        {
            return refused("401 Unauthorized", "the metrics need the token: Authorization: Bearer TOKEN");
        }
        "/metrics" => return Response::Metrics,
        _ if !access.page => return refused("404 Not Found", "there are /metrics and /healthz alone"),
        _ => {}
    }
    if let Some((_, kind, content)) = FILES.iter().find(|(name, ..)| *name == path) {
        return Response::Whole(response("200 OK", kind, content));
    }
    let token = access.token.is_among(request.header("sec-websocket-protocol").unwrap_or_default());
    let standing = access.standing(peer, token);
    match path {
        "/view" if access.guarded && !token => request.upgrade(host, None),
        "/view" => request.upgrade(host, Some(Socket::View { holder: token })),
        "/control" if standing == Standing::Stranger => request.upgrade(host, None),
        "/control" => request.upgrade(host, Some(Socket::Control(standing))),
        _ => refused("404 Not Found", "there is no such page"),
    }
}

struct Request<'a>(&'a httparse::Request<'a, 'a>);

impl Request<'_> {
    /// Returns the value of a header that occurs exactly once; otherwise `None`.
    fn header(&self, name: &str) -> Option<&str> {
        let mut all = self.0.headers.iter().filter(|header| header.name.eq_ignore_ascii_case(name));
        let first = all.next().filter(|_| all.next().is_none())?;
        std::str::from_utf8(first.value).ok().map(str::trim)
    }

    /// Returns whether the comma-separated list in the header `name` contains this word.
    fn lists(&self, name: &str, word: &str) -> bool {
        self.header(name).is_some_and(|all| all.split(',').any(|one| one.trim().eq_ignore_ascii_case(word)))
    }

    /// Returns the response to a WebSocket handshake. `socket` is `None` if the request lacks the token; it is then
    /// refused.
    fn upgrade(&self, host: &str, socket: Option<Socket>) -> Response {
        if !self.header("origin").is_some_and(|origin| access::is_origin(origin, host)) {
            return refused("403 Forbidden", "a WebSocket comes from the page of this server alone");
        }
        let Some(socket) = socket else {
            return refused("401 Unauthorized", "no token: open the address that the program printed");
        };
        let version = self.header("sec-websocket-version") == Some("13");
        let upgrades = self.lists("connection", "upgrade") && self.lists("upgrade", "websocket") && version;
        match self.header("sec-websocket-key").filter(|_| upgrades) {
            None => refused("400 Bad Request", "this path is a WebSocket"),
            Some(key) => {
                let accept = accept_key(key);
                let chosen = match self.lists("sec-websocket-protocol", PROTOCOL) {
                    true => format!("Sec-WebSocket-Protocol: {PROTOCOL}\r\n"),
                    false => String::new(),
                };
                let text = format!(
                    "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
                     Sec-WebSocket-Accept: {accept}\r\n{chosen}\r\n"
                );
                Response::Upgrade(socket, text.into_bytes())
            }
        }
    }
}

/// Returns the value of `Sec-WebSocket-Accept` that answers the key of a WebSocket handshake (RFC 6455, section 4.2.2).
fn accept_key(key: &str) -> String {
    let mut digest = Sha1::from(key);
    digest.update(b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11");
    BASE64.encode(&digest.digest().bytes())
}

/// Returns the HTTP response with these metrics, in the text format of Prometheus. An empty text gives an error
/// response.
pub fn metrics(text: &str) -> Vec<u8> {
    match text {
        "" => refusal("404 Not Found", "there are no metrics yet, and none of a record"),
        text => response("200 OK", "text/plain; version=0.0.4; charset=utf-8", text),
    }
}

/// Returns the HTTP response about the program's health: an error if `silent_for`, the time since the last sign of life
/// of the thread that drives the team, is 3 s or longer.
pub fn health(silent_for: Duration) -> Vec<u8> {
    if silent_for < HEALTHY {
        return response("200 OK", "text/plain; charset=utf-8", "ok\n");
    }
    let why = format!("no news from the program for {:.1} s", silent_for.as_secs_f64());
    refusal("503 Service Unavailable", &why)
}

fn refused(status: &str, why: &str) -> Response {
    Response::Whole(refusal(status, why))
}

fn refusal(status: &str, why: &str) -> Vec<u8> {
    response(status, "text/plain; charset=utf-8", &format!("{status}: {why}\n"))
}

fn response(status: &str, kind: &str, body: &str) -> Vec<u8> {
    let length = body.len();
    format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\n{SECURITY}\
         Connection: close\r\n\r\n{body}"
    )
    .into_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_answer_to_a_handshake_is_that_of_the_standard() {
        // The example of RFC 6455, section 1.3.
        assert_eq!(accept_key("dGhlIHNhbXBsZSBub25jZQ=="), "s3pPLMBiTxaQ9kYGzzhZRbK+xOo=");
    }
}
