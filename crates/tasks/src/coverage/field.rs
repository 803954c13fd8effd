//! Density on the ground: the importance of each cell, given or as a sum of truncated Gaussians.

use std::ops::Range;

use murmurate::random::{RngExt, Stream};

use super::{
    Point,
    grid::{Grid, Window},
};

/// Gaussian of a density.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Feature {
    /// Mean \[m\].
    pub centre_m: Point,
    /// Standard deviation along each axis \[m\].
    pub deviation_m: f64,
    /// Factor on the normal distribution, whose integral over the plane is 1.
    pub weight: f64,
}

/// Bounds within which worlds are drawn: number of Gaussians, and ranges of their deviations and weights.
#[derive(Clone, Debug, PartialEq)]
pub struct Bounds {
    /// Number of Gaussians.
    pub features: usize,
    /// Standard deviations \[m\].
    pub deviation_m: Range<f64>,
    /// Weights.
    pub weight: Range<f64>,
    /// Distance from its mean at which a Gaussian ends, in standard deviations.
    pub truncation: f64,
}

impl Bounds {
    /// Returns the bounds of the benchmark: 32 Gaussians with weights of 6 to 10, cut at two deviations, which are
    /// defaults of CoverageControl 1.3.1, and deviations of 40 to 60 m, where the default is 40 to 50 m.
    pub fn published() -> Bounds {
        Bounds { features: 32, deviation_m: 40.0..60.0, weight: 6.0..10.0, truncation: 2.0 }
    }

    /// Draws Gaussians whose means are anywhere on the ground of `grid`.
    pub fn draw(&self, grid: Grid, stream: &mut Stream) -> Vec<Feature> {
        let mut feature = || Feature {
            centre_m: place(grid, stream),
            deviation_m: stream.random_range(self.deviation_m.clone()),
            weight: stream.random_range(self.weight.clone()),
        };
        (0..self.features).map(|_| feature()).collect()
    }
}

/// Draws a place on the ground of `grid`, from the uniform distribution.
pub fn place(grid: Grid, stream: &mut Stream) -> Point {
    let side_m = grid.side_m();
    [stream.random_range(0.0..side_m), stream.random_range(0.0..side_m)]
}

/// Sums over neighbouring cells of a row.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sums {
    /// Sum of the density.
    pub mass: f64,
    /// Sum of density times y \[m\].
    pub first: f64,
    /// Sum of density times squared y \[m²\].
    pub second: f64,
}

/// Density of every cell, with running sums over each row, so that a sum over neighbouring cells costs one subtraction.
#[derive(Clone, Debug)]
pub struct Field {
    grid: Grid,
    density: Vec<f32>,
    /// For each row, the sums over its first 0, 1, ... cells.
    running: Vec<Sums>,
}

/// Error of a density that is none.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FieldError {
    /// The grid has no cells, or cells without a side.
    #[error("a grid has at least one cell, with a side above 0 m, not {cells} cells of {cell_m} m")]
    Grid {
        /// Number of cells along an axis.
        cells: usize,
        /// Side of a cell \[m\].
        cell_m: f64,
    },
    /// There is not one number per cell.
    #[error("the grid has {cells} cells, and there are {found} densities")]
    Cells {
        /// Number of cells of the grid.
        cells: usize,
        /// Number of densities.
        found: usize,
    },
    /// The density of a cell is negative, or no number.
    #[error("the density of row {row}, column {column} is {density}; it must be a number of at least 0")]
    Density {
        /// Row of the cell.
        row: usize,
        /// Column of the cell.
        column: usize,
        /// Density of the cell.
        density: f32,
    },
    /// A Gaussian has a deviation that is not above zero, or a number that is not finite.
    #[error("Gaussian {feature} has a deviation of at most 0, a negative weight, or a number that is not finite")]
    Feature {
        /// Index of the Gaussian.
        feature: usize,
    },
}

