//! HTTP requests of the live page: the routes, what stands before all of them, and who may open a WebSocket.

use std::fmt;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::{Extension, Request, State};
use axum::http::header::{self, AsHeaderName, HeaderMap, HeaderName, HeaderValue};
use axum::http::{StatusCode, Uri};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;

use super::access::{self, Access, Ends, Socket, Standing, Wanted};
use super::command::MAX_BYTES;
use super::places::Admission;
use super::session;
use super::shared::{Connection, Place, Shared};

/// Time without a sign of life of the thread that drives the team after which the program counts as unhealthy.
const HEALTHY: Duration = Duration::from_secs(3);

/// Name of the WebSocket subprotocol of the live page.
const PROTOCOL: &str = "murmurate";

/// Headers of every response. They forbid caching, content sniffing, embedding in other pages and loading from
/// elsewhere.
const SECURITY: [(HeaderName, HeaderValue); 6] = [
    (header::CACHE_CONTROL, HeaderValue::from_static("no-store")),
    (header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff")),
    (header::X_FRAME_OPTIONS, HeaderValue::from_static("DENY")),
    (header::REFERRER_POLICY, HeaderValue::from_static("no-referrer")),
    (HeaderName::from_static("cross-origin-resource-policy"), HeaderValue::from_static("same-origin")),
    (
        header::CONTENT_SECURITY_POLICY,
        HeaderValue::from_static(
            "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; frame-ancestors 'none'; \
             base-uri 'none'; form-action 'none'",
        ),
    ),
];

/// Files of the live page: path, media type, content.
const FILES: [(&str, &str, &str); 3] = [
    ("/", "text/html; charset=utf-8", include_str!("page/index.html")),
    ("/page.css", "text/css; charset=utf-8", include_str!("page/page.css")),
    ("/page.js", "text/javascript; charset=utf-8", include_str!("page/page.js")),
];
/// Version of each of these files: that of this package's sources, of which they are a part.
const VERSION: &str = concat!("\"", env!("SOURCE_DIGEST"), "\"");

/// Refusal of a request: the status of the response, and the reason for the user.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// Status of the response.
    pub status: StatusCode,
    why: String,
}

impl Refusal {
    fn new(status: StatusCode, why: impl fmt::Display) -> Refusal {
        Refusal { status, why: why.to_string() }
    }
}

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        (self.status, format!("{}: {}\n", self.status, self.why)).into_response()
    }
}

/// Returns the routes of the live page's server.
pub(super) fn router(shared: Arc<Shared>) -> Router {
    let mut router = Router::new().route("/metrics", get(metrics)).route("/healthz", get(health));
    let mut nothing = "there are /metrics and /healthz alone";
    if shared.access.page {
        nothing = "there is no such page";
        for (path, kind, content) in FILES {
            router = router.route(path, get(async move |headers: HeaderMap| file(&headers, kind, content)));
        }
        for (path, wanted) in [("/view", Wanted::View), ("/control", Wanted::Control)] {
            let open = async move |State(shared), Extension(connection), headers: HeaderMap, handshake| {
                open(wanted, shared, connection, &headers, handshake)
            };
            router = router.route(path, get(open));
        }
        #[cfg(feature = "foxglove")]
        if shared.access.foxglove {
            router = router.route("/foxglove", get(foxglove));
        }
    }
    router
        .fallback(async move || Refusal::new(StatusCode::NOT_FOUND, nothing))
        .layer(middleware::from_fn_with_state(Arc::clone(&shared), guard))
        .with_state(shared)
}

/// Answers a request for another host itself, and all others by what is next. Counts what is refused, and adds the
/// headers of every response.
async fn guard(
    State(shared): State<Arc<Shared>>,
    Extension(Connection { ends, .. }): Extension<Connection>,
    request: Request,
    next: Next,
) -> Response {
    let mut response = if is_for(request.uri(), request.headers(), ends.local) {
        next.run(request).await
    } else {
        let why =
            format!("the request is for another host; open http://{}/ (a tunnel keeps the port number)", ends.local);
        Refusal::new(StatusCode::MISDIRECTED_REQUEST, why).into_response()
    };
    if response.status().is_client_error() || response.status().is_server_error() {
        shared.refuse();
    }
    response.headers_mut().extend(SECURITY);
    response
}

/// Returns whether a request is for the server at `local`, by its header `Host`, and by its address where that has a
/// host.
fn is_for(uri: &Uri, headers: &HeaderMap, local: SocketAddr) -> bool {
    let host = only(headers, header::HOST).unwrap_or_default();
    access::is_host(host, local) && uri.authority().is_none_or(|named| access::is_host(named.as_str(), local))
}

/// Returns the value of a header that occurs exactly once; otherwise `None`.
fn only(headers: &HeaderMap, name: impl AsHeaderName) -> Option<&str> {
    let mut all = headers.get_all(name).iter();
    let first = all.next().filter(|_| all.next().is_none())?;
    first.to_str().ok().map(str::trim)
}

