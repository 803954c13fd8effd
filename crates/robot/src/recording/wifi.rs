//! Samples of this host's Wi-Fi cards, once a second while a record is written, for the topic `/wifi` of the record. A
//! thread of its own asks the kernel.

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel};
use std::thread;
use std::time::Duration;

use data_encoding::HEXLOWER;
use serde_json::{Value, json};

use murmurate_wifi::{Card, Peer};

/// Time between two samples.
const PERIOD: Duration = Duration::from_secs(1);
/// Number of samples that wait for the next turn of the event loop; further ones are left out.
const MOST: usize = 16;

/// Running sampler. It ends when this is dropped.
pub struct Samples {
    samples: Receiver<Value>,
    _running: Sender<()>,
}

impl Samples {
    /// Starts to sample those of the interfaces that are Wi-Fi cards; returns `None` if there are none. `look` returns
    /// the card of an interface, `None` if it is none, or why the kernel does not tell.
    pub fn start(
        mut interfaces: Vec<String>,
        look: impl Fn(&str) -> std::io::Result<Option<Card>> + Send + 'static,
    ) -> Option<Samples> {
        interfaces.sort();
        interfaces.dedup();
        // An interface of which the kernel tells nothing now may be one that has not come up yet.
        interfaces.retain(|interface| !matches!(look(interface), Ok(None)));
        if interfaces.is_empty() {
            return None;
        }
        let (tell, samples) = sync_channel(MOST);
        let (running, over) = channel();
        let sample = move || run(&interfaces, &look, &tell, &over);
        if let Err(error) = thread::Builder::new().name("wifi".to_owned()).spawn(sample) {
            tracing::warn!("the record has no samples of Wi-Fi: {error}");
            return None;
        }
        Some(Samples { samples, _running: running })
    }

    /// Calls `each` with each sample that has come since the last call.
    pub fn take(&self, each: impl FnMut(Value)) {
        self.samples.try_iter().for_each(each);
    }
}

fn run(
    interfaces: &[String],
    look: &impl Fn(&str) -> std::io::Result<Option<Card>>,
    tell: &SyncSender<Value>,
    over: &Receiver<()>,
) {
    loop {
        for interface in interfaces {
            // One that is away for now is looked for again in the next second.
            if let Ok(Some(card)) = look(interface) {
                tell.try_send(sample(interface, &card)).ok();
            }
        }
        if over.recv_timeout(PERIOD) != Err(RecvTimeoutError::Timeout) {
            return;
        }
    }
}

/// Returns the content of a message of the topic `/wifi` about the card of an interface.
fn sample(interface: &str, card: &Card) -> Value {
    json!({
        "interface": interface,
        "mode": card.mode.to_string(),
        "frequency_mhz": card.frequency_mhz,
        "power_save": card.power_save,
        "active_ms": card.load.map(|load| load.active_ms),
        "busy_ms": card.load.map(|load| load.busy_ms),
        "peers": card.peers.iter().map(peer).collect::<Vec<Value>>(),
    })
}

fn peer(peer: &Peer) -> Value {
    let octets: Vec<String> = peer.address.iter().map(|octet| HEXLOWER.encode(&[*octet])).collect();
    json!({
        "address": octets.join(":"),
        "signal_dbm": peer.signal_dbm,
        "sent": peer.sent,
        "retries": peer.retries,
        "failed": peer.failed,
        "rate_mbit_s": peer.rate_mbit_s,
        "silent_ms": peer.silent_ms,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate_wifi::{Load, Mode};

    fn card() -> Card {
        let address = [2, 0, 0, 0, 1, 0xab];
        Card {
            mode: Mode::AdHoc,
            network: Some("team".to_owned()),
            frequency_mhz: Some(2412),
            country: None,
            power_save: Some(false),
            forwards: None,
            modes: Vec::new(),
            combinations: Vec::new(),
            load: Some(Load { active_ms: 2000, busy_ms: 500 }),
            peers: vec![Peer { address, signal_dbm: Some(-52), sent: 7, retries: 2, ..Peer::default() }],
        }
    }

    #[test]
    fn cards_alone_are_sampled_and_each_sample_has_load_and_peers() {
        let look = |interface: &str| Ok((interface == "wlan0").then(card));
        let names = |all: &[&str]| all.iter().map(|name| (*name).to_owned()).collect::<Vec<String>>();
        assert!(Samples::start(names(&["eth0", "lo"]), look).is_none());
        let samples = Samples::start(names(&["wlan0", "eth0", "wlan0"]), look).expect("one is a card");
        let first = samples.samples.recv_timeout(Duration::from_secs(10)).expect("it is sampled at once");
        assert_eq!((&first["interface"], &first["mode"]), (&json!("wlan0"), &json!("IBSS")));
        assert_eq!((&first["busy_ms"], &first["active_ms"]), (&json!(500), &json!(2000)));
        let peer = &first["peers"][0];
        assert_eq!((&peer["address"], &peer["signal_dbm"]), (&json!("02:00:00:00:01:ab"), &json!(-52)));
        assert_eq!((&peer["retries"], &peer["rate_mbit_s"]), (&json!(2), &Value::Null));
    }
}
