//! Foxglove's live connection, by its protocol: what is advertised, subscribed to and sent, and who is refused.

use std::net::SocketAddr;

use foxglove::Decode;
use foxglove::messages::SceneUpdate;
use murmurate::messages::geometry::Vec2;
use murmurate::scenario::Solid;
use murmurate_view::access::Control;
use murmurate_view::snapshot::{RobotState, Snapshot, scale_m};
use murmurate_view::status::Scene;
use serde_json::{Value, json};
use tungstenite::protocol::Role;
use tungstenite::{Message, WebSocket};

use crate::http::{ask, connect, next, own, server, server_for_foxglove, token, upgrade};

/// Header of the subprotocol.
const PROTOCOL: &str = "Sec-WebSocket-Protocol: foxglove.sdk.v1";

fn request(at: SocketAddr, token: &str) -> String {
    upgrade(&format!("/foxglove?token={token}"), &[format!("Host: {at}"), PROTOCOL.to_owned()])
}

fn connected(at: SocketAddr) -> WebSocket<std::net::TcpStream> {
    use std::io::{Read, Write};
    let mut stream = connect(at);
    stream.write_all(request(at, &token()).as_bytes()).unwrap();
    let (mut head, mut byte) = (Vec::new(), [0]);
    while !head.ends_with(b"\r\n\r\n") {
        stream.read_exact(&mut byte).unwrap();
        head.push(byte[0]);
    }
    let head = String::from_utf8(head).unwrap();
    assert!(head.starts_with("HTTP/1.1 101 ") && head.contains("foxglove.sdk.v1"), "{head}");
    WebSocket::from_raw_socket(stream, Role::Client, None)
}

fn text(client: &mut WebSocket<std::net::TcpStream>) -> Value {
    serde_json::from_str(next(client).to_text().unwrap()).unwrap()
}

/// Reads messages of subscriptions until one of this; returns its content.
fn data(client: &mut WebSocket<std::net::TcpStream>, subscription: u32) -> Vec<u8> {
    loop {
        let Message::Binary(bytes) = next(client) else { continue };
        assert_eq!(bytes[0], 1, "data of a message");
        if bytes[1..5] == subscription.to_le_bytes() {
            return bytes[13..].to_vec();
        }
    }
}

#[test]
fn foxglove_sees_the_team_and_commands_nothing() {
    let walls = vec![Solid::Rect([1.0, 2.0, 3.0, 4.0]), Solid::Disc { disc: [0.0, 0.0, 0.5] }];
    let scene = Scene { robots: 2, hull_m: 0.2, scale_m: scale_m(10.0), walls, ..Scene::default() };
    let (server, publisher) = server_for_foxglove(&scene);
    let mut client = connected(server.address());
    assert_eq!(text(&mut client)["op"], "serverInfo");
    let advertised = text(&mut client);
    let channels = advertised["channels"].as_array().expect("channels");
    let topics: Vec<&Value> = channels.iter().map(|channel| &channel["topic"]).collect();
    assert_eq!(topics, ["/scene", "/goals", "/status"]);
    assert_eq!(channels[0]["schemaName"], "foxglove.SceneUpdate");
    assert!(channels[0]["schema"].as_str().is_some_and(|schema| schema.len() > 1000), "the types in full");
    let wanted = json!({ "op": "subscribe", "subscriptions": [
        { "id": 70, "channelId": 0 }, { "id": 72, "channelId": 2 }, { "id": 79, "channelId": 9 },
    ] });
    for said in [json!({ "op": "getParameters", "parameterNames": [] }), json!({ "do": "stop" }), wanted] {
        client.send(Message::text(said.to_string())).unwrap();
    }
    let known = RobotState { position: Some(Vec2::new(1.0, -2.0)), heading: Some(0.5), ..RobotState::default() };
    let latched = RobotState { latched: true, ..RobotState::default() };
    let snapshot = Snapshot { robots: vec![known, latched], ..Snapshot::default() };
    assert!(publisher.snapshot(snapshot.encode(scene.scale_m)));
    let drawn = SceneUpdate::decode(&*data(&mut client, 70)).expect("a message of Foxglove's own type");
    let ids: Vec<&str> = drawn.entities.iter().map(|entity| &*entity.id).collect();
    assert_eq!(ids, ["robot 0", "robot 1", "walls"]);
    let at = drawn.entities[0].cylinders[0].pose.as_ref().and_then(|pose| pose.position.as_ref()).expect("a place");
    assert!((at.x - 1.0).abs() < 1e-3 && (at.y + 2.0).abs() < 1e-3, "{at:?}");
    assert!(drawn.entities[1].cylinders.is_empty(), "nothing is made up");
    assert_eq!(drawn.entities[2].cubes.len(), 1);
    assert!(publisher.status(r#"{"kind":"status","body":{}}"#.to_owned()));
    assert_eq!(data(&mut client, 72), br#"{"kind":"status","body":{}}"#);
    assert_eq!(publisher.command(), None, "it commands nothing");
    server.close();
    let end = std::iter::repeat_with(|| client.read()).find(|read| !matches!(read, Ok(Message::Binary(_))));
    assert!(matches!(end, Some(Ok(Message::Close(_)))), "{end:?}");
}

#[test]
fn foxglove_needs_the_flag_and_the_token_and_the_right_host() {
    let (open, _publisher) = server_for_foxglove(&Scene::default());
    let at = open.address();
    for wrong in [String::new(), "00".repeat(16), format!("{}0", token())] {
        assert!(ask(at, &request(at, &wrong)).starts_with("HTTP/1.1 401 "), "{wrong}");
    }
    assert!(ask(at, &upgrade("/foxglove", &own(at))).starts_with("HTTP/1.1 401 "));
    let rebound = upgrade(&format!("/foxglove?token={}", token()), &["Host: evil.example".to_owned()]);
    assert!(ask(at, &rebound).starts_with("HTTP/1.1 421 "));
    let (closed, _publisher) = server(Control::Team, false, &Scene::default());
    let at = closed.address();
    assert!(ask(at, &request(at, &token())).starts_with("HTTP/1.1 404 "));
}
