//! Picture of one team as pixels, for `render_mode="rgb_array"`.

use murmurate::messages::geometry::Vec2;
use murmurate_train::environments::Environments;

/// Pixels along the longer side of a picture, and of its margin.
const LARGEST: f32 = 400.0;
/// Least radius of a robot \[pixels\], so that it is seen on a large ground.
const LEAST: f32 = 2.5;
/// Colour of the ground, and that of walls and of arrived robots' rims.
const GROUND: [u8; 3] = [255, 255, 255];
const WALL: [u8; 3] = [61, 70, 81];
/// Colours of robots, as in the pictures of episodes.
const ROBOTS: [[u8; 3]; 8] = [
    [0, 114, 178],
    [213, 94, 0],
    [0, 158, 115],
    [230, 159, 0],
    [204, 121, 167],
    [86, 180, 233],
    [160, 82, 45],
    [125, 133, 144],
];

/// Pixels of a picture, three bytes each, row by row from above.
pub struct Picture {
    /// Number of pixels in a row.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Red, green and blue of every pixel.
    pub pixels: Vec<u8>,
    scale: f32,
    half: Vec2,
}

impl Picture {
    /// Returns the picture of the team with index `team`: ground with walls, goals as rings, robots as discs. `goals`
    /// says whether the robots have goals.
    pub fn of(environments: &Environments, team: usize, goals: bool) -> Picture {
        let arena = environments.arena_now(team);
        let half = arena.half_extent + Vec2::repeat(arena.robot_radius_m);
        let scale = LARGEST / (2.0 * half.x.max(half.y));
        let pixels = |metres: f32| ((2.0 * metres * scale).round() as usize).max(1);
        let (width, height) = (pixels(half.x), pixels(half.y));
        let mut picture = Picture { width, height, pixels: GROUND.repeat(width * height), scale, half };
        for block in &arena.keep_outs {
            picture.paint((block.min, block.max), WALL, |point| block.is_rect() || block.distance(point) == 0.0);
        }
        let radius_m = arena.robot_radius_m.max(LEAST / scale);
        for (index, robot) in environments.teams[team].range().enumerate() {
            let unlabelled = environments.scenario(team).goals().are_unlabelled();
            let colour = if unlabelled { WALL } else { ROBOTS[index % ROBOTS.len()] };
            if goals {
                picture.ring(environments.tasks[robot].goal, (0.7 * radius_m, radius_m), colour);
            }
        }
        for (index, robot) in environments.teams[team].range().enumerate() {
            let (at, colour) = (environments.position[robot], ROBOTS[index % ROBOTS.len()]);
            picture.ring(at, (0.0, radius_m), colour);
            if environments.arrived[robot] {
                picture.ring(at, (0.8 * radius_m, radius_m), WALL);
            }
        }
        picture
    }

    fn ring(&mut self, at: Vec2, (from_m, to_m): (f32, f32), colour: [u8; 3]) {
        let reach = Vec2::repeat(to_m);
        self.paint((at - reach, at + reach), colour, |point| (from_m..=to_m).contains(&(point - at).norm()));
    }

    /// Colours the pixels of a box \[m\] whose centres `within` selects.
    fn paint(&mut self, (low, high): (Vec2, Vec2), colour: [u8; 3], within: impl Fn(Vec2) -> bool) {
        let column = |x: f32| ((x + self.half.x) * self.scale).clamp(0.0, self.width as f32);
        let row = |y: f32| ((self.half.y - y) * self.scale).clamp(0.0, self.height as f32);
        let (columns, rows) = (column(low.x)..column(high.x), row(high.y)..row(low.y));
        for y in rows.start as usize..(rows.end.ceil() as usize).min(self.height) {
            for x in columns.start as usize..(columns.end.ceil() as usize).min(self.width) {
                let point = Vec2::new(x as f32 + 0.5, y as f32 + 0.5) / self.scale;
                if within(Vec2::new(point.x - self.half.x, self.half.y - point.y)) {
                    let at = 3 * (y * self.width + x);
                    self.pixels[at..at + 3].copy_from_slice(&colour);
                }
            }
        }
    }
}
