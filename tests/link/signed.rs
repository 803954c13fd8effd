//! Messages that are signed where members have keys of their own: what is believed, and what recordings and lies cost.

use crate::rig::{LINK, Rig, config, multicast};
use murmurate::actors::network::Config;
use murmurate::messages::geometry::{Task, Vec2};
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::latch::Latch;
use murmurate::messages::wire::{Mode, Phase, Release, Round, Stop, Wire};
use murmurate::net::protocol::key::Key;
use murmurate::net::protocol::member::public;
use murmurate::net::protocol::reliability::Reliabilities;
use murmurate::net::protocol::router::{Audience, Route, Router};
use murmurate::net::protocol::signatures::Signatures;
use murmurate::time::{Span, Time};

const OPERATOR: HostId = HostId::operator(1);

fn secret(member: u16) -> [u8; 32] {
    *blake3::hash(&member.to_le_bytes()).as_bytes()
}

/// Returns a member that signs, or that does not.
fn member(host: u16, incarnation: u32, signs: bool) -> Config {
    let members = [0, 1, OPERATOR.0].map(|member| (HostId(member), public(&secret(member)))).into();
    let signatures = Signatures::new(signs.then(|| secret(host)), &members).expect("public keys");
    let key = Some(Key::new([42; 32]).with_signatures(signatures));
    let router = Router::new(3, |_, _| Route { local: host != OPERATOR.0, leaves: Some((LINK, Audience::All)) });
    Config { router, ..config(host, 3, incarnation, key, multicast(Reliabilities::new())) }
}

/// Returns two hosts and an operator that have met.
fn team() -> Rig {
    let mut rig = Rig::new([member(0, 1, true), member(1, 2, true), member(OPERATOR.0, 3, true)]);
    rig.meet();
    rig
}

/// Returns what host 0 has heard, and forgets it.
fn heard(rig: &mut Rig) -> Vec<Wire> {
    // Soft state waits for data.
    rig.run_ms(150);
    std::mem::take(&mut rig.delivered[0]).into_iter().map(|(_, message)| message).collect()
}

fn stop(by: HostId, number: u64) -> Wire {
    Wire::Stop(Stop { by, latch: Latch::engaged(number) })
}

fn mode(episode: u32) -> Wire {
    let (round, phase, latch) = (Round { term: 1, episode }, Phase::Running, Latch::default());
    let tasks = [Task { start: Vec2::zeros(), goal: Vec2::new(1.0, 2.0) }; 3].into();
    Wire::Mode(Mode { round, repeat: 0, phase, first: RobotId(0), tasks, latch })
}

#[test]
fn a_stop_and_an_instruction_are_heard_of_who_signs_them_in_its_own_name_alone() {
    let mut rig = team();
    let sound = [stop(HostId(1), 1), mode(1)];
    sound.iter().for_each(|message| rig.publish(1, message.clone()));
    assert_eq!(heard(&mut rig), sound);
    rig.publish(1, stop(OPERATOR, 3));
    assert!(heard(&mut rig).is_empty() && rig.counted(0).unsigned == 1, "{:?}", rig.counted(0));
    // The same host without its key to sign with.
    rig.restart(1, member(1, 7, false));
    rig.run_ms(1000);
    rig.meet();
    rig.publish(1, stop(HostId(1), 5));
    rig.publish(1, mode(2));
    assert!(heard(&mut rig).is_empty() && rig.counted(0).unsigned == 3, "{:?}", rig.counted(0));
}

#[test]
fn a_stop_is_heard_at_once_beside_recordings_of_all_that_its_sender_has_signed() {
    let mut rig = team();
    let mut recorded = Vec::new();
    for number in [1, 4, 9] {
        rig.publish(2, stop(OPERATOR, number));
        recorded.push(rig.last_data(2));
        assert_eq!(heard(&mut rig), [stop(OPERATOR, number)]);
    }
    let end = rig.now + Span::from_secs(2.0);
    while rig.now < end {
        (0..5).flat_map(|_| &recorded).for_each(|frame| rig.arrive(0, frame));
        rig.run_ms(1);
    }
    assert!(heard(&mut rig).is_empty(), "each of them counts once");
    let asked = rig.now;
    rig.publish(2, stop(OPERATOR, 20));
    rig.run_ms(2);
    let at = |(at, message): &(Time, Wire)| (*message == stop(OPERATOR, 20)).then_some(*at);
    let heard = rig.delivered[0].iter().find_map(at).expect("it is heard");
    assert!(heard.since(asked) <= Span::from_millis(1), "{:?}", heard.since(asked));
    let counts = rig.counted(0);
    assert!(counts.unsigned == 0 && counts.duplicate + counts.late >= 29_000, "{counts:?}");
}

#[test]
fn a_run_that_was_silent_and_is_accepted_again_has_said_its_stops_already() {
    let mut rig = team();
    rig.publish(2, stop(OPERATOR, 4));
    let recorded = rig.last_data(2);
    assert_eq!(heard(&mut rig), [stop(OPERATOR, 4)]);
    rig.down = Some(2);
    rig.run_ms(17_000);
    rig.down = None;
    rig.run_ms(1000);
    rig.meet();
    (0..10).for_each(|_| rig.arrive(0, &recorded));
    assert!(heard(&mut rig).is_empty(), "a recording");
    rig.publish(2, stop(OPERATOR, 6));
    assert_eq!(heard(&mut rig), [stop(OPERATOR, 6)]);
}

#[test]
fn a_re_arm_is_believed_of_operators_alone_and_for_this_run_of_a_host() {
    let mut rig = team();
    let rearm = Stop { by: OPERATOR, latch: Latch::held(4) };
    rig.publish(2, Wire::Stop(rearm));
    rig.run_ms(10);
    let heard = |rig: &Rig| -> Vec<Release> {
        let release = |message: &Wire| if let Wire::Release(release) = message { Some(release.clone()) } else { None };
        rig.delivered[0].iter().filter_map(|(_, message)| release(message)).collect()
    };
    let [release] = &heard(&rig)[..] else { panic!("it is heard once") };
    assert_eq!((release.stop(), &release.hosts[..]), (rearm, &[(HostId(0), 1), (HostId(1), 2)][..]));
    // An unchanged copy that a member sends is believed; an altered one is not.
    let mut altered = release.clone();
    altered.latch = Latch::clear(5);
    let lies = [Wire::Release(altered), Wire::Stop(Stop { by: OPERATOR, latch: Latch::clear(5) })];
    let release = release.clone();
    rig.delivered[0].clear();
    rig.publish(1, Wire::Release(release.clone()));
    rig.run_ms(10);
    assert_eq!(heard(&rig), std::slice::from_ref(&release));
    rig.delivered[0].clear();
    lies.iter().for_each(|lie| rig.publish(1, lie.clone()));
    rig.run_ms(10);
    assert!(rig.delivered[0].is_empty() && rig.counted(0).unsigned == 2, "{:?}", rig.counted(0));
    // Another run of the host believes no recording of it.
    rig.restart(0, member(0, 9, true));
    rig.run_ms(1000);
    rig.meet();
    rig.delivered[0].clear();
    rig.publish(1, Wire::Release(release));
    rig.run_ms(10);
    assert!(heard(&rig).is_empty() && rig.counted(0).unsigned == 1, "{:?}", rig.counted(0));
}
