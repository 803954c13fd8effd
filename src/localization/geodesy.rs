//! Geodesy: conversion of latitude, longitude and height on WGS 84 to a local frame with axes east, north and up, in
//! f64.

use std::f64::consts::PI;

/// Semi-major axis of WGS 84 \[m\] (NGA.STND.0036, table 3.1).
const SEMI_MAJOR_M: f64 = 6_378_137.0;
/// Flattening of WGS 84 (NGA.STND.0036, table 3.1).
const FLATTENING: f64 = 1.0 / 298.257_223_563;
/// Square of the first eccentricity of WGS 84.
const ECCENTRICITY_SQUARED: f64 = FLATTENING * (2.0 - FLATTENING);

/// Point on or above the earth, as latitude, longitude and height on the ellipsoid WGS 84.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geodetic {
    /// Latitude \[deg\], north is positive.
    pub latitude_deg: f64,
    /// Longitude \[deg\], east is positive.
    pub longitude_deg: f64,
    /// Height above the WGS 84 ellipsoid \[m\], which differs from the height above sea level.
    pub height_m: f64,
}

/// Local frame with axes east, north and up: the tangent plane of the WGS 84 ellipsoid at an origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalFrame {
    origin: [f64; 3],
    /// Sine and cosine of the origin's latitude.
    latitude: (f64, f64),
    /// Sine and cosine of the origin's longitude.
    longitude: (f64, f64),
}

fn sin_cos_deg(angle_deg: f64) -> (f64, f64) {
    libm::sincos(angle_deg * (PI / 180.0))
}

/// Returns the earth-fixed cartesian coordinates of a point \[m\]: the z axis points to the north pole, the x axis to
/// the prime meridian at the equator.
fn cartesian(point: &Geodetic) -> [f64; 3] {
    let ((sin, cos), (sin_longitude, cos_longitude)) =
        (sin_cos_deg(point.latitude_deg), sin_cos_deg(point.longitude_deg));
    // Radius of curvature in the prime vertical.
    let radius_m = SEMI_MAJOR_M / (1.0 - ECCENTRICITY_SQUARED * sin * sin).sqrt();
    let from_axis_m = (radius_m + point.height_m) * cos;
    let north_m = (radius_m * (1.0 - ECCENTRICITY_SQUARED) + point.height_m) * sin;
    [from_axis_m * cos_longitude, from_axis_m * sin_longitude, north_m]
}

impl LocalFrame {
    /// Returns the local frame whose origin is the point `origin`.
    pub fn at(origin: &Geodetic) -> LocalFrame {
        LocalFrame {
            origin: cartesian(origin),
            latitude: sin_cos_deg(origin.latitude_deg),
            longitude: sin_cos_deg(origin.longitude_deg),
        }
    }

    /// Returns the coordinates of `point` in the local frame \[m\]: east, north and up from the frame's origin.
    pub fn east_north_up(&self, point: &Geodetic) -> [f64; 3] {
        let [x, y, z] = cartesian(point);
        let [x, y, z] = [x - self.origin[0], y - self.origin[1], z - self.origin[2]];
        let ((sin_latitude, cos_latitude), (sin, cos)) = (self.latitude, self.longitude);
        // Component in the plane of the equator, towards the origin's meridian.
        let out = cos * x + sin * y;
        [cos * y - sin * x, cos_latitude * z - sin_latitude * out, cos_latitude * out + sin_latitude * z]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(latitude_deg: f64, longitude_deg: f64, height_m: f64) -> Geodetic {
        Geodetic { latitude_deg, longitude_deg, height_m }
    }

    #[test]
    fn known_places_have_their_cartesian_coordinates() {
        let near = |place: Geodetic, xyz: [f64; 3]| {
            (0..3).for_each(|at| assert!((cartesian(&place)[at] - xyz[at]).abs() < 1e-6, "{:?}", cartesian(&place)));
        };
        near(point(0.0, 0.0, 0.0), [SEMI_MAJOR_M, 0.0, 0.0]);
        near(point(0.0, 90.0, 10.0), [0.0, SEMI_MAJOR_M + 10.0, 0.0]);
        // The semi-minor axis of WGS 84 is 6356752.314245 m.
        near(point(-90.0, 0.0, 0.0), [0.0, 0.0, -6_356_752.314_245]);
    }

    #[test]
    fn east_is_east_and_north_is_north() {
        let origin = point(52.2053, 0.1218, 12.0);
        let frame = LocalFrame::at(&origin);
        assert_eq!(frame.east_north_up(&origin), [0.0; 3]);
        let [east, north, up] = frame.east_north_up(&point(52.2053, 0.1219, 12.0));
        assert!((east - 6.835).abs() < 1e-2 && north.abs() < 1e-4 && up.abs() < 1e-4, "{east} {north} {up}");
        let [east, north, up] = frame.east_north_up(&point(52.2054, 0.1218, 13.0));
        assert!(east.abs() < 1e-9 && (north - 11.127).abs() < 1e-2 && (up - 1.0).abs() < 1e-4, "{north} {up}");
    }

    #[test]
    fn east_and_north_are_those_of_an_independent_library() {
        // pymap3d 3.2.0, geodetic2enu, to 0.1 um.
        let cases = [
            ([52.2053, 0.1218], [52.212_345_6, 0.129_876_5, 58.0], [552.054_680_5, 784.011_071_1, 57.927_952_5]),
            ([52.2053, 0.1218], [52.269, 0.225, 12.0], [7_045.019_521_4, 7_093.042_657_6, 4.171_614_3]),
            ([-33.8568, 151.2153], [-33.95, 151.1, 250.0], [-10_658.612_955_6, -10_344.180_811_9, 232.685_688]),
            ([69.6492, 18.9553], [69.73, 19.2, 3.5], [9_465.003_445_1, 9_032.844_554_3, -9.884_787_9]),
            ([0.0, 180.0], [0.05, -179.95, 100.0], [5_566.058_994_5, 5_528.800_369_9, 95.158_954]),
        ];
        for ([latitude, longitude], [to_latitude, to_longitude, height], expected) in cases {
            let frame = LocalFrame::at(&point(latitude, longitude, 0.0));
            let found = frame.east_north_up(&point(to_latitude, to_longitude, height));
            (0..3).for_each(|axis| assert!((found[axis] - expected[axis]).abs() < 1e-6, "{found:?} {expected:?}"));
        }
    }
}
