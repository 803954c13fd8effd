//! Tests of the air of many teams.

use super::*;
use crate::vector::StateError;
use murmurate::net::media::radio::Radio;

fn options(environments: usize, robots: usize) -> Options {
    Options {
        environments,
        robots,
        floats: 0,
        threads: 1,
        seed: 3,
        period_s: 0.05,
        spread_s: 0.0,
        hold_s: 1.0,
        range_m: None,
        loss: 0.0,
        bursts: None,
        delay_s: [0.0; 2],
        tail_s: 0.0,
        radio: None,
    }
}

/// Air with buffers of its own.
struct Kept {
    air: Air,
    heard: Vec<bool>,
    age_s: Vec<f32>,
    index: Vec<i32>,
    content: Vec<f32>,
}

const ALL: Given = Given { position: &[], sends: &[], bytes: &[200], to: &[], content: &[] };

impl Kept {
    fn new(options: Options) -> Kept {
        options.check().expect("the options of tests are sound");
        let edges = options.environments * options.robots * options.robots;
        let content = vec![0.0; edges * options.floats];
        Kept {
            heard: vec![false; edges],
            age_s: vec![0.0; edges],
            index: vec![-1; edges],
            content,
            air: Air::new(options),
        }
    }

    fn buffers(&mut self) -> (&mut Air, Buffers<'_>) {
        let Kept { air, heard, age_s, index, content } = self;
        (air, Buffers { heard, age_s, index, content })
    }

    fn step(&mut self, given: Given) {
        let (air, buffers) = self.buffers();
        air.step(given, buffers);
    }

    /// Steps, and returns all that is heard as bits, of the first `first` environments.
    fn rolled(&mut self, steps: usize, first: usize) -> Vec<u32> {
        let mut seen = Vec::new();
        let edges = first * self.air.options().robots.pow(2);
        for _ in 0..steps {
            self.step(ALL);
            seen.extend(self.age_s[..edges].iter().map(|age| age.to_bits()));
            seen.extend(self.index[..edges].iter().map(|index| *index as u32));
        }
        seen
    }
}

#[test]
fn without_delay_and_loss_each_robot_hears_the_last_message_of_all_others_and_not_its_own() {
    let mut kept = Kept::new(options(2, 3));
    for step in 0..4 {
        kept.step(ALL);
        for edge in 0..18 {
            let own = edge % 9 / 3 == edge % 3;
            assert_eq!((kept.heard[edge], kept.index[edge]), if own { (false, -1) } else { (true, step) });
            assert_eq!(kept.age_s[edge], if own { 0.0 } else { 0.05 });
        }
    }
}

#[test]
fn a_delayed_message_is_heard_at_the_end_of_the_step_in_which_it_arrives() {
    let mut kept = Kept::new(Options { delay_s: [0.12; 2], ..options(1, 2) });
    let heard: Vec<i32> = (0..5)
        .map(|_| {
            kept.step(ALL);
            kept.index[1]
        })
        .collect();
    assert_eq!(heard, [-1, -1, 0, 1, 2]);
    assert!((kept.age_s[1] - 0.15).abs() < 1e-6);
    kept.air.reset(|_| true);
    kept.step(ALL);
    assert_eq!(kept.index, [-1; 4], "nothing of before the reset arrives");
}

#[test]
fn a_message_is_held_from_its_arrival_on_and_its_age_counts_from_its_sending() {
    let mut kept = Kept::new(Options { delay_s: [0.31; 2], hold_s: 0.1, floats: 1, ..options(1, 2) });
    for step in 0..12 {
        kept.step(Given { sends: &[step == 0, false], content: &[7.0, 0.0], ..ALL });
        // It arrives within the seventh step, and is 0.09 s old at the end of the eighth.
        let heard = step == 6 || step == 7;
        assert_eq!((kept.heard[2], kept.content[2]), (heard, if heard { 7.0 } else { 0.0 }), "step {step}");
        assert!((kept.age_s[2] - if heard { 0.05 * (step + 1) as f32 } else { 0.0 }).abs() < 1e-6, "step {step}");
    }
}

