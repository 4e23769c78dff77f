//! The rendered walk shows things where the truth says they are, the same every time, and without aliasing.
#![allow(missing_docs, clippy::unwrap_used)]

use panopath::geometry::{Rotation, Vector, add, angle_between, norm, scale, sub};
use panopath::sphere::Equirectangular;
use panopath::synthetic::render::{Walk, WalkOptions, WalkPath, WalkRotation, render_frame, render_ranges, walk};

fn options(width_px: usize) -> WalkOptions {
    WalkOptions { width_px, n_frames: 40, frame_rate_hz: 2.0, seed: 3, ..Default::default() }
}

fn camera(walk: &Walk) -> Equirectangular {
    Equirectangular { width_px: walk.width_px() as f64, height_px: walk.height_px() as f64 }
}

fn pixel_of(walk: &Walk, k: usize, point: &Vector<3>) -> [f64; 2] {
    camera(walk).pixel(walk.cam_from_world[k].apply(&sub(point, &walk.centers[k])))
}

fn point_of(walk: &Walk, k: usize, x: usize, y: usize, range: f32) -> Vector<3> {
    let bearing = camera(walk).bearing([x as f64 + 0.5, y as f64 + 0.5]);
    add(&walk.centers[k], &scale(f64::from(range), &walk.cam_from_world[k].inverse().apply(&bearing)))
}

