//! Any parts of messages, in any order and at any time: what a host joins of them has the declared size.
#![no_main]

use libfuzzer_sys::fuzz_target;
use murmurate::messages::geometry::Motion;
use murmurate::messages::ids::{HostId, LinkId, RobotId};
use murmurate::messages::wire::{Encoding, Features, Form, Latent, Missing, Part, Phase, Piece, Round, Wire};
use murmurate::net::protocol::parts::{Inbox, Settings};
use murmurate::time::{Span, Time};

/// Size of a message: five parts of at most 512 bytes as f16, others otherwise.
const FLOATS: u16 = 1100;

fuzz_target!(|bytes: &[u8]| {
    let Some((&[which], rest)) = bytes.split_first_chunk::<1>() else { return };
    let encoding = Encoding::ALL[usize::from(which % 4)];
    let missing = [Missing::Whole, Missing::Last, Missing::Zero][usize::from(which / 4 % 3)];
    let form = Form { encoding, missing };
    let settings = Settings { form, floats: FLOATS.into(), period: Span::from_millis(50), policy: 1 };
    let (mut inbox, mut now) = (Inbox::new(settings), Time::ZERO);
    for event in rest.as_chunks::<8>().0 {
        let [ms, robot, message, index, of, length, incarnation, fill] = *event;
        now += Span::from_millis(ms.into());
        let (mut whole, mut asks) = (Vec::new(), Vec::new());
        let part = Part {
            message: u16::from(message),
            index,
            of,
            floats: if fill == 0 { FLOATS + 1 } else { FLOATS },
            encoding: if fill == 1 { 3 } else { encoding.code() },
            exponent: fill,
            policy: 1 + u32::from(fill == 2),
            bytes: Piece(vec![fill; 4 * usize::from(length)].into()),
        };
        let robot = RobotId(u16::from(robot % 3));
        let latent = Latent {
            robot,
            round: Round::default(),
            phase: Phase::Running,
            motion: Motion::default(),
            features: Features(Vec::new().into()),
            part: Some(part),
        };
        // A host checks what it decodes before it looks at it.
        if Wire::Latent(latent.clone()).check().is_ok() {
            let from = ((LinkId(0), HostId(robot.0)), u32::from(incarnation % 2));
            let _ = inbox.take(now, from, latent, f64::from(fill) / 255.0, &mut whole);
        }
        inbox.wake(now, &mut whole, &mut asks);
        for message in whole {
            assert!(message.part.is_none() && message.features.0.len() == usize::from(FLOATS));
        }
        assert!(asks.iter().all(|(_, lacking)| lacking.parts != 0));
        assert!(inbox.due().is_none_or(|due| due > now), "it has done what was due");
    }
});