#[test]
fn shares_and_delays_are_those_of_the_options() {
    let steps = 200;
    let mut kept = Kept::new(Options { loss: 0.3, ..options(200, 3) });
    let mut fresh = 0;
    for step in 0..steps {
        kept.step(ALL);
        fresh += kept.index.iter().filter(|index| **index == step).count();
    }
    let share = fresh as f64 / f64::from(steps * 200 * 6);
    assert!((share - 0.7).abs() < 0.005, "{share}");
    let tailed = Options { delay_s: [0.01, 0.03], tail_s: 0.05, period_s: 0.01, ..options(200, 2) };
    let mut kept = Kept::new(Options { hold_s: 1.0, ..tailed });
    // A single message each, by whose arrival the delay is known to a step.
    let mut sum_s = 0.0;
    let (send, wait) = ([true; 400], [false; 400]);
    kept.step(Given { sends: &send, ..ALL });
    let mut since = vec![f64::NAN; kept.heard.len()];
    for step in 1..100 {
        let newly = kept.heard.iter().zip(&mut since).filter(|(heard, since)| **heard && since.is_nan());
        newly.for_each(|(_, since)| *since = f64::from(step) * 0.01 - 0.005);
        kept.step(Given { sends: &wait, ..ALL });
    }
    since.iter().filter(|since| !since.is_nan()).for_each(|since| sum_s += since);
    let count = since.iter().filter(|since| !since.is_nan()).count();
    assert_eq!(count, 400);
    assert!((sum_s / count as f64 - 0.07).abs() < 0.008, "{}", sum_s / count as f64);
}

#[test]
fn bursts_have_their_share_of_the_time_and_their_length() {
    let bursts = Some(Bursts { share: 0.2, mean_s: 0.5 });
    let mut kept = Kept::new(Options { bursts, ..options(200, 2) });
    let (mut lost, mut begun, mut before) = (0, 0, vec![false; 800]);
    for step in 0..1000 {
        kept.step(ALL);
        for edge in (0..800).filter(|edge| edge % 4 == 1 || edge % 4 == 2) {
            let bad = kept.index[edge] != step;
            lost += usize::from(bad);
            begun += usize::from(bad && !before[edge]);
            before[edge] = bad;
        }
    }
    let (share, length_s) = (lost as f64 / 400_000.0, 0.05 * lost as f64 / begun as f64);
    assert!((share - 0.2).abs() < 0.01 && (length_s - 0.5).abs() < 0.03, "{share} {length_s}");
}

#[test]
fn distance_addressee_and_silence_decide_who_hears_and_contents_go_with_messages() {
    let mut kept = Kept::new(Options { range_m: Some(1.5), floats: 2, hold_s: 0.1, ..options(1, 3) });
    let position = [0.0, 0.0, 1.0, 0.0, 2.0, 0.0];
    let content = [1.0, 10.0, 2.0, 20.0, 3.0, 30.0];
    let given = Given { position: &position, content: &content, ..ALL };
    kept.step(given);
    assert_eq!(kept.heard, [false, true, false, true, false, true, false, true, false]);
    assert_eq!(kept.content[2..4], [2.0, 20.0], "robot 0 has what robot 1 said");
    assert_eq!(kept.content[4..6], [0.0; 2], "robot 2 is too far away");
    let said = [-1.0; 6];
    kept.step(Given { sends: &[false, true, false], to: &[-1, 2, -1], content: &said, ..given });
    assert_eq!((kept.index[1], kept.index[7]), (0, 1), "robot 1 has spoken to robot 2 alone");
    assert_eq!((kept.content[2], kept.content[14]), (2.0, -1.0));
    kept.step(Given { sends: &[false; 3], ..given });
    assert_eq!((kept.heard[1], kept.index[1], kept.content[2]), (false, -1, 0.0), "it is older than 0.1 s");
    assert!(kept.heard[7]);
}