/// Brightness at a place of the panorama between pixel centres; columns go round.
fn brightness(walk: &Walk, frame: &[u8], [x, y]: [f64; 2]) -> f64 {
    let (w, h) = (walk.width_px(), walk.height_px());
    let (x, y) = (x - 0.5 + w as f64, (y - 0.5).clamp(0.0, h as f64 - 1.001));
    let (i, j) = (x.floor(), y.floor());
    let at = |i: usize, j: usize| frame[3 * (j * w + i % w)..][..3].iter().map(|&v| f64::from(v)).sum::<f64>() / 3.0;
    let (a, b, i, j) = (x - i, y - j, i as usize, j as usize);
    (1.0 - b) * ((1.0 - a) * at(i, j) + a * at(i + 1, j)) + b * ((1.0 - a) * at(i, j + 1) + a * at(i + 1, j + 1))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn range_at(walk: &Walk, ranges: &[f32], [x, y]: [f64; 2]) -> f64 {
    f64::from(ranges[(y as usize).min(walk.height_px() - 1) * walk.width_px() + x as usize % walk.width_px()])
}

#[test]
fn dashes_of_the_street_are_where_the_projection_says() {
    // dashes run along y = 0 from x = 6 k to 6 k + 3 and are 12 cm wide
    let street = walk(&WalkOptions { rotation: WalkRotation::Tumble, ..options(2048) }).unwrap();
    let delta = std::f64::consts::TAU / 2048.0;
    let (mut ends_px, mut sides_px) = (Vec::new(), Vec::new());
    for k in (4..36).step_by(4) {
        let (frame, ranges) = (render_frame(&street, k).unwrap(), render_ranges(&street, k).unwrap());
        let visible = |p: Vector<3>| {
            let range = norm(&sub(&p, &street.centers[k]));
            (range_at(&street, &ranges, pixel_of(&street, k, &p)) / range - 1.0).abs() < 0.03
        };
        let shown = |x: f64, y: f64| brightness(&street, &frame, pixel_of(&street, k, &[x, y, 0.0]));
        for dash in 2..9 {
            let (from, to) = (6.0 * f64::from(dash), 6.0 * f64::from(dash) + 3.0);
            let range = norm(&sub(&[0.5 * (from + to), 0.0, 0.0], &street.centers[k]));
            let all = [from - 0.6, from, 0.5 * (from + to), to, to + 0.6];
            if range > 9.0 || !all.into_iter().all(|x| visible([x, 0.0, 0.0])) {
                continue;
            }
            for (end, outwards) in [(from, -1.0), (to, 1.0)] {
                // where the brightness is half way between that of the paint and that of the asphalt
                let profile: Vec<f64> =
                    (-200..=200).map(|i| shown(end + 0.002 * f64::from(i) * outwards, 0.0)).collect();
                let plateau = |range: std::ops::Range<usize>| median(profile[range].to_vec());
                let (high, low) = (plateau(0..100), plateau(301..401));
                let half = 0.5 * (high + low);
                let crossings = (0..400).filter(|&i| profile[i] >= half && profile[i + 1] < half);
                let at = crossings.min_by_key(|i| i.abs_diff(200)).unwrap();
                let offset = 0.002 * (at as f64 - 200.0 + (profile[at] - half) / (profile[at] - profile[at + 1]));
                assert!(high - low > 15.0, "{high} {low}");
                ends_px.push(outwards * offset / (range * delta));
            }
            for x in [from + 0.8, from + 1.5, from + 2.2] {
                // the asphalt may be lighter on one side
                let profile: Vec<f64> = (-100..=100).map(|i| shown(x, 0.002 * f64::from(i))).collect();
                let mean = |range: std::ops::Range<usize>| profile[range].iter().sum::<f64>() / 25.0;
                let (left, right) = (mean(0..25), mean(176..201));
                let paint = |i: usize| profile[i] - left - (right - left) * i as f64 / 200.0;
                let mass: f64 = (0..201).map(paint).sum();
                let center = (0..201).map(|i| paint(i) * 0.002 * (i as f64 - 100.0)).sum::<f64>() / mass;
                let sin = street.centers[k][2] / range;
                sides_px.push(center * sin / (range * delta));
            }
        }
    }

    assert!(ends_px.len() >= 8 && sides_px.len() >= 12, "{} {}", ends_px.len(), sides_px.len());
    let (ends, sides) = (median(ends_px), median(sides_px));
    assert!(ends.abs() < 0.1, "dashes are shifted by {ends} pixels along the street");
    assert!(sides.abs() < 0.15, "dashes are shifted by {sides} pixels across the street");
}

#[test]
fn ranges_end_on_the_ground_and_on_houses() {
    let street = walk(&options(512)).unwrap();
    let ranges = render_ranges(&street, 20).unwrap();
    let (mut ground, mut houses, mut sky) = (0, 0, 0);
    for (i, &range) in ranges.iter().enumerate() {
        let (x, y) = (i % 512, i / 512);
        if range.is_infinite() {
            sky += 1;
            assert!(y < 270, "sky at row {y}");
            continue;
        }
        let p = point_of(&street, 20, x, y, range);
        assert!(p[2] > -1e-3 && p[2] < 25.0, "{p:?}");
        ground += usize::from(p[2].abs() < 1e-3);
        houses += usize::from((p[1] - 8.0).abs() < 1e-3 || (p[1] + 8.0).abs() < 1e-3);
    }
    let n = ranges.len();
    assert!(ground > n / 4 && houses > n / 8 && sky > n / 8, "{ground} {houses} {sky} of {n}");
}

#[test]
fn tiles_hide_nothing_that_is_seen() {
    // middles of every third pixel are those of a frame of a third of the width, whose tiles are other parts of the sphere
    for (rotation, path) in [(WalkRotation::Sway, WalkPath::Corner), (WalkRotation::Tumble, WalkPath::Loop)] {
        let o = WalkOptions { rotation, path, n_movers: 4, ..options(1902) };
        let (fine, coarse) = (walk(&o).unwrap(), walk(&WalkOptions { width_px: 634, ..o }).unwrap());
        for k in [3, 20, 33] {
            let (a, b) = (render_ranges(&fine, k).unwrap(), render_ranges(&coarse, k).unwrap());
            let pairs = b.iter().enumerate().map(|(i, &b)| (a[1902 * (3 * (i / 634) + 1) + 3 * (i % 634) + 1], b));
            // posts and crowns have other shares of larger pixels: their outlines differ, a tile never does
            let differ: Vec<bool> = pairs
                .map(|(a, b)| a != b && (a.is_infinite() != b.is_infinite() || (a - b).abs() > 1e-4 * b))
                .collect();
            assert!(differ.iter().filter(|&&d| d).count() < differ.len() / 100);
            let solid = |i: usize| (0..5).all(|row| (0..5).all(|column| differ[i + 634 * row + column]));
            assert!((0..differ.len() - 5 * 634).filter(|i| i % 634 < 629).all(|i| !solid(i)));
        }
    }
}

#[test]
fn places_that_are_built_alike_do_not_look_alike() {
    // patches of the pavement and of walls are compared with others a slab, a window or a bay further on
    let street = walk(&options(1024)).unwrap();
    let (frame, ranges) = (render_frame(&street, 20).unwrap(), render_ranges(&street, 20).unwrap());
    let patch = |at: &Vector<3>, axes: [usize; 2], size: f64| -> Option<Vec<f64>> {
        let mut values = Vec::new();
        for i in 0..144 {
            let mut point = *at;
            point[axes[0]] += size * (f64::from(i % 12) - 5.5) / 12.0;
            point[axes[1]] += size * (f64::from(i / 12) - 5.5) / 12.0;
            let pixel = pixel_of(&street, 20, &point);
            let range = norm(&sub(&point, &street.centers[20]));
            if (range_at(&street, &ranges, pixel) / range - 1.0).abs() > 0.03 {
                return None;
            }
            values.push(brightness(&street, &frame, pixel));
        }
        let mean = values.iter().sum::<f64>() / 144.0;
        values.iter_mut().for_each(|v| *v -= mean);
        let length = values.iter().map(|v| v * v).sum::<f64>().sqrt();
        (length > 24.0).then(|| values.iter().map(|v| v / length).collect())
    };
    let [x, y, _] = street.centers[20];
    let ground = (0..30).map(|i| ([x - 3.0 + 0.2 * f64::from(i), y, 0.0], [0, 1], 0.7));
    let wall = (0..30).map(|i| ([x - 6.0 + 0.4 * f64::from(i), 8.0, 5.0], [0, 2], 1.5));
    for (name, places) in [("ground", ground.collect::<Vec<_>>()), ("wall", wall.collect())] {
        let patches: Vec<_> = places.iter().filter_map(|(at, axes, size)| patch(at, *axes, *size)).collect();
        assert!(patches.len() > 10, "{} patches of {name}", patches.len());
        let mut alike = Vec::new();
        for (i, a) in patches.iter().enumerate() {
            // neighbours share a part of what they show
            alike.extend(patches.iter().skip(i + 4).map(|b| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>()));
        }
        let most = alike.iter().copied().fold(-1.0, f64::max);
        assert!(most < 0.9, "two patches of {name} correlate by {most}");
    }
}

#[test]
fn a_point_of_the_world_keeps_its_colour_from_frame_to_frame() {
    let street = walk(&WalkOptions { rotation: WalkRotation::Tumble, ..options(1024) }).unwrap();
    let (k, l) = (10, 11);
    let frames = [render_frame(&street, k).unwrap(), render_frame(&street, l).unwrap()];
    let ranges = [render_ranges(&street, k).unwrap(), render_ranges(&street, l).unwrap()];
    let (mut differences, mut shifted) = (Vec::new(), Vec::new());
    for i in (0..ranges[0].len()).step_by(37).filter(|&i| ranges[0][i] < 12.0) {
        let point = point_of(&street, k, i % 1024, i / 1024, ranges[0][i]);
        let seen = pixel_of(&street, l, &point);
        let range = norm(&sub(&point, &street.centers[l]));
        if (range_at(&street, &ranges[1], seen) / range - 1.0).abs() > 0.01 {
            continue;
        }
        let own = frames[0][3 * i..][..3].iter().map(|&v| f64::from(v)).sum::<f64>() / 3.0;
        differences.push((own - brightness(&street, &frames[1], seen)).abs());
        shifted.push((own - brightness(&street, &frames[1], [seen[0] + 3.0, seen[1] + 3.0])).abs());
    }
    assert!(differences.len() > 3000);
    let (here, beside) = (median(differences), median(shifted));
    assert!(here < 2.5 && here < 0.4 * beside, "{here} gray values off in place, {beside} beside it");
}

#[test]
fn frames_are_the_same_on_any_number_of_threads() {
    let film = |threads: usize, seed: u64| {
        let o = WalkOptions { n_movers: 3, operator_share: 0.1, noise_gray: 2.0, seed, ..options(256) };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| render_frame(&walk(&o).unwrap(), 7).unwrap())
    };
    let once = film(1, 3);
    assert_eq!(once.len(), 256 * 128 * 3);
    assert!(once == film(3, 3));
    assert!(once != film(1, 4));
}

