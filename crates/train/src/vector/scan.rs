//! Scans of the robots of vectorised environments: the sense `lidar` of runs, without its schedule.

use super::Chunk;

impl Chunk {
    /// Writes the distances along the rays of each robot of an environment \[m\], the range for no echo: as a policy
    /// takes them with `miss = "range"`, in the frame `policy` if the rays go all around, otherwise in the frame
    /// `body`. Without a lidar it does nothing.
    pub(super) fn scan(&mut self, row: usize, to: &mut [f32]) {
        let Chunk { environments, streams, scanner: Some(scanner), .. } = self else { return };
        let (first, team) = (environments.teams[row].first, &environments.position[environments.teams[row].range()]);
        let (arena, sweep) = (&*environments.arena_now(row), *scanner.sweep());
        for ((robot, centre), to) in team.iter().enumerate().zip(to.chunks_exact_mut(scanner.rays())) {
            let heading = environments.heading(first + robot);
            let ahead = if sweep.around { environments.frame[first + robot].turn_angle(0.0) } else { heading };
            let others = team.iter().enumerate().filter(|(other, _)| *other != robot).map(|(_, other)| *other);
            scanner.scan(arena, (*centre, heading, ahead), others, to);
            scanner.disturb(&mut streams[row], to);
        }
        to.iter_mut().for_each(|distance| *distance = distance.min(sweep.range_m));
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::{FRAC_PI_2, PI};

    use murmurate::chassis::DriveKind;
    use murmurate::messages::geometry::Vec2;
    use murmurate::observation::PolicyFrame;
    use murmurate::scenario::{Settings, TaskFile};
    use murmurate::senses::Settings as SenseSettings;

    use super::super::tests::{Memory, options};
    use super::super::{Content, Lidar, Options, VectorEnvironment};

    /// Lidar of four rays, the first one behind, with more settings.
    fn lidar(more: &str) -> Option<Lidar> {
        let table = format!("rays = 4\nrange_m = 1.5\n{more}").parse().expect("it is TOML");
        Some(Lidar { name: "eyes".to_owned(), settings: SenseSettings { kind: "lidar".to_owned(), table } })
    }

    fn begun(options: Options) -> (VectorEnvironment, Memory) {
        let environments = VectorEnvironment::new(options);
        let memory = Memory::of(environments.options().environments, environments.lengths());
        (environments, memory)
    }

    /// Distance from a place in a direction to walls, rails and other robots, by small steps, at most 1.5 m.
    fn walked(environment: &VectorEnvironment, row: usize, robot: usize, angle: f32) -> f32 {
        let (all, row) = environment.place(row);
        let (arena, range) = (all.arena(row), all.teams[row].range());
        let solid = |point: Vec2| {
            let near = |other: usize| (all.position[other] - point).norm() <= arena.hull_m();
            let block = arena.keep_outs.iter().any(|block| block.distance(point) == 0.0);
            let outside = (point.abs() - arena.half_extent).max() >= arena.hull_m();
            block || outside || range.clone().any(|other| other != robot && near(other))
        };
        let at = |step: u32| all.position[robot] + Vec2::new(angle.cos(), angle.sin()) * (step as f32 * 1e-3);
        (0..1500).find(|step| solid(at(*step))).map_or(1.5, |step| step as f32 * 1e-3)
    }

    #[test]
    fn scans_are_what_is_about_each_robot_in_the_frame_of_its_policy() {
        let (mut environments, mut memory) = begun(Options { lidar: lidar(""), ..options(40, 2, Content::Nothing) });
        environments.begin(memory.buffers());
        let (mut turned, mut near) = (0, 0);
        for _ in 0..8 {
            let actions: Vec<f32> = memory.floats[0].chunks_exact(6).flat_map(|of| [of[0], of[1]]).collect();
            environments.step(&actions, &[], memory.buffers());
            for (at, scan) in memory.floats[5].chunks_exact(4).enumerate() {
                let (all, place) = environments.place(at / 3);
                let robot = all.teams[place].first + at % 3;
                let frame = all.scenario(place).frame(&all.tasks[robot]);
                turned += usize::from(frame == PolicyFrame::HalfTurn);
                for (ray, distance) in scan.iter().enumerate() {
                    let angle = frame.turn_angle(0.0) - PI + FRAC_PI_2 * ray as f32;
                    let walked = walked(&environments, at / 3, robot, angle);
                    near += usize::from(*distance < 1.5);
                    assert!((walked - distance).abs() < 3e-3, "robot {at}, ray {ray}: {walked} and {distance}");
                }
            }
            assert_eq!(memory.floats[5], memory.floats[6], "no episode has ended");
        }
        assert!(turned > 100 && near > 100, "{turned} {near}");
    }

    #[test]
    fn scans_are_of_the_obstacles_of_each_episode() {
        let text = include_str!("../../../../examples/tasks/navigation.toml");
        let task = TaskFile::read(text).expect("it is sound");
        let scenario = task.scenario(&Settings::of(3)).expect("it is sound");
        let (mut environments, mut memory) =
            begun(Options { scenario, lidar: lidar(""), ..options(40, 2, Content::Nothing) });
        environments.begin(memory.buffers());
        let mut near = 0;
        // An episode has 20 steps, so each environment has obstacles of two episodes.
        for _ in 0..30 {
            environments.step(&[0.2; 40 * 3 * 2], &[], memory.buffers());
            for (at, scan) in memory.floats[5].chunks_exact(4).enumerate() {
                let robot = environments.place(at / 3).0.teams[environments.place(at / 3).1].first + at % 3;
                for (ray, distance) in scan.iter().enumerate() {
                    let walked = walked(&environments, at / 3, robot, FRAC_PI_2 * ray as f32 - PI);
                    near += usize::from(*distance < 1.0);
                    assert!((walked - distance).abs() < 3e-3, "robot {at}, ray {ray}: {walked} and {distance}");
                }
            }
        }
        assert!(near > 500, "{near}");
    }

    #[test]
    fn a_fan_that_does_not_go_around_is_in_the_frame_of_its_robot() {
        let mut wheeled =
            Options { lidar: lidar("from_rad = -0.3\nopening_rad = 0.6"), ..options(8, 1, Content::Nothing) };
        wheeled.body.drive = Some(DriveKind::Differential);
        wheeled.body.point_ahead_m = Some(0.1);
        let (mut environments, mut memory) = begun(wheeled);
        environments.begin(memory.buffers());
        for (at, scan) in memory.floats[5].chunks_exact(4).enumerate() {
            let (all, place) = environments.place(at / 3);
            let robot = all.teams[place].first + at % 3;
            for (ray, distance) in scan.iter().enumerate() {
                let walked = walked(&environments, at / 3, robot, all.heading(robot) - 0.3 + 0.2 * ray as f32);
                assert!((walked - distance).abs() < 3e-3, "robot {at}, ray {ray}: {walked} and {distance}");
            }
        }
    }

    #[test]
    fn noisy_scans_continue_from_a_state_to_the_bit_and_the_last_ones_of_an_episode_are_kept() {
        let noisy = || Options { lidar: lidar("noise_m = 0.05\ndropouts = 0.1"), ..options(5, 1, Content::Nothing) };
        let (mut first, mut memory) = begun(noisy());
        first.begin(memory.buffers());
        let actions = [0.3; 5 * 3 * 2];
        (0..7).for_each(|_| first.step(&actions, &[], memory.buffers()));
        let state = first.state(&memory.buffers());
        let (mut other, mut theirs) = begun(Options { seed: 99, ..noisy() });
        other.set_state(&state, theirs.buffers()).expect("it is a state of such environments");
        assert_eq!(theirs.floats, memory.floats);
        for step in 8..=20 {
            first.step(&actions, &[], memory.buffers());
            other.step(&actions, &[], theirs.buffers());
            assert_eq!(theirs.floats, memory.floats);
            assert_eq!(memory.floats[5] == memory.floats[6], step < 20, "an episode has 20 steps");
        }
        let plain = Options { lidar: lidar(""), ..noisy() };
        assert!(
            begun(plain).0.set_state(&state, theirs.buffers()).is_err_and(|why| why.to_string().contains("'senses'"))
        );
    }

    #[test]
    fn a_lidar_with_a_schedule_and_another_sense_are_refused_by_their_names() {
        let refused = |lidar: Option<Lidar>| {
            let error = Options { lidar, ..options(1, 1, Content::Nothing) }.check().expect_err("it is wrong");
            error.to_string()
        };
        assert!(refused(lidar("rate_hz = 10.0")).starts_with("senses.eyes.rate_hz"));
        assert!(refused(lidar("delay_s = 0.1")).starts_with("senses.eyes.delay_s"));
        assert!(refused(lidar("dropouts = 2.0")).starts_with("senses.eyes.dropouts"));
        let mut other = lidar("").expect("it is one");
        other.settings.kind = "relative".to_owned();
        assert!(refused(Some(other)).starts_with("senses.eyes.kind"));
    }
}
