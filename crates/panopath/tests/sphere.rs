//! Conversions between angles, pixels and bearings: known values, round trips, poles and seam.
#![allow(missing_docs, clippy::unwrap_used)]

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI, TAU};

use panopath::geometry::{angle_between, norm, normalized, scale};
use panopath::sphere::*;
use proptest::prelude::*;

fn close<const D: usize>(a: [f64; D], b: [f64; D], tolerance: f64) -> bool {
    a.iter().zip(&b).all(|(a, b)| (a - b).abs() <= tolerance)
}

#[test]
fn axes_of_each_camera() {
    assert!(close(bearing_from_spherical([FRAC_PI_2, 0.0]), [0.0, 1.0, 0.0], 1e-15));
    assert!(close(bearing_from_spherical([0.3, FRAC_PI_2]), [0.0, 0.0, 1.0], 1e-15));
    assert!(close(bearing_from_circular(-FRAC_PI_2), [0.0, -1.0], 1e-15));
    assert!(close(bearing_from_compass([0.0, 0.0]), [0.0, 1.0, 0.0], 1e-15), "north is +y");
    assert!(close(bearing_from_compass([FRAC_PI_2, 0.0]), [1.0, 0.0, 0.0], 1e-15), "clockwise: east is +x");
    assert!(close(bearing_from_planar_compass(FRAC_PI_2), [1.0, 0.0], 1e-15));
    let pano = Equirectangular { width_px: 1000.0, height_px: 500.0 };
    assert!(close(pano.bearing([500.0, 250.0]), [0.0, 0.0, 1.0], 1e-15), "the middle is forward");
    assert!(close(pano.bearing([750.0, 250.0]), [1.0, 0.0, 0.0], 1e-15), "right of it is +x");
    assert!(close(pano.bearing([500.0, 500.0]), [0.0, 1.0, 0.0], 1e-15), "the bottom is down, +y");
}

#[test]
fn cylinder_height_is_the_tangent() {
    let camera = Cylindrical { radius: 2.0 };
    let up_60 = bearing_from_spherical([0.4, PI / 3.0]);
    assert!(close(camera.angle_and_height(up_60), [0.4, 2.0 * 3.0_f64.sqrt()], 1e-14));
    // the printed r sin(phi) would put this point at another elevation
    assert!(angle_between(&camera.bearing([0.4, 2.0 * (PI / 3.0).sin()]), &up_60) > 0.3);
    assert!(angle_between(&camera.bearing([0.4, 2.0]), &bearing_from_spherical([0.4, FRAC_PI_4])) < 1e-15);
}

#[test]
fn poles_and_seam_have_one_value() {
    let pano = Equirectangular { width_px: 1000.0, height_px: 500.0 };
    for zero in [0.0, -0.0] {
        for other in [0.0, -0.0] {
            assert_eq!(spherical_from_bearing([zero, other, 1.0]), [0.0, FRAC_PI_2]);
            assert_eq!(compass_from_bearing([zero, other, -1.0]), [0.0, -FRAC_PI_2]);
            assert_eq!(pano.pixel([zero, -1.0, other]), [500.0, 0.0]);
            assert_eq!(pano.pixel([zero, 1.0, other]), [500.0, 500.0]);
            assert_eq!(pano.pixel([zero, other, -1.0]), [1000.0, 250.0]);
        }
        assert_eq!(spherical_from_bearing([-1.0, zero, 0.0]), [PI, 0.0]);
        assert_eq!(circular_from_bearing([-1.0, zero]), PI);
        assert_eq!(planar_compass_from_bearing([zero, 1.0]), 0.0);
        assert_eq!(planar_compass_from_bearing([zero, -1.0]), PI);
    }
    assert_eq!(planar_compass_from_bearing([-1e-300, 1.0]), 0.0, "never a full turn");
    let camera = Cylindrical { radius: 1.0 };
    assert_eq!(camera.angle_and_height([0.0, 0.0, -1.0]), [0.0, f64::NEG_INFINITY]);
    assert_eq!(camera.bearing([0.7, f64::INFINITY]), [0.0, 0.0, 1.0]);
}