#[test]
fn there_is_no_seam_and_poles_have_one_colour() {
    for rotation in [WalkRotation::Sway, WalkRotation::Tumble] {
        let street = walk(&WalkOptions { rotation, ..options(1024) }).unwrap();
        let frame = render_frame(&street, 9).unwrap();
        let step = |x: usize| {
            let difference = |y: usize| {
                let at = |x: usize| f64::from(frame[3 * (y * 1024 + x % 1024) + 1]);
                (at(x) - at(x + 1)).abs()
            };
            (0..512).map(difference).sum::<f64>() / 512.0
        };
        let usual = median((0..1023).map(step).collect());
        assert!(step(1023) < 2.5 * usual + 1.0, "{} at the seam, {usual} elsewhere", step(1023));
        for row in [0, 511] {
            let row = &frame[3 * 1024 * row..][..3 * 1024];
            let green: Vec<u8> = row.iter().skip(1).step_by(3).copied().collect();
            let spread = green.iter().max().unwrap() - green.iter().min().unwrap();
            assert!(spread <= 30, "{spread} gray values round a pole");
        }
    }
}

#[test]
fn a_frame_is_the_mean_of_a_finer_one() {
    let fine = walk(&options(1024)).unwrap();
    let coarse = walk(&options(512)).unwrap();
    let (a, b) = (render_frame(&fine, 12).unwrap(), render_frame(&coarse, 12).unwrap());
    let mut differences = Vec::new();
    for y in 0..256 {
        for x in 0..512 {
            let at = |dx: usize, dy: usize| f64::from(a[3 * ((2 * y + dy) * 1024 + 2 * x + dx) + 1]);
            let mean = 0.25 * (at(0, 0) + at(0, 1) + at(1, 0) + at(1, 1));
            differences.push((mean - f64::from(b[3 * (y * 512 + x) + 1])).abs());
        }
    }
    let mean = differences.iter().sum::<f64>() / differences.len() as f64;
    assert!(mean < 4.0, "{mean} gray values");
}

