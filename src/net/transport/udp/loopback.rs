//! Multicast loopback: whether the kernel delivers a group's datagrams to other processes of the same machine. It is
//! switched off if there are none, since it costs a robot a tenth of the time for sending.

use crate::time::{Span, Time};

/// Time for which another process of this machine counts as present after a datagram of it. With a key each process
/// sends at least four times a second.
const PRESENT: Span = Span::from_millis(1000);
/// Interval at which a datagram is looped back in any case, so that a process that has just started receives one. Two
/// processes that receive each other's datagrams keep the loopback on.
const PROBE: Span = Span::from_millis(1000);

/// Whether the kernel loops back one socket's multicast datagrams to other processes of the machine; on at first.
#[derive(Clone, Copy, Debug)]
pub(super) struct Loopback {
    /// Whether the loopback stays on, because the socket is on the loopback interface.
    always: bool,
    on: bool,
    heard: Option<Time>,
    probed: Option<Time>,
}

impl Loopback {
    /// Returns the state of a new socket. If `always` is set, for a socket on the loopback interface, the loopback
    /// stays on.
    pub(super) fn new(always: bool) -> Loopback {
        Loopback { always, on: true, heard: None, probed: None }
    }

    /// Records that a datagram of another process of this machine arrived at `now`.
    pub(super) fn heard(&mut self, now: Time) {
        self.heard = Some(now);
    }

    /// Returns whether the loopback is to be switched on (`true`) or off (`false`) before a datagram is sent at `now`;
    /// `None` if it stays as it is.
    pub(super) fn switch(&mut self, now: Time) -> Option<bool> {
        if self.always {
            return None;
        }
        let probe = self.probed.is_none_or(|probed| now.since(probed) >= PROBE);
        if probe {
            self.probed = Some(now);
        }
        // At first, another process is assumed to be present, until it has had the time to answer.
        let heard = *self.heard.get_or_insert(now);
        let on = probe || now.since(heard) < PRESENT;
        (std::mem::replace(&mut self.on, on) != on).then_some(on)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    #[test]
    fn one_datagram_a_second_is_looped_until_another_process_is_heard() {
        let mut own = Loopback::new(false);
        let mut looped = |at: u64| {
            own.switch(ms(at));
            own.on
        };
        assert!((0..1000).step_by(10).all(&mut looped), "at first all are");
        let later: Vec<u64> = (1000..4000).step_by(10).filter(|at| looped(*at)).collect();
        assert_eq!(later, [1000, 2000, 3000]);
        own.heard(ms(4005));
        assert_eq!([4010, 5000, 5010].map(|at| own.switch(ms(at))), [Some(true), None, None]);
        assert_eq!([5020, 5990, 6010].map(|at| own.switch(ms(at))), [Some(false), None, Some(true)]);
        assert_eq!([0, 3000].map(|at| Loopback::new(true).switch(ms(at))), [None; 2]);
    }

    #[test]
    fn two_that_start_at_any_time_hear_each_other_from_then_on() {
        for start in (0..3000).step_by(50) {
            let (mut early, mut late) = (Loopback::new(false), Loopback::new(false));
            for at in (0..start).step_by(50) {
                early.switch(ms(at));
            }
            for at in (start..start + 10_000).step_by(50) {
                for own in [&mut early, &mut late] {
                    own.switch(ms(at));
                }
                assert!(late.on, "the one that has just started, {} ms after", at - start);
                early.heard(ms(at));
                assert!(at == start || early.on, "the other, {} ms after", at - start);
                if early.on {
                    late.heard(ms(at));
                }
            }
        }
    }
}