#[test]
fn perspective_marks_what_is_behind() {
    let camera = Perspective { focal_px: [400.0, 300.0], principal_px: [320.0, 240.0] };
    assert!(close(camera.pixel([0.1, 0.2, 1.0]), [360.0, 300.0], 1e-12));
    for behind in [[0.1, 0.2, -1.0], [1.0, 0.0, 0.0], [0.0, 1.0, -0.0]] {
        assert!(camera.pixel(behind).iter().all(|px| px.is_nan()));
    }
}

#[test]
fn vertical_field_of_view_in_both_frames() {
    let up_30 = bearing_from_spherical([1.0, PI / 6.0]);
    assert!((elevation_z_up(up_30) - PI / 6.0).abs() < 1e-15);
    let pano = Equirectangular { width_px: 720.0, height_px: 360.0 };
    assert!((elevation_y_down(pano.bearing([100.0, 120.0])) - PI / 6.0).abs() < 1e-15, "row 120 of 360 is 30 deg up");
    assert!(is_in_vertical_field(0.2, 0.1, 0.3) && !is_in_vertical_field(0.4, 0.1, 0.3));
    assert!(!is_in_vertical_field(0.0, 0.1, 0.3) && is_in_vertical_field(FRAC_PI_2, 0.1, FRAC_PI_2));
}

fn direction() -> impl Strategy<Value = [f64; 3]> {
    let special = prop_oneof![Just(0.0), Just(-0.0), Just(1.0), Just(-1.0), Just(1e-9), Just(-1e-300)];
    let entry = prop_oneof![3 => -1.0..1.0_f64, 1 => special];
    [entry.clone(), entry.clone(), entry].prop_filter("a direction", |v| norm(v) > 1e-3).prop_map(|v| normalized(&v))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_direction_round_trips(b in direction(), length in 1e-3..1e3_f64) {
        let long = scale(length, &b);
        prop_assert!(angle_between(&bearing_from_spherical(spherical_from_bearing(long)), &b) < 8e-15);
        prop_assert!(angle_between(&bearing_from_compass(compass_from_bearing(long)), &b) < 8e-15);
        let pano = Equirectangular { width_px: 5760.0, height_px: 2880.0 };
        let pixel = pano.pixel(long);
        prop_assert!(angle_between(&pano.bearing(pixel), &b) < 8e-15);
        prop_assert!(pixel[0] >= 0.0 && pixel[0] <= 5760.0 && pixel[1] >= 0.0 && pixel[1] <= 2880.0);
        let cylinder = Cylindrical { radius: 0.7 };
        prop_assert!(angle_between(&cylinder.bearing(cylinder.angle_and_height(long)), &b) < 8e-15);
        let [azimuth, _] = compass_from_bearing(long);
        prop_assert!((0.0..TAU).contains(&azimuth));
        if b[2] > 1e-3 {
            let camera = Perspective { focal_px: [400.0, 410.0], principal_px: [320.0, 240.0] };
            prop_assert!(angle_between(&camera.bearing(camera.pixel(long)), &b) < 1e-13);
        }
    }

    #[test]
    fn every_angle_round_trips(theta in -PI..PI, phi in -1.57..1.57_f64) {
        prop_assert!(close(spherical_from_bearing(bearing_from_spherical([theta, phi])), [theta, phi], 1e-12));
        prop_assert!((circular_from_bearing(bearing_from_circular(theta)) - theta).abs() < 1e-14);
        let azimuth = theta + PI;
        prop_assert!(close(compass_from_bearing(bearing_from_compass([azimuth, phi])), [azimuth, phi], 1e-12));
        prop_assert!((planar_compass_from_bearing(bearing_from_planar_compass(azimuth)) - azimuth).abs() < 1e-14);
    }
}