#[test]
fn the_operator_covers_the_share_asked_for() {
    let street = walk(&WalkOptions { operator_share: 0.2, rotation: WalkRotation::Tumble, ..options(512) }).unwrap();
    for k in [0, 17] {
        let ranges = render_ranges(&street, k).unwrap();
        let area = |y: usize| (std::f64::consts::PI * (y as f64 + 0.5) / 256.0).sin();
        let covered = |y: usize| ranges[y * 512..(y + 1) * 512].iter().filter(|r| r.is_nan()).count() as f64;
        let share =
            (0..256).map(|y| area(y) * covered(y)).sum::<f64>() / (0..256).map(|y| 512.0 * area(y)).sum::<f64>();
        assert!((share - 0.2).abs() < 0.003, "{share}");
    }
}

#[test]
fn cars_pass_and_leave_the_rest_alone() {
    let still = walk(&options(256)).unwrap();
    let busy = walk(&WalkOptions { n_movers: 8, ..options(256) }).unwrap();
    let mut frames_with_cars = 0;
    for k in (0..40).step_by(3) {
        let (a, b) = (render_ranges(&still, k).unwrap(), render_ranges(&busy, k).unwrap());
        let changed = a.iter().zip(&b).filter(|(a, b)| a != b).count();
        assert!(a.iter().zip(&b).all(|(a, b)| b <= a), "a car can only hide what is behind it");
        frames_with_cars += usize::from(changed > 80);
    }
    assert!(frames_with_cars >= 5, "{frames_with_cars} of 14");
}

#[test]
fn exposure_and_noise_are_as_large_as_asked_for() {
    let o = options(256);
    let plain = walk(&o).unwrap();
    let drifting = walk(&WalkOptions { exposure_drift_stops: 2.0, ..o.clone() }).unwrap();
    let mean = |frame: &[u8]| frame.iter().map(|&v| f64::from(v)).sum::<f64>() / frame.len() as f64;
    let gain = |k: usize| mean(&render_frame(&drifting, k).unwrap()) / mean(&render_frame(&plain, k).unwrap());
    let gains: Vec<f64> = (0..40).step_by(3).map(gain).collect();
    let (low, high) = (gains.iter().copied().fold(9.0, f64::min), gains.iter().copied().fold(0.0, f64::max));
    // two stops are a factor of 2^(2 / 2.2) = 1.88 in values; the brightest saturate
    assert!((1.45..1.95).contains(&(high / low)), "{low} to {high}");

    let noisy = walk(&WalkOptions { noise_gray: 5.0, ..o }).unwrap();
    let (a, b) = (render_frame(&plain, 3).unwrap(), render_frame(&noisy, 3).unwrap());
    let kept = a.iter().zip(&b).filter(|(a, _)| (30..225).contains(*a));
    let squares: Vec<f64> = kept.map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2)).collect();
    let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    assert!((rms - 5.0).abs() < 0.2, "{rms}");
}

