//! What a camera reports, as directions of the sphere and back.
//!
//! Two families of axes occur. Angles are measured about a vertical z axis:
//! `bearing = (cos phi cos theta, cos phi sin theta, sin phi)`. Pixels belong to camera axes, x right, y down, z
//! forward. Nothing here converts between the two: that is an orientation.
//!
//! Every inverse takes vectors of any positive length, and gives the angles of a pole or of the seam one fixed value:
//! azimuth 0 at a pole, `+pi` (the right border of a panorama) straight behind.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Azimuth `theta` from the x axis towards y, elevation `phi` above the horizon.
pub fn bearing_from_spherical([theta_rad, phi_rad]: [f64; 2]) -> [f64; 3] {
    let (sin_theta, cos_theta) = theta_rad.sin_cos();
    let (sin_phi, cos_phi) = phi_rad.sin_cos();
    [cos_phi * cos_theta, cos_phi * sin_theta, sin_phi]
}

/// Inverse of [`bearing_from_spherical`]: `theta` in `(-pi, pi]`, `phi` in `[-pi/2, pi/2]`.
pub fn spherical_from_bearing(bearing: [f64; 3]) -> [f64; 2] {
    [azimuth(bearing[0], bearing[1]), elevation_z_up(bearing)]
}

/// The planar, circular camera: angle from the x axis towards y.
pub fn bearing_from_circular(theta_rad: f64) -> [f64; 2] {
    [theta_rad.cos(), theta_rad.sin()]
}

/// Inverse of [`bearing_from_circular`], in `(-pi, pi]`.
pub fn circular_from_bearing(bearing: [f64; 2]) -> f64 {
    azimuth(bearing[0], bearing[1])
}

/// Compass azimuth, clockwise from north, and elevation; x is east, y north, z up.
pub fn bearing_from_compass([azimuth_rad, elevation_rad]: [f64; 2]) -> [f64; 3] {
    let (sin_azimuth, cos_azimuth) = azimuth_rad.sin_cos();
    let (sin_elevation, cos_elevation) = elevation_rad.sin_cos();
    [cos_elevation * sin_azimuth, cos_elevation * cos_azimuth, sin_elevation]
}

/// Inverse of [`bearing_from_compass`]: azimuth in `[0, 2 pi)`.
pub fn compass_from_bearing(bearing: [f64; 3]) -> [f64; 2] {
    [turn(azimuth(bearing[1], bearing[0])), elevation_z_up(bearing)]
}

/// Compass azimuth of a planar bearing.
pub fn bearing_from_planar_compass(azimuth_rad: f64) -> [f64; 2] {
    [azimuth_rad.sin(), azimuth_rad.cos()]
}

/// Inverse of [`bearing_from_planar_compass`], in `[0, 2 pi)`.
pub fn planar_compass_from_bearing(bearing: [f64; 2]) -> f64 {
    turn(azimuth(bearing[1], bearing[0]))
}

/// A camera that projects from its centre onto a vertical cylinder about it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cylindrical {
    /// Radius of the cylinder, in the unit of the height.
    pub radius: f64,
}

impl Cylindrical {
    /// Bearing of the point of the cylinder at azimuth `theta` and height `z`; an infinite height is a pole.
    ///
    /// The ray at elevation `phi` meets the cylinder at `z = r tan(phi)`. Knill & Ramirez-Herran print `r sin(phi)`,
    /// which is the height on a sphere of radius `r` and never leaves `[-r, r]`.
    pub fn bearing(&self, [theta_rad, height]: [f64; 2]) -> [f64; 3] {
        if height.is_infinite() {
            return [0.0, 0.0, height.signum()];
        }
        let (sin, cos) = theta_rad.sin_cos();
        unit([self.radius * cos, self.radius * sin, height])
    }

    /// Inverse of [`Self::bearing`].
    pub fn angle_and_height(&self, bearing: [f64; 3]) -> [f64; 2] {
        let [x, y, z] = bearing;
        [azimuth(x, y), self.radius * (z / x.hypot(y))]
    }
}

