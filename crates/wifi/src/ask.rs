//! The questions to the kernel about a Wi-Fi card, by nl80211.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;

use futures_util::stream::{StreamExt, TryStream, TryStreamExt};
use tokio::runtime::Builder;
use wl_nl80211::packet_core::{NLM_F_REQUEST, NetlinkMessage, NetlinkPayload, Nla, NlaBuffer, NlasIterator};
use wl_nl80211::packet_generic::GenlMessage;
use wl_nl80211::{
    Nl80211Attr, Nl80211Command, Nl80211Error, Nl80211Handle, Nl80211IfMode, Nl80211IfaceComb,
    Nl80211IfaceCombAttribute, Nl80211IfaceCombLimitAttribute, Nl80211InterfaceType, Nl80211Message, Nl80211RateInfo,
    Nl80211StationInfo, Nl80211Survey, Nl80211SurveyInfo,
};

use crate::card::{Card, Combination, Load, Mode, Peer};

/// Attributes of the kernel (`linux/nl80211.h`) that have no type of their own: the state of power saving, the country
/// of its rules, the configuration of a mesh, and in it whether frames of others are forwarded.
const PS_STATE: u16 = 93;
const REG_ALPHA2: u16 = 33;
const MESH_CONFIG: u16 = 35;
const MESH_FORWARDING: u16 = 19;

/// Returns the Wi-Fi card of an interface; `None` if the interface is none. An error says what the kernel did not
/// answer.
pub fn look(interface: &str) -> io::Result<Option<Card>> {
    if !Path::new("/sys/class/net").join(interface).join("phy80211").exists() {
        return Ok(None);
    }
    let index = nix::net::if_::if_nametoindex(interface)?;
    let runtime = Builder::new_current_thread().enable_io().build()?;
    runtime.block_on(ask(index)).map(Some).map_err(io::Error::other)
}

async fn ask(index: u32) -> Result<Card, Nl80211Error> {
    let (connection, mut handle, _) =
        wl_nl80211::new_connection().map_err(|error| Nl80211Error::RequestFailed(error.to_string()))?;
    let connection = tokio::spawn(connection);
    let mut card = Card {
        mode: Mode::Other,
        network: None,
        frequency_mhz: None,
        power_save: None,
        country: None,
        forwards: None,
        modes: Vec::new(),
        combinations: Vec::new(),
        load: None,
        peers: Vec::new(),
    };
    let interface = attributes(handle.interface().get(vec![Nl80211Attr::IfIndex(index)]).execute().await).await?;
    for attribute in interface.into_iter().flatten() {
        match attribute {
            Nl80211Attr::IfType(of) => card.mode = mode(of),
            Nl80211Attr::Ssid(name) => card.network = Some(name),
            Nl80211Attr::WiphyFreq(mhz) => card.frequency_mhz = Some(mhz),
            _ => {}
        }
    }
    let wiphy = attributes(handle.wireless_physic().get().if_index(index).execute().await).await?;
    for attribute in wiphy.into_iter().flatten() {
        match attribute {
            Nl80211Attr::SupportedIftypes(all) => card.modes.extend(all.into_iter().map(mode_of)),
            Nl80211Attr::InterfaceCombination(all) => card.combinations.extend(all.iter().map(combination)),
            _ => {}
        }
    }
    card.modes.sort_unstable();
    card.modes.dedup();
    card.power_save = question(&mut handle, Nl80211Command::GetPowerSave, index).await.and_then(|all| {
        let state = all.iter().find(|attribute| attribute.kind() == PS_STATE).map(value)?;
        state.first().map(|state| *state != 0)
    });
    card.country = question(&mut handle, Nl80211Command::GetReg, index).await.and_then(|all| {
        let letters = all.iter().find(|attribute| attribute.kind() == REG_ALPHA2).map(value)?;
        String::from_utf8(letters).ok().map(|letters| letters.trim_end_matches('\0').to_owned())
    });
    if card.mode == Mode::MeshPoint {
        let config = question(&mut handle, Nl80211Command::GetMeshConfig, index).await.unwrap_or_default();
        card.forwards = config.iter().find(|attribute| attribute.kind() == MESH_CONFIG).and_then(forwarding);
    }
    // A driver that does not measure its channel, or knows no stations, answers nothing or an error.
    let survey = Nl80211Survey::new(index).build();
    let survey = attributes(handle.survey().dump(survey).execute().await).await.unwrap_or_default();
    card.load = survey.into_iter().flatten().find_map(|attribute| match attribute {
        Nl80211Attr::SurveyInfo(info) => load(&info, card.frequency_mhz),
        _ => None,
    });
    let stations = attributes(handle.station().dump(index).execute().await).await.unwrap_or_default();
    let peers: BTreeMap<[u8; 6], Peer> =
        stations.into_iter().filter_map(peer).map(|peer| (peer.address, peer)).collect();
    card.peers = peers.into_values().collect();
    connection.abort();
    Ok(card)
}

/// Returns the attributes of each message of an answer.
async fn attributes(
    answer: impl TryStream<Ok = GenlMessage<Nl80211Message>, Error = Nl80211Error>,
) -> Result<Vec<Vec<Nl80211Attr>>, Nl80211Error> {
    answer.map_ok(|message| message.payload.attributes).try_collect().await
}

