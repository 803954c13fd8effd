//! Live connection of Foxglove to the page's server: the team as a drawing, its goals and its status.
//!
//! The protocol is [foxglove.sdk.v1](https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md). It is spoken here
//! since the server of the crate `foxglove` opens a socket of its own, which knows neither token nor `Host`. Its types
//! and schemas are used.

use std::time::Duration;

use axum::Error;
use axum::body::Bytes;
use axum::extract::ws::{Message, WebSocket};
use data_encoding::BASE64;
use foxglove::Encode;
use foxglove::messages::{
    ArrowPrimitive, Color, CubePrimitive, CylinderPrimitive, Point3, Pose, Quaternion, SceneEntity, SceneUpdate,
    TextPrimitive, Timestamp, TriangleListPrimitive, Vector3,
};
use serde::Deserialize;
use serde_json::{Value, json};

use murmurate::edge::EndsProcess;
use murmurate::scenario::{DrawnMover, Solid};

use super::shared::{PAGE, Shared};
use super::snapshot::{Drawn, movers, robots};

/// Name of the WebSocket subprotocol.
pub(super) const PROTOCOL: &str = "foxglove.sdk.v1";
/// Time after which a ping checks a connection on which nothing was sent.
const SILENCE: Duration = Duration::from_secs(2);
/// Topics with the names of their types. The place in this list is the id of the channel.
const CHANNELS: [(&str, &str); 3] =
    [("/scene", "foxglove.SceneUpdate"), ("/goals", "murmurate.Goals"), ("/status", "murmurate.Status")];

const BLUE: [f64; 3] = [0.15, 0.45, 0.85];
const RED: [f64; 3] = [0.85, 0.2, 0.2];
const GREY: [f64; 3] = [0.5, 0.5, 0.5];

/// Subscription of a client to each of the channels: its id, and the version number of what was sent last.
type Subscriptions = [Option<(u32, u64)>; CHANNELS.len()];