impl Field {
    /// Makes the density of its cells, row after row. A density that is negative or no number is refused.
    pub fn of_cells(grid: Grid, density: Vec<f32>) -> Result<Field, FieldError> {
        check_grid(grid)?;
        if density.len() != grid.cells * grid.cells {
            return Err(FieldError::Cells { cells: grid.cells * grid.cells, found: density.len() });
        }
        if let Some(at) = density.iter().position(|density| !density.is_finite() || *density < 0.0) {
            let (row, column) = (at / grid.cells, at % grid.cells);
            return Err(FieldError::Density { row, column, density: density[at] });
        }
        let mut running = Vec::with_capacity(grid.cells * (grid.cells + 1));
        for row in density.chunks_exact(grid.cells) {
            let mut sums = Sums::default();
            running.push(sums);
            for (column, &density) in row.iter().enumerate() {
                let (density, y) = (f64::from(density), grid.centre_m(column));
                sums.mass += density;
                sums.first += density * y;
                sums.second += density * y * y;
                running.push(sums);
            }
        }
        Ok(Field { grid, density, running })
    }

    /// Makes the density of a sum of Gaussians, scaled so that the largest density is 1. A cell gets a Gaussian's
    /// integral over the cell if its centre is nearer to the mean than `truncation` deviations, and else nothing: so
    /// the maps of CoverageControl are, by experiment (docs/coverage.md). Without any Gaussian the density is 0
    /// everywhere.
    pub fn of_features(grid: Grid, features: &[Feature], truncation: f64) -> Result<Field, FieldError> {
        check_grid(grid)?;
        for (at, feature) in features.iter().enumerate() {
            let numbers = [feature.centre_m[0], feature.centre_m[1], feature.deviation_m, feature.weight];
            let finite = numbers.iter().all(|number| number.is_finite());
            if !finite || feature.deviation_m <= 0.0 || feature.weight < 0.0 {
                return Err(FieldError::Feature { feature: at });
            }
        }
        let sums = integrals(grid, features, truncation, &grid.all());
        let most = sums.iter().copied().fold(0.0, f64::max);
        let scale = if most > 0.0 { 1.0 / most } else { 0.0 };
        Field::of_cells(grid, sums.into_iter().map(|sum| (sum * scale) as f32).collect())
    }

    /// Returns the grid of the density.
    pub fn grid(&self) -> Grid {
        self.grid
    }

    /// Returns the densities of all cells, row after row.
    pub fn density(&self) -> &[f32] {
        &self.density
    }

    /// Returns the sums over the cells `columns` of the row `row`. The sums of cells without density are exactly zero.
    pub fn sums(&self, row: usize, columns: Range<usize>) -> Sums {
        let of_row = &self.running[row * (self.grid.cells + 1)..][..=self.grid.cells];
        let (from, to) = (of_row[columns.start], of_row[columns.end]);
        Sums { mass: to.mass - from.mass, first: to.first - from.first, second: to.second - from.second }
    }
}

fn check_grid(grid: Grid) -> Result<(), FieldError> {
    let sound = grid.cells > 0 && grid.cell_m.is_finite() && grid.cell_m > 0.0;
    if sound { Ok(()) } else { Err(FieldError::Grid { cells: grid.cells, cell_m: grid.cell_m }) }
}

/// Returns the integrals of a sum of Gaussians over the cells of `window`, row after row. A cell gets that of a
/// Gaussian if its centre is nearer to the mean than `truncation` deviations.
pub fn integrals(grid: Grid, features: &[Feature], truncation: f64, window: &Window) -> Vec<f64> {
    let mut sums = vec![0.0; window.rows.len() * window.columns.len()];
    for feature in features {
        add(grid, feature, truncation, window, &mut sums);
    }
    sums
}