/// Returns a file of the page, or that the browser has it.
fn file(headers: &HeaderMap, kind: &'static str, content: &'static str) -> Response {
    let known = only(headers, header::IF_NONE_MATCH).unwrap_or_default();
    if known.split(',').map(str::trim).any(|one| one == "*" || one.trim_start_matches("W/") == VERSION) {
        return (StatusCode::NOT_MODIFIED, [(header::ETAG, VERSION)]).into_response();
    }
    ([(header::CONTENT_TYPE, kind), (header::ETAG, VERSION)], content).into_response()
}

/// Returns the metrics, in the text format of Prometheus.
async fn metrics(State(shared): State<Arc<Shared>>, headers: HeaderMap) -> Result<Response, Refusal> {
    let access = &shared.access;
    if access.guarded && !access.token.is_borne_by(only(&headers, header::AUTHORIZATION).unwrap_or_default()) {
        let why = "the metrics need the token: Authorization: Bearer TOKEN";
        return Err(Refusal::new(StatusCode::UNAUTHORIZED, why));
    }
    let text = shared.metrics.get();
    if text.is_empty() {
        return Err(Refusal::new(StatusCode::NOT_FOUND, "there are no metrics yet, and none of a record"));
    }
    Ok(([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], text).into_response())
}

/// Returns the program's health: an error if the last sign of life of the thread that drives the team is 3 s old.
async fn health(State(shared): State<Arc<Shared>>) -> Result<&'static str, Refusal> {
    let silent_for = shared.silent_for();
    if silent_for < HEALTHY {
        return Ok("ok\n");
    }
    let why = format!("no news from the program for {:.1} s", silent_for.as_secs_f64());
    Err(Refusal::new(StatusCode::SERVICE_UNAVAILABLE, why))
}

/// Handshake of a WebSocket, or why there is none.
type Handshake = Result<WebSocketUpgrade, WebSocketUpgradeRejection>;

/// Opens a WebSocket, where the browser may have one and there is a place for it.
fn open(
    wanted: Wanted,
    shared: Arc<Shared>,
    Connection { ends, place }: Connection,
    headers: &HeaderMap,
    handshake: Handshake,
) -> Result<Response, Refusal> {
    let socket = admit(wanted, headers, ends, &shared.access)?;
    let admission = if socket.is_holder() { Admission::Holder } else { Admission::Other };
    let handshake = limited(handshake, PROTOCOL, &place, admission)?;
    Ok(handshake.on_upgrade(async move |client| {
        session::run(client, socket, &shared).await;
        drop(place);
    }))
}

/// Takes the place of a WebSocket, and sets the protocol and the limits of its messages.
fn limited(
    handshake: Handshake,
    protocol: &'static str,
    place: &Place,
    admission: Admission,
) -> Result<WebSocketUpgrade, Refusal> {
    let handshake = handshake.map_err(|why| Refusal::new(why.status(), why.body_text()))?;
    if !place.upgrade(admission) {
        let why = "too many connections: close other pages";
        return Err(Refusal::new(StatusCode::SERVICE_UNAVAILABLE, why));
    }
    let handshake = handshake.protocols([protocol]).read_buffer_size(MAX_BYTES);
    Ok(handshake.max_message_size(MAX_BYTES).max_frame_size(MAX_BYTES))
}

/// Opens a connection of Foxglove, which needs the token. It is of no page, so that any page could ask for one.
#[cfg(feature = "foxglove")]
async fn foxglove(
    State(shared): State<Arc<Shared>>,
    Extension(Connection { place, .. }): Extension<Connection>,
    uri: Uri,
    handshake: Handshake,
) -> Result<Response, Refusal> {
    use super::foxglove_live;
    if !shared.access.token.is_asked_with(uri.query().unwrap_or_default()) {
        return Err(Refusal::new(StatusCode::UNAUTHORIZED, "no token: connect to /foxglove?token=TOKEN"));
    }
    let handshake = limited(handshake, foxglove_live::PROTOCOL, &place, Admission::Holder)?;
    Ok(handshake.on_upgrade(async move |client| {
        foxglove_live::run(client, &shared).await;
        drop(place);
    }))
}

/// Returns the kind of WebSocket that a browser gets who asks for `wanted` with these headers, by the rules `access`.
pub fn admit(wanted: Wanted, headers: &HeaderMap, ends: Ends, access: &Access) -> Result<Socket, Refusal> {
    let host = only(headers, header::HOST).unwrap_or_default();
    if !only(headers, header::ORIGIN).is_some_and(|origin| access::is_origin(origin, host)) {
        let why = "a WebSocket comes from the page of this server alone";
        return Err(Refusal::new(StatusCode::FORBIDDEN, why));
    }
    let token = access.token.is_among(only(headers, header::SEC_WEBSOCKET_PROTOCOL).unwrap_or_default());
    let standing = access.standing(ends.peer, token);
    match wanted {
        Wanted::View if !access.guarded || token => Ok(Socket::View { holder: token }),
        Wanted::Control if standing != Standing::Stranger => Ok(Socket::Control(standing)),
        _ => Err(Refusal::new(StatusCode::UNAUTHORIZED, "no token: open the address that the program printed")),
    }
}