#[test]
fn robots_that_share_a_channel_delay_and_lose_each_others_messages() {
    let radio = |radio: Radio| Options { radio: Some(radio), spread_s: 0.05, ..options(40, 8) };
    let mut quick = Kept::new(radio(Radio::default()));
    let mut slow = Kept::new(radio(Radio::preset("wifi-slow").expect("it is a preset")));
    let fresh = |kept: &mut Kept| {
        let mut fresh = 0;
        for step in 0..100 {
            kept.step(Given { bytes: &[1000], ..ALL });
            fresh += kept.index.iter().filter(|index| **index >= step - 1).count();
        }
        fresh as f64 / (100 * 40 * 56) as f64
    };
    // A datagram of 1000 bytes takes 8.6 ms twice at 1 Mbit/s, eight of them 137 ms in each step of 50 ms.
    let (quick, slow) = (fresh(&mut quick), fresh(&mut slow));
    assert!(quick < 0.9 && slow < 0.3 && slow > 0.0, "{quick} {slow}");
    let mut small = Kept::new(radio(Radio { basic_rate: Radio::default().ack_rate, ..Radio::default() }));
    small.step(ALL);
    (0..20).for_each(|_| small.step(ALL));
    let heard = small.heard.iter().filter(|heard| **heard).count();
    assert_eq!(heard, 40 * 56, "a channel with room carries all");
}

#[test]
fn data_do_not_depend_on_threads_or_other_environments_and_states_continue_to_the_bit() {
    let full = |environments, threads| Options {
        threads,
        spread_s: 0.03,
        loss: 0.2,
        bursts: Some(Bursts { share: 0.1, mean_s: 0.2 }),
        delay_s: [0.0, 0.1],
        tail_s: 0.01,
        radio: Some(Radio::default()),
        ..options(environments, 4)
    };
    let alone = Kept::new(full(3, 1)).rolled(30, 3);
    assert_eq!(alone, Kept::new(full(80, 1)).rolled(30, 3));
    assert_eq!(alone, Kept::new(full(80, 3)).rolled(30, 3));
    let mut first = Kept::new(full(5, 1));
    first.rolled(17, 5);
    let state = first.air.state();
    let mut other = Kept::new(Options { seed: 99, threads: 2, ..full(5, 1) });
    other.air.set_state(&state).expect("it is a state of such teams");
    let (air, buffers) = other.buffers();
    air.look(buffers);
    assert_eq!((&first.index, &first.age_s), (&other.index, &other.age_s));
    first.air.reset(|at| at == 1);
    other.air.reset(|at| at == 1);
    assert_eq!(first.rolled(20, 5), other.rolled(20, 5));
    let other_options =
        Kept::new(Options { loss: 0.1, ..full(5, 1) }).air.set_state(&state).expect_err("it is of others");
    assert!(other_options.to_string().contains("'loss' is 0.2 there and 0.1 here"), "{other_options}");
    let short = Air { rows: first.air.rows[..4].to_vec(), ..first.air.clone() }.state();
    assert!(matches!(other.air.set_state(&short), Err(StateError::Damaged(why)) if why.contains("do not fit")));
    for at in [0, 40, state.len() - 1] {
        let mut bad = state.clone();
        bad[at] ^= 1;
        assert!(matches!(other.air.set_state(&bad), Err(StateError::Damaged(_))), "byte {at}");
    }
    assert!(matches!(options_of(&state[..7]), Err(StateError::Damaged(_))));
}

#[test]
fn wrong_options_are_refused_by_name() {
    let refused = |options: Options| options.check().expect_err("it is wrong").to_string();
    assert!(refused(Options { loss: 1.5, ..options(1, 2) }).starts_with("loss"));
    assert!(refused(Options { hold_s: 0.01, ..options(1, 2) }).starts_with("hold_s"));
    assert!(refused(Options { delay_s: [0.2, 0.1], ..options(1, 2) }).starts_with("delay_s"));
    assert!(refused(Options { spread_s: 0.06, ..options(1, 2) }).starts_with("spread_s"));
    assert!(refused(Options { robots: 0, ..options(1, 2) }).starts_with("num_robots"));
    let radio = Some(Radio { queue: 0, ..Radio::default() });
    assert!(refused(Options { radio, ..options(1, 2) }).starts_with("radio.queue"));
    let bursts = Some(Bursts { share: 0.9, mean_s: 0.05 });
    assert!(refused(Options { bursts, ..options(1, 2) }).starts_with("burst_share"));
}