/// Message of a client.
#[derive(Deserialize)]
#[serde(tag = "op", rename_all = "camelCase", rename_all_fields = "camelCase")]
enum Request {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    /// Operation that this server does not support, such as a request for parameters.
    #[serde(other)]
    Other,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Subscription {
    id: u32,
    channel_id: usize,
}

/// Serves a connection of Foxglove until either side ends it. It takes no commands.
pub(super) async fn run(mut client: WebSocket, shared: &Shared) {
    let _guard = EndsProcess(PAGE);
    // Any error ends the connection; Foxglove then opens another.
    let _ = serve(&mut client, shared).await;
}

async fn serve(client: &mut WebSocket, shared: &Shared) -> Result<(), Error> {
    let mut ground = Ground::of(&shared.scene);
    let mut told = 0;
    let about = json!({ "op": "serverInfo", "name": "murmurate", "capabilities": [] });
    client.send(Message::text(about.to_string())).await?;
    client.send(Message::text(advertisement().to_string())).await?;
    let mut subscriptions = Subscriptions::default();
    loop {
        // From here on, no news is missed.
        let newer = shared.news.notified();
        let closing = shared.is_closing();
        if let Some(status) = shared.status.newer(&mut told) {
            ground.follow(&status);
        }
        for (channel, subscription) in subscriptions.iter_mut().enumerate() {
            let Some((id, seen)) = subscription else { continue };
            let now = shared.began.elapsed();
            let data = match channel {
                0 => shared.snapshot.newer(seen).map(|bytes| ground.draw(&bytes, now)),
                1 => shared.goals.newer(seen).map(Bytes::from),
                _ => shared.status.newer(seen).map(Bytes::from),
            };
            if let Some(data) = data {
                client.send(Message::Binary(framed(*id, now, &data))).await?;
            }
        }
        if closing {
            return client.send(Message::Close(None)).await;
        }
        tokio::select! {
            received = client.recv() => match received {
                Some(Ok(Message::Text(text))) => take(&text, &mut subscriptions),
                Some(Ok(_)) => {}
                Some(Err(_)) | None => return Ok(()),
            },
            () = newer => {}
            () = tokio::time::sleep(SILENCE) => client.send(Message::Ping(Bytes::new())).await?,
        }
    }
}

/// Notes what a client subscribes to. What it asks for else is passed over.
fn take(text: &str, subscriptions: &mut Subscriptions) {
    match serde_json::from_str(text) {
        Ok(Request::Subscribe { subscriptions: wanted }) => {
            for Subscription { id, channel_id } in wanted {
                if let Some(place) = subscriptions.get_mut(channel_id) {
                    *place = Some((id, 0));
                }
            }
        }
        Ok(Request::Unsubscribe { subscription_ids }) => {
            let leaves = |place: &&mut Option<(u32, u64)>| place.is_some_and(|(id, _)| subscription_ids.contains(&id));
            subscriptions.iter_mut().filter(leaves).for_each(|place| *place = None);
        }
        Ok(Request::Other) | Err(_) => {}
    }
}

/// Returns the message that names all channels.
fn advertisement() -> Value {
    let schema = SceneUpdate::get_schema().map(|schema| BASE64.encode(&schema.data)).unwrap_or_default();
    let channels = CHANNELS.iter().enumerate().map(|(id, (topic, kind))| {
        let (encoding, notation, schema) = match id {
            0 => ("protobuf", "protobuf", &*schema),
            _ => ("json", "jsonschema", r#"{"type":"object"}"#),
        };
        json!({
            "id": id, "topic": topic, "encoding": encoding, "schemaName": kind, "schema": schema,
            "schemaEncoding": notation,
        })
    });
    json!({ "op": "advertise", "channels": channels.collect::<Vec<Value>>() })
}

/// Returns a message of a channel as bytes: of this subscription, at the time `now` since the server was opened.
fn framed(subscription: u32, now: Duration, data: &[u8]) -> Bytes {
    let mut bytes = vec![1];
    bytes.extend(subscription.to_le_bytes());
    bytes.extend(u64::try_from(now.as_nanos()).unwrap_or(u64::MAX).to_le_bytes());
    bytes.extend(data);
    bytes.into()
}

/// Properties of the scene that are drawn, and sizes of the drawn robots.
#[derive(Default, Deserialize)]
struct Ground {
    hull_m: f64,
    scale_m: f32,
    walls: Vec<Solid>,
    /// Walls and obstacles of each episode, where obstacles are drawn for each.
    #[serde(default)]
    drawn: Vec<Vec<Solid>>,
    /// Obstacles that move while an episode runs.
    #[serde(default)]
    movers: Vec<DrawnMover>,
    /// Number of the current episode, from 1; `None` while it is unknown.
    #[serde(skip)]
    episode: Option<usize>,
}

impl Ground {
    /// Reads the scene that a page gets.
    fn of(scene: &str) -> Ground {
        let body = serde_json::from_str(scene).map(|mut message: Value| message["body"].take());
        body.and_then(serde_json::from_value).unwrap_or_default()
    }

    /// Takes the number of the episode from the status that a page gets.
    fn follow(&mut self, status: &str) {
        let message: Value = serde_json::from_str(status).unwrap_or_default();
        self.episode = message["body"]["episode"].as_u64().and_then(|number| usize::try_from(number).ok());
    }

    /// Encodes a drawing of the team in an encoded snapshot.
    fn draw(&self, snapshot: &[u8], now: Duration) -> Bytes {
        let (sec, nsec) = (u32::try_from(now.as_secs()).unwrap_or(u32::MAX), now.subsec_nanos());
        let at = |entity: SceneEntity| SceneEntity {
            timestamp: Some(Timestamp::new(sec, nsec)),
            frame_id: "world".to_owned(),
            ..entity
        };
        let all = robots(snapshot, self.scale_m).enumerate().map(|(robot, drawn)| self.robot(robot, drawn));
        let places = movers(snapshot, self.scale_m);
        let moving: Vec<Solid> = self.movers.iter().zip(places).map(|(mover, at)| mover.body.moved(at)).collect();
        let moving = (!self.movers.is_empty()).then(|| self.solids("moving obstacles", &moving));
        let entities = all.chain([self.walls()]).chain(moving).map(at).collect();
        let mut bytes = Vec::new();
        SceneUpdate { entities, deletions: Vec::new() }.encode(&mut bytes).expect("a vector takes all");
        bytes.into()
    }

    /// A robot: its hull, heading and number; nothing where its position is unknown.
    fn robot(&self, robot: usize, drawn: Drawn) -> SceneEntity {
        let mut entity = SceneEntity { id: format!("robot {robot}"), ..SceneEntity::default() };
        let Some([x, y]) = drawn.position.map(|at| at.map(f64::from)) else { return entity };
        let hull = self.hull_m;
        let colour = colour(if drawn.latched { RED } else { BLUE });
        entity.cylinders.push(CylinderPrimitive {
            pose: pose([x, y, hull / 2.0], 0.0),
            size: size([2.0 * hull, 2.0 * hull, hull]),
            bottom_scale: 1.0,
            top_scale: 1.0,
            color: colour,
        });
        entity.arrows.extend(drawn.heading.map(|heading| ArrowPrimitive {
            pose: pose([x, y, hull], f64::from(heading)),
            shaft_length: hull,
            shaft_diameter: hull / 5.0,
            head_length: hull / 2.0,
            head_diameter: hull / 2.0,
            color: colour,
        }));
        entity.texts.push(TextPrimitive {
            pose: pose([x, y, 2.0 * hull], 0.0),
            billboard: true,
            font_size: 14.0,
            scale_invariant: true,
            color: self::colour(GREY),
            text: robot.to_string(),
        });
        entity
    }

    fn walls(&self) -> SceneEntity {
        let drawn = self.episode.and_then(|number| self.drawn.get(number.checked_sub(1)?));
        self.solids("walls", drawn.unwrap_or(&self.walls))
    }

    /// Returns an entity with walls of these shapes.
    fn solids(&self, id: &str, walls: &[Solid]) -> SceneEntity {
        let height = 2.0 * self.hull_m;
        let mut entity = SceneEntity { id: id.to_owned(), ..SceneEntity::default() };
        for wall in walls {
            let corner = |[x, y, z]: [f32; 3]| Point3 { x: x.into(), y: y.into(), z: z.into() };
            let Solid::Rect(corners) = wall else {
                entity.triangles.push(TriangleListPrimitive {
                    pose: pose([0.0; 3], 0.0),
                    points: wall.prism(height as f32).into_iter().map(corner).collect(),
                    color: colour(GREY),
                    ..TriangleListPrimitive::default()
                });
                continue;
            };
            let [x, y, far_x, far_y] = corners.map(f64::from);
            entity.cubes.push(CubePrimitive {
                pose: pose([(x + far_x) / 2.0, (y + far_y) / 2.0, height / 2.0], 0.0),
                size: size([far_x - x, far_y - y, height]),
                color: colour(GREY),
            });
        }
        entity
    }
}

fn pose([x, y, z]: [f64; 3], heading: f64) -> Option<Pose> {
    let (sin, cos) = libm::sincos(heading / 2.0);
    let orientation = Some(Quaternion { x: 0.0, y: 0.0, z: sin, w: cos });
    Some(Pose { position: size([x, y, z]), orientation })
}

fn size([x, y, z]: [f64; 3]) -> Option<Vector3> {
    Some(Vector3 { x, y, z })
}

fn colour([r, g, b]: [f64; 3]) -> Option<Color> {
    Some(Color { r, g, b, a: 1.0 })
}
