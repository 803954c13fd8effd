//! Radio channel with space in the animations: which robots only sense each other.

use murmurate::messages::geometry::Vec2;
use murmurate::net::media::radio::{Channel, Radio};
use murmurate::random::Seed;

use super::scene::Scene;

/// Returns for each frame of a scene the pairs of robots, smaller id first, of which none reads the other and one
/// senses it, by the paths alone. Empty without a channel with space.
pub fn sensed(scene: &Scene) -> Vec<Vec<(usize, usize)>> {
    let Some(radio) = scene.stage.radio else { return Vec::new() };
    let mut channel = channel(radio, scene);
    scene.frames.iter().map(|frame| sensed_at(&mut channel, &frame.at)).collect()
}

/// Returns an idle channel with a station for each robot, and the walls of the scene.
fn channel(radio: &Radio, scene: &Scene) -> Channel<()> {
    // Nothing is sent, so nothing is drawn.
    let mut channel = Channel::new(radio.clone(), scene.robots() as u16, &Seed::of_run(0));
    channel.wall_in(scene.stage.arena.keep_outs.iter().map(|block| block.solid().rim()).collect());
    channel
}

fn sensed_at(channel: &mut Channel<()>, places: &[Vec2]) -> Vec<(usize, usize)> {
    (0..).zip(places).for_each(|(station, at)| channel.place(station, *at));
    let mut pairs = Vec::new();
    for one in 0..places.len() {
        let later = channel.reached(one as u16).into_iter().filter(|to| usize::from(to.station) > one && !to.reads);
        pairs.extend(later.map(|to| (one, usize::from(to.station))));
    }
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::net::media::radio::Topology;

    #[test]
    fn robots_that_sense_and_do_not_read_each_other_are_pairs() {
        let radio = Radio { channel: Topology::AdHoc, range_m: Some(3.0), sense_m: Some(6.0), ..Radio::default() };
        let mut channel = Channel::new(radio, 4, &Seed::of_run(0));
        let places = [0.0, 2.0, 5.5, 20.0].map(|x| Vec2::new(x, 0.0));
        assert_eq!(sensed_at(&mut channel, &places), [(0, 2), (1, 2)]);
    }
}