#[test]
fn paths_lead_where_they_say() {
    let many =
        |path| WalkOptions { path, rotation: WalkRotation::None, n_frames: 600, frame_rate_hz: 4.0, ..options(64) };
    let lap = Walk::lap_m();
    assert!((lap - 200.0).abs() < 5.0, "{lap}");
    let round = walk(&many(WalkPath::Loop)).unwrap();
    let after_lap = (lap / (1.4 / 4.0)).round() as usize;
    assert!(norm(&sub(&round.centers[after_lap], &round.centers[0])) < 0.8);
    assert!(norm(&sub(&round.centers[after_lap / 2], &round.centers[0])) > 50.0);
    let upright = &round.cam_from_world[0];
    assert!(round.cam_from_world.iter().all(|r| r == upright));
    // z is forward, along the world's x; y is down
    assert!(angle_between(&upright.apply(&[1.0, 0.0, 0.0]), &[0.0, 0.0, 1.0]) < 1e-12);
    assert!(angle_between(&upright.apply(&[0.0, 0.0, -1.0]), &[0.0, 1.0, 0.0]) < 1e-12);

    let corner = walk(&WalkOptions { n_frames: 100, ..many(WalkPath::Corner) }).unwrap();
    let leg = |k: usize| sub(&corner.centers[k + 10], &corner.centers[k]);
    assert!((angle_between(&leg(5), &leg(80)) - std::f64::consts::FRAC_PI_2).abs() < 0.15);
    for path in [WalkPath::Straight, WalkPath::Corner, WalkPath::Loop] {
        let centers = walk(&many(path)).unwrap().centers;
        let steps = centers.windows(2).map(|pair| norm(&sub(&pair[1], &pair[0])));
        assert!(steps.into_iter().all(|step| (0.2..0.55).contains(&step)));
    }
}

#[test]
fn the_camera_turns_as_asked() {
    let turned = |rotation| walk(&WalkOptions { rotation, n_frames: 400, frame_rate_hz: 10.0, ..options(64) }).unwrap();
    let down = |r: &Rotation<3>| angle_between(&r.apply(&[0.0, 0.0, -1.0]), &[0.0, 1.0, 0.0]);
    let sway = turned(WalkRotation::Sway);
    let most = sway.cam_from_world.iter().map(down).fold(0.0, f64::max);
    assert!((0.03..0.2).contains(&most), "{most}");
    let tumble = turned(WalkRotation::Tumble);
    assert!(tumble.cam_from_world.iter().map(down).fold(0.0, f64::max) > 2.8);
    let steps = tumble.cam_from_world.windows(2).map(|pair| norm(&pair[1].compose(&pair[0].inverse()).log()));
    assert!(steps.into_iter().all(|step| (0.005..0.12).contains(&step)));
}

#[test]
fn options_out_of_range_are_named() {
    let refused = |o: WalkOptions, name: &str| {
        let message = walk(&o).err().unwrap().to_string();
        assert!(message.starts_with(name), "{message}");
    };
    refused(WalkOptions { width_px: 63, ..options(64) }, "width_px is 63");
    refused(WalkOptions { width_px: 20_000, ..options(64) }, "width_px");
    refused(WalkOptions { n_frames: 0, ..options(64) }, "n_frames is 0");
    refused(WalkOptions { operator_share: 0.6, ..options(64) }, "operator_share is 0.6");
    refused(WalkOptions { noise_gray: f64::NAN, ..options(64) }, "noise_gray is NaN");
    refused(WalkOptions { exposure_drift_stops: -1.0, ..options(64) }, "exposure_drift_stops");
    refused(WalkOptions { frame_rate_hz: 0.0, ..options(64) }, "frame_rate_hz is 0");
    refused(WalkOptions { speed_m_s: f64::INFINITY, ..options(64) }, "speed_m_s");
    refused(WalkOptions { n_movers: 101, ..options(64) }, "n_movers");
    refused(WalkOptions { n_frames: 100_000, ..options(64) }, "length of the walk");
    let street = walk(&options(64)).unwrap();
    assert!(render_frame(&street, 40).unwrap_err().to_string().starts_with("frame is 40"));
    assert!(render_ranges(&street, 40).is_err());
    assert!("circle".parse::<WalkPath>().is_err() && "roll".parse::<WalkRotation>().is_err());
    let one = walk(&WalkOptions { n_frames: 1, speed_m_s: 0.0, n_movers: 2, ..options(64) }).unwrap();
    assert_eq!(render_frame(&one, 0).unwrap().len(), 64 * 32 * 3);
}