/// A perspective camera, which is a patch of the sphere; camera axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Perspective {
    /// Focal lengths along x and y.
    pub focal_px: [f64; 2],
    /// Principal point.
    pub principal_px: [f64; 2],
}

impl Perspective {
    /// Bearing of a pixel.
    pub fn bearing(&self, [x_px, y_px]: [f64; 2]) -> [f64; 3] {
        let x = (x_px - self.principal_px[0]) / self.focal_px[0];
        let y = (y_px - self.principal_px[1]) / self.focal_px[1];
        unit([x, y, 1.0])
    }

    /// Pixel of a bearing, NaN where it is not in front of the camera.
    pub fn pixel(&self, [x, y, z]: [f64; 3]) -> [f64; 2] {
        if z <= 0.0 {
            return [f64::NAN; 2];
        }
        [self.focal_px[0] * (x / z) + self.principal_px[0], self.focal_px[1] * (y / z) + self.principal_px[1]]
    }
}

/// A panorama exactly as COLMAP's EQUIRECTANGULAR camera; camera axes, pixel centres at +0.5.
///
/// `theta = 2 pi (x / w - 1/2)`, `phi = pi (1/2 - y / h)`,
/// `bearing = (cos phi sin theta, -sin phi, cos phi cos theta)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Equirectangular {
    /// Width of the full turn.
    pub width_px: f64,
    /// Height from pole to pole.
    pub height_px: f64,
}

impl Equirectangular {
    /// Bearing of a pixel.
    pub fn bearing(&self, [x_px, y_px]: [f64; 2]) -> [f64; 3] {
        let (sin_theta, cos_theta) = (TAU * (x_px / self.width_px - 0.5)).sin_cos();
        let (sin_phi, cos_phi) = (PI * (0.5 - y_px / self.height_px)).sin_cos();
        [cos_phi * sin_theta, -sin_phi, cos_phi * cos_theta]
    }

    /// Pixel of a bearing; x in `(0, w]`, y in `[0, h]`.
    pub fn pixel(&self, bearing: [f64; 3]) -> [f64; 2] {
        let theta_rad = azimuth(bearing[2], bearing[0]);
        let phi_rad = elevation_y_down(bearing);
        [self.width_px * (theta_rad / TAU + 0.5), self.height_px * (0.5 - phi_rad / PI)]
    }
}

/// Elevation above the horizon where z points up.
pub fn elevation_z_up([x, y, z]: [f64; 3]) -> f64 {
    z.atan2(x.hypot(y))
}

/// Elevation above the horizon in camera axes, where y points down.
pub fn elevation_y_down([x, y, z]: [f64; 3]) -> f64 {
    elevation_z_up([x, z, -y])
}

/// A vector over its length, which may be far beyond the root of the largest number.
fn unit([x, y, z]: [f64; 3]) -> [f64; 3] {
    let length = x.hypot(y).hypot(z);
    [x / length, y / length, z / length]
}

/// Angle of the vector `(x, y)` in `(-pi, pi]`, 0 of the zero vector.
fn azimuth(x: f64, y: f64) -> f64 {
    // adding zero turns -0 into +0: one direction must not have two angles
    (y + 0.0).atan2(x + 0.0)
}

/// An angle of `(-pi, pi]` in `[0, 2 pi)`.
fn turn(angle_rad: f64) -> f64 {
    let positive = if angle_rad < 0.0 { angle_rad + TAU } else { angle_rad };
    // the sum rounds up to a full turn for angles just below zero
    if positive < TAU { positive } else { 0.0 }
}

/// Whether an elevation lies in a vertical field of view; a bound at a pole takes the pole in despite rounding.
pub fn is_in_vertical_field(elevation_rad: f64, low_rad: f64, high_rad: f64) -> bool {
    let above = low_rad <= -FRAC_PI_2 || elevation_rad >= low_rad;
    let below = high_rad >= FRAC_PI_2 || elevation_rad <= high_rad;
    above && below
}