/// Returns the attributes of the answer to a question about one interface; `None` if the driver does not answer it.
async fn question(handle: &mut Nl80211Handle, cmd: Nl80211Command, index: u32) -> Option<Vec<Nl80211Attr>> {
    let message = Nl80211Message { cmd, attributes: vec![Nl80211Attr::IfIndex(index)] };
    let mut message = NetlinkMessage::from(GenlMessage::from_payload(message));
    message.header.flags = NLM_F_REQUEST;
    let mut answer = handle.request(message).await.ok()?;
    match answer.next().await?.ok()?.payload {
        NetlinkPayload::InnerMessage(message) => Some(message.payload.attributes),
        _ => None,
    }
}

fn value(attribute: &Nl80211Attr) -> Vec<u8> {
    let mut bytes = vec![0; attribute.value_len()];
    attribute.emit_value(&mut bytes);
    bytes
}

fn forwarding(config: &Nl80211Attr) -> Option<bool> {
    let bytes = value(config);
    let mut fields = NlasIterator::new(bytes.as_slice()).filter_map(Result::ok);
    let field = fields.find(|field: &NlaBuffer<&[u8]>| field.kind() == MESH_FORWARDING)?;
    field.value().first().map(|forwards| *forwards != 0)
}

fn mode(of: Nl80211InterfaceType) -> Mode {
    match of {
        Nl80211InterfaceType::Adhoc => Mode::AdHoc,
        Nl80211InterfaceType::Station => Mode::Station,
        Nl80211InterfaceType::Ap => Mode::AccessPoint,
        Nl80211InterfaceType::MeshPoint => Mode::MeshPoint,
        Nl80211InterfaceType::Ocb => Mode::Outside,
        Nl80211InterfaceType::Monitor => Mode::Monitor,
        _ => Mode::Other,
    }
}

fn mode_of(supported: Nl80211IfMode) -> Mode {
    match supported {
        Nl80211IfMode::Adhoc => Mode::AdHoc,
        Nl80211IfMode::Station => Mode::Station,
        Nl80211IfMode::Ap => Mode::AccessPoint,
        Nl80211IfMode::MeshPoint => Mode::MeshPoint,
        Nl80211IfMode::Ocb => Mode::Outside,
        Nl80211IfMode::Monitor => Mode::Monitor,
        _ => Mode::Other,
    }
}

fn combination(of: &Nl80211IfaceComb) -> Combination {
    let mut combination = Combination { limits: Vec::new(), most: 0, channels: 0 };
    for attribute in &of.attributes {
        match attribute {
            Nl80211IfaceCombAttribute::Maxnum(most) => combination.most = *most,
            Nl80211IfaceCombAttribute::NumChannels(channels) => combination.channels = *channels,
            Nl80211IfaceCombAttribute::Limits(limits) => {
                combination.limits.extend(limits.iter().map(|limit| {
                    let (mut most, mut modes) = (0, Vec::new());
                    for attribute in &limit.attributes {
                        match attribute {
                            Nl80211IfaceCombLimitAttribute::Max(number) => most = *number,
                            Nl80211IfaceCombLimitAttribute::Iftypes(types) => {
                                modes.extend(types.iter().copied().map(mode));
                            }
                            _ => {}
                        }
                    }
                    (most, modes)
                }));
            }
            _ => {}
        }
    }
    combination
}

/// Returns the load of the channel that a survey is of, if it is that of the card.
fn load(info: &[Nl80211SurveyInfo], frequency_mhz: Option<u32>) -> Option<Load> {
    let number = |pick: fn(&Nl80211SurveyInfo) -> Option<u64>| info.iter().find_map(pick);
    let mhz = number(|one| if let Nl80211SurveyInfo::Frequency(mhz) = one { Some(u64::from(*mhz)) } else { None })?;
    let active_ms = number(|one| if let Nl80211SurveyInfo::ActiveTime(ms) = one { Some(*ms) } else { None })?;
    let busy_ms = number(|one| if let Nl80211SurveyInfo::BusyTime(ms) = one { Some(*ms) } else { None })?;
    (Some(mhz) == frequency_mhz.map(u64::from)).then_some(Load { active_ms, busy_ms })
}

fn peer(attributes: Vec<Nl80211Attr>) -> Option<Peer> {
    let mut peer = Peer::default();
    let mut known = false;
    for attribute in attributes {
        match attribute {
            Nl80211Attr::Mac(address) => (peer.address, known) = (address, true),
            Nl80211Attr::StationInfo(info) => info.iter().for_each(|info| note(&mut peer, info)),
            _ => {}
        }
    }
    known.then_some(peer)
}

fn note(peer: &mut Peer, info: &Nl80211StationInfo) {
    match info {
        Nl80211StationInfo::SignalAvg(dbm) => peer.signal_dbm = Some(*dbm),
        Nl80211StationInfo::Signal(dbm) => peer.signal_dbm = peer.signal_dbm.or(Some(*dbm)),
        Nl80211StationInfo::TxPackets(count) => peer.sent = *count,
        Nl80211StationInfo::TxRetries(count) => peer.retries = *count,
        Nl80211StationInfo::TxFailed(count) => peer.failed = *count,
        Nl80211StationInfo::InactiveTime(ms) => peer.silent_ms = Some(*ms),
        Nl80211StationInfo::TxBitrate(info) => {
            peer.rate_mbit_s = info.iter().find_map(|info| match info {
                Nl80211RateInfo::Bitrate32(rate) => Some(f64::from(*rate) / 10.0),
                Nl80211RateInfo::Bitrate(rate) => Some(f64::from(*rate) / 10.0),
                _ => None,
            });
        }
        _ => {}
    }
}