/// Adds the integrals of `feature` over the cells of `window` to `sums`.
fn add(grid: Grid, feature: &Feature, truncation: f64, window: &Window, sums: &mut [f64]) {
    let radius_m = truncation * feature.deviation_m;
    let reached = grid.window(feature.centre_m, 2.0 * (radius_m + grid.cell_m)).within(window);
    // The integral over a cell is the product of those along the axes.
    let share = |axis: usize, index: usize| {
        let bound = |index: usize| {
            let from_mean_m = index as f64 * grid.cell_m - feature.centre_m[axis];
            0.5 * libm::erf(from_mean_m / (feature.deviation_m * std::f64::consts::SQRT_2))
        };
        bound(index + 1) - bound(index)
    };
    let columns: Vec<f64> = reached.columns.clone().map(|column| share(1, column)).collect();
    for row in reached.rows {
        let along_x = feature.weight * share(0, row);
        let dx_m = grid.centre_m(row) - feature.centre_m[0];
        let of_row = &mut sums[(row - window.rows.start) * window.columns.len()..];
        for (column, along_y) in reached.columns.clone().zip(&columns) {
            let dy_m = grid.centre_m(column) - feature.centre_m[1];
            if dx_m * dx_m + dy_m * dy_m < radius_m * radius_m {
                of_row[column - window.columns.start] += along_x * along_y;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use murmurate::random::Seed;

    use super::*;

    const GRID: Grid = Grid { cells: 4, cell_m: 0.5 };

    #[test]
    fn sums_over_cells_are_those_of_their_densities() {
        let mut density = vec![0.0; 16];
        density[4..8].copy_from_slice(&[1.0, 2.0, 0.0, 4.0]);
        let field = Field::of_cells(GRID, density).expect("densities are at least 0");
        assert_eq!(field.sums(1, 1..4), Sums { mass: 6.0, first: 2.0 * 0.75 + 4.0 * 1.75, second: 1.125 + 12.25 });
        assert_eq!(field.sums(1, 2..3), Sums::default());
        assert_eq!(field.sums(0, 0..4), Sums::default());
    }

    #[test]
    fn what_is_no_density_is_refused() {
        for wrong in [f32::NAN, f32::INFINITY, -0.1] {
            let mut density = vec![0.0; 16];
            density[6] = wrong;
            let error = Field::of_cells(GRID, density).expect_err("a wrong density");
            assert!(error.to_string().starts_with("the density of row 1, column 2"), "{error}");
        }
        assert_eq!(
            Field::of_cells(GRID, vec![0.0; 15]).expect_err("a cell is missing"),
            FieldError::Cells { cells: 16, found: 15 }
        );
        assert!(Field::of_cells(Grid { cells: 0, cell_m: 1.0 }, Vec::new()).is_err());
        let feature = Feature { centre_m: [1.0, f64::NAN], deviation_m: 1.0, weight: 1.0 };
        assert_eq!(
            Field::of_features(GRID, &[feature], 2.0).expect_err("a mean that is no number"),
            FieldError::Feature { feature: 0 }
        );
    }

    #[test]
    fn a_gaussian_is_1_at_its_mean_and_ends_at_its_truncation() {
        let grid = Grid { cells: 200, cell_m: 1.0 };
        let feature = Feature { centre_m: [100.5, 60.5], deviation_m: 20.0, weight: 8.0 };
        let field = Field::of_features(grid, &[feature], 2.0).expect("a Gaussian");
        let at = |row: usize, column: usize| f64::from(field.density()[row * 200 + column]);
        assert_eq!(at(100, 60), 1.0);
        // 20 m off the mean, exp(-1/2), but for what the density varies within a cell.
        assert!((at(120, 60) - 0.606_53).abs() < 1e-4, "{}", at(120, 60));
        assert_eq!((at(100, 99) > 0.0, at(100, 100)), (true, 0.0));
    }

    #[test]
    fn no_gaussian_is_no_density() {
        let field = Field::of_features(GRID, &[], 2.0).expect("no Gaussian");
        assert!(field.density().iter().all(|&density| density == 0.0));
    }

    #[test]
    fn equal_seeds_draw_equal_fields() {
        let drawn = |seed: u64| Bounds::published().draw(GRID, &mut Seed::of_run(seed).stream("coverage/field"));
        assert_eq!(drawn(3), drawn(3));
        assert_ne!(drawn(3), drawn(4));
        assert!(drawn(3).iter().all(|feature| (40.0..60.0).contains(&feature.deviation_m)));
    }
}
