//! Worlds are what they say: exact without noise, with the statistics they promise, and the same every time.
#![allow(missing_docs, clippy::unwrap_used)]

use panopath::geometry::{Rotation, Vector, angle_between, dot, norm, normalized, sub, tangent_basis};
use panopath::synthetic::*;

const DEG: f64 = std::f64::consts::PI / 180.0;

fn options(n_views: usize, n_points: usize) -> WorldOptions {
    WorldOptions { n_views, n_points, seed: 7, ..Default::default() }
}

/// Angle between what was seen and where the point is, given the true orientations.
fn errors<const D: usize>(world: &World<D>, cam_from_world: &[Rotation<D>]) -> Vec<f64> {
    let tracks = &world.tracks;
    (0..tracks.len())
        .map(|o| {
            let (i, j) = (tracks.view()[o] as usize, tracks.track()[o] as usize);
            let seen = cam_from_world[i].apply(&normalized(&sub(&world.points[j], &world.centers[i])));
            angle_between(&seen, &tracks.bearing()[o])
        })
        .collect()
}

fn views_of_tracks<const D: usize>(world: &World<D>) -> Vec<Vec<usize>> {
    let mut views = vec![Vec::new(); world.points.len()];
    for (&view, &track) in world.tracks.view().iter().zip(world.tracks.track()) {
        views[track as usize].push(view as usize);
    }
    views
}

fn mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for value in values {
        sum += value;
        count += 1.0;
    }
    sum / count
}

fn check_exact<const D: usize>(kind: WorldKind, o: &WorldOptions) {
    let world = simulate::<D>(kind, o).unwrap();
    assert_eq!((world.centers.len(), world.points.len(), world.time_s.len()), (o.n_views, o.n_points, o.n_views));
    let worst = errors(&world, &world.cam_from_world).into_iter().fold(0.0, f64::max);
    assert!(worst < 1e-14, "{} in dimension {D}: {worst}", kind.name());
    assert!(world.outlier.iter().all(|&outlier| !outlier));
    for (track, views) in views_of_tracks(&world).iter().enumerate() {
        assert!(views.len() >= 2, "{}: track {track} is seen {} times", kind.name(), views.len());
        assert!(views.windows(2).all(|pair| pair[0] < pair[1]), "{}: sorted, no view twice", kind.name());
    }
}

#[test]
fn every_world_is_exact_in_each_of_its_dimensions() {
    for kind in WorldKind::all() {
        for orientations in [Orientations::Identity, Orientations::Random] {
            let o = WorldOptions { orientations, ..options(40, 300) };
            for &dimension in kind.dimensions() {
                if dimension == 2 { check_exact::<2>(kind, &o) } else { check_exact::<3>(kind, &o) }
            }
        }
    }
}

#[test]
fn few_views_and_points_are_enough() {
    for kind in WorldKind::all() {
        let o = if kind == WorldKind::Weak { options(4, 20) } else { options(2, 1) };
        if kind.dimensions()[0] == 2 {
            check_exact::<2>(kind, &o)
        } else {
            check_exact::<3>(kind, &o)
        }
        if kind != WorldKind::Weak && kind != WorldKind::Ellipse {
            assert_eq!(simulate::<3>(kind, &options(1, 3)).unwrap().tracks.len(), 3, "{}", kind.name());
        }
    }
}

#[test]
fn street_has_the_promised_statistics() {
    let world = simulate::<3>(WorldKind::Street, &options(100, 10_000)).unwrap();
    let views = views_of_tracks(&world);
    let per_track = mean(views.iter().map(|views| views.len() as f64));
    assert!((per_track - 8.2).abs() < 0.1, "{per_track} observations a track");
    assert_eq!(views.iter().map(Vec::len).min(), Some(3));
    assert_eq!(views.iter().map(Vec::len).max(), Some(15));
    let mut depths = Vec::new();
    let mut around_the_end = 0;
    for (point, views) in world.points.iter().zip(&views) {
        let gaps: Vec<_> = views.windows(2).map(|pair| pair[1] - pair[0]).filter(|&gap| gap != 1).collect();
        assert!(gaps.len() <= 1, "consecutive around the loop: {views:?}");
        around_the_end += gaps.len();
        let start = views.windows(2).position(|pair| pair[1] - pair[0] != 1).map_or(views[0], |k| views[k + 1]);
        let ray = sub(point, &world.centers[(start + views.len() / 2) % 100]);
        let elevation_rad = (ray[2] / norm(&ray)).asin();
        assert!((-25.0 * DEG..60.0 * DEG).contains(&elevation_rad), "{elevation_rad}");
        depths.push((norm(&ray), views.len()));
    }
    assert!(around_the_end > 300, "the loop closes: {around_the_end} tracks go around its end");
    check_depths(&depths);
    for i in 0..100 {
        let step = norm(&sub(&world.centers[(i + 1) % 100], &world.centers[i]));
        assert!((0.7..1.3).contains(&step), "views are 1 m apart: {step}");
    }
}

/// Log-uniform from 1 to 200, and near points seen by fewer.
fn check_depths(depths: &[(f64, usize)]) {
    for share in [0.1, 0.25, 0.5, 0.75, 0.9] {
        let below = mean(depths.iter().map(|(depth, _)| f64::from(*depth < 200.0_f64.powf(share))));
        assert!((below - share).abs() < 0.02, "share {share} of the logarithmic range: {below}");
    }
    assert!(depths.iter().all(|(depth, _)| (1.0 - 1e-9..200.0 + 1e-9).contains(depth)));
    let seen = |near: f64, far: f64| {
        mean(depths.iter().filter(|(depth, _)| (near..far).contains(depth)).map(|(_, count)| *count as f64))
    };
    assert!(seen(1.0, 3.0) < 5.0 && seen(80.0, 200.0) > 13.0);
}

#[test]
fn room_points_lie_on_its_walls_and_are_seen_on_revisits() {
    let world = simulate::<3>(WorldKind::Room, &options(1000, 5000)).unwrap();
    let views = views_of_tracks(&world);
    let per_track = mean(views.iter().map(|views| views.len() as f64));
    assert!((per_track - 9.0).abs() < 0.2, "{per_track} observations a track");
    let sides = [8.0, 6.0, 2.6];
    let mut on_wall = [[0; 2]; 3];
    for point in &world.points {
        assert!((0..3).all(|c| (0.0..=sides[c]).contains(&point[c])));
        let (c, far) = (0..3).flat_map(|c| [(c, 0), (c, 1)]).find(|&(c, f)| point[c] == sides[c] * f as f64).unwrap();
        on_wall[c][far] += 1;
    }
    assert!(on_wall.iter().flatten().all(|&count| count > 200), "{on_wall:?}");
    for center in &world.centers {
        assert!((0..3).all(|c| center[c] > 0.2 && center[c] < sides[c] - 0.2), "{center:?}");
    }
    let mut revisits = 0;
    for views in &views {
        let spread = views.iter().flat_map(|&a| views.iter().map(move |&b| (a, b)));
        let widest = spread.map(|(a, b)| norm(&sub(&world.centers[a], &world.centers[b]))).fold(0.0, f64::max);
        assert!(widest <= 2.0 + 1e-12, "views of a track are near one another: {widest}");
        revisits += usize::from(views[views.len() - 1] - views[0] > 100);
    }
    assert!(revisits > 3500, "{revisits} tracks are seen again much later");
}

#[test]
fn paths_have_their_shapes() {
    let line = simulate::<3>(WorldKind::Line, &options(50, 500)).unwrap();
    assert!(line.centers.iter().all(|c| c[1] == 0.0 && c[2] == 0.0));
    assert!(line.points.iter().all(|p| p[1].hypot(p[2]) > 0.15), "no point on the line");

    let stop = simulate::<3>(WorldKind::StopAndGo, &options(90, 500)).unwrap();
    let still = stop.centers.windows(2).filter(|pair| pair[0] == pair[1]).count();
    assert_eq!(still, 30, "6 pauses of 5 views");

    let chain = simulate::<3>(WorldKind::Chain, &options(3000, 9000)).unwrap();
    let reach = norm(&sub(&chain.centers[2999], &chain.centers[0]));
    assert!(reach > 2000.0, "{reach}");
    assert!(views_of_tracks(&chain).iter().all(|v| v[v.len() - 1] - v[0] + 1 == v.len()), "never closes");

    let corridor = simulate::<3>(WorldKind::Corridor, &options(100, 1000)).unwrap();
    let on_side =
        |p: &Vector<3>| (p[1].abs() - 1.5).abs() < 1e-12 || (p[2] + 1.6).abs() < 1e-12 || (p[2] - 1.0).abs() < 1e-12;
    assert!(corridor.points.iter().all(on_side));
    assert!(corridor.points.iter().any(|p| p[1] == 1.5) && corridor.points.iter().any(|p| p[2] == 1.0));

    let boxed =
        simulate::<2>(WorldKind::Box, &WorldOptions { visible_fraction: Some(0.3), ..options(40, 3000) }).unwrap();
    let seen = boxed.tracks.len() as f64 / (40.0 * 3000.0);
    assert!((seen - 0.3).abs() < 0.01, "{seen}");
    let full = simulate::<3>(WorldKind::Box, &options(10, 50)).unwrap();
    assert_eq!(full.tracks.len(), 500);
}

type Equation = fn([f64; 2]) -> f64;

#[test]
fn conics_satisfy_their_equations() {
    let equations: [(Conic, Equation); 4] = [
        (Conic::Ellipse, |[x, y]| x * x / 4.0 + y * y - 1.0),
        (Conic::Circle, |[x, y]| x * x + y * y - 1.0),
        (Conic::Parabola, |[x, y]| x * x - y),
        (Conic::Hyperbola, |[x, y]| x * x - y * y - 1.0),
    ];
    for (conic, equation) in equations {
        let o = WorldOptions { conic: Some(conic), ..options(10, 20) };
        let on = simulate::<2>(WorldKind::Ellipse, &o).unwrap();
        assert!(on.centers.iter().chain(&on.points).all(|p| equation(*p).abs() < 1e-12), "{conic:?}");
        let off = simulate::<2>(WorldKind::Ellipse, &WorldOptions { off_conic: Some(0.1), ..o }).unwrap();
        assert_eq!(off.centers, on.centers);
        assert!(mean(off.points.iter().map(|p| equation(*p).abs())) > 0.02, "{conic:?}");
    }
    let cylinder = simulate::<3>(WorldKind::Cylinder, &options(10, 20)).unwrap();
    let everything = || cylinder.centers.iter().chain(&cylinder.points);
    assert!(everything().all(|p| (p[0] * p[0] / 4.0 + p[1] * p[1] - 1.0).abs() < 1e-12));
    assert!(everything().any(|p| p[2] > 0.5) && everything().any(|p| p[2] < -0.5));
}

#[test]
fn weak_graphs_hang_together_by_what_was_asked_for() {
    let o = WorldOptions { n_clusters: Some(3), n_links: Some(2), ..options(30, 304) };
    let world = simulate::<3>(WorldKind::Weak, &o).unwrap();
    let across = |views: &Vec<usize>| views[0] / 10 != views[views.len() - 1] / 10;
    let views = views_of_tracks(&world);
    assert!(views[..300].iter().all(|views| !across(views) && views.len() >= 3));
    for (link, views) in views[300..].iter().enumerate() {
        assert_eq!(views.len(), 2);
        assert_eq!([views[0] / 10, views[1] / 10], [link / 2, link / 2 + 1]);
    }
    assert!(views[300][0] != views[301][0] && views[300][1] != views[301][1], "independent links");

    let o = WorldOptions { weak_mode: Some(WeakMode::Chain), ..options(11, 100) };
    let chain = simulate::<3>(WorldKind::Weak, &o).unwrap();
    for (track, views) in views_of_tracks(&chain).iter().enumerate() {
        assert_eq!(*views, [track % 10, track % 10 + 1]);
    }
}

#[test]
fn noise_is_an_isotropic_gaussian_of_the_tangent_plane() {
    let noise_rad = 0.01;
    let o = WorldOptions { noise_rad, orientations: Orientations::Random, ..options(100, 10_000) };
    let world = simulate::<3>(WorldKind::Street, &o).unwrap();
    let errors_rad = errors(&world, &world.cam_from_world);
    let n = errors_rad.len() as f64;
    let per_axis = (errors_rad.iter().map(|e| e * e).sum::<f64>() / (2.0 * n)).sqrt();
    assert!((per_axis / noise_rad - 1.0).abs() < 0.01, "{per_axis}");
    // Rayleigh: the share within k sigma is 1 - exp(-k^2 / 2)
    for k in [0.5, 1.0, 2.0, 3.0_f64] {
        let within = mean(errors_rad.iter().map(|e| f64::from(*e < k * noise_rad)));
        assert!((within - (1.0 - (-k * k / 2.0).exp())).abs() < 0.01, "{k}: {within}");
    }
    let moments = moments(&world);
    assert!(moments.iter().all(|moment| moment.abs() < 0.015), "no preferred tangent direction: {moments:?}");

    // large angles tell the exponential map from a projected tangent vector
    for noise_rad in [0.01, 0.5] {
        let o = WorldOptions { noise_rad, ..o.clone() };
        let (plane, space) =
            (simulate::<2>(WorldKind::Street, &o).unwrap(), simulate::<3>(WorldKind::Street, &o).unwrap());
        let in_plane = mean(errors(&plane, &plane.cam_from_world).iter().map(|e| e * e)).sqrt();
        let in_space = (mean(errors(&space, &space.cam_from_world).iter().map(|e| e * e)) / 2.0).sqrt();
        assert!((in_plane / noise_rad - 1.0).abs() < 0.01, "{in_plane}");
        assert!((in_space / noise_rad - 1.0).abs() < 0.01, "{in_space}");
    }
}

/// Means of x, y, x y and (x^2 - y^2) / 2 over the noise's tangent coordinates, in units of the deviation; 0 if isotropic.
fn moments(world: &World<3>) -> [f64; 4] {
    let tracks = &world.tracks;
    let mut sums = [0.0; 4];
    for o in 0..tracks.len() {
        let (i, j) = (tracks.view()[o] as usize, tracks.track()[o] as usize);
        let truth = world.cam_from_world[i].apply(&normalized(&sub(&world.points[j], &world.centers[i])));
        let [x, y] = tangent_basis(&truth).map(|axis| dot(&tracks.bearing()[o], &axis) / world.noise_rad);
        for (sum, moment) in sums.iter_mut().zip([x, y, x * y, (x * x - y * y) / 2.0]) {
            *sum += moment / tracks.len() as f64;
        }
    }
    sums
}

#[test]
fn uniform_outliers_have_their_share_and_point_anywhere() {
    let o = WorldOptions { outlier_fraction: 0.2, ..options(100, 10_000) };
    let world = simulate::<3>(WorldKind::Street, &o).unwrap();
    let share = mean(world.outlier.iter().map(|&outlier| f64::from(outlier)));
    assert!((share - 0.2).abs() < 0.006, "{share}");
    let mut height = Vec::new();
    for (o, error_rad) in errors(&world, &world.cam_from_world).iter().enumerate() {
        if world.outlier[o] {
            height.push(world.tracks.bearing()[o][2]);
        } else {
            assert!(*error_rad < 1e-14);
        }
    }
    // Archimedes: the height of a uniform direction is uniform
    for level in [-0.8, -0.4, 0.0, 0.4, 0.8] {
        let below = mean(height.iter().map(|h| f64::from(*h < level)));
        assert!((below - (level + 1.0) / 2.0).abs() < 0.02, "{level}: {below}");
    }
    let more = simulate::<3>(WorldKind::Street, &WorldOptions { outlier_fraction: 0.35, ..o }).unwrap();
    assert!(world.outlier.iter().zip(&more.outlier).all(|(few, many)| !few | many), "a larger share keeps them");
}

#[test]
fn movers_move_and_the_operator_is_carried_along() {
    let o = WorldOptions {
        mover_fraction: 0.2,
        operator_fraction: 0.1,
        orientations: Orientations::Random,
        ..options(100, 5000)
    };
    let world = simulate::<3>(WorldKind::Street, &o).unwrap();
    let tracks = &world.tracks;
    let (mut first_seen, mut kinds) = (vec![None; 5000], vec![[false; 2]; 5000]);
    for o in 0..tracks.len() {
        let j = tracks.track()[o] as usize;
        let seen = tracks.bearing()[o];
        let constant = angle_between(first_seen[j].get_or_insert(seen), &seen) < 1e-12;
        kinds[j] = [world.outlier[o], constant];
    }
    let carried = kinds.iter().filter(|&&[outlier, constant]| outlier && constant).count();
    let moving = kinds.iter().filter(|&&[outlier, constant]| outlier && !constant).count();
    assert!((carried as f64 / 5000.0 - 0.1).abs() < 0.015, "{carried}");
    assert!((moving as f64 / 5000.0 - 0.2).abs() < 0.02, "{moving}");
    let wrong = errors(&world, &world.cam_from_world);
    let wrong_of_outliers = mean(wrong.iter().zip(&world.outlier).filter(|(_, out)| **out).map(|(e, _)| *e));
    assert!(wrong_of_outliers > 5.0 * DEG, "{wrong_of_outliers}");
    assert!(wrong.iter().zip(&world.outlier).all(|(error, outlier)| *outlier || *error < 1e-14));
}

/// All points of the mover share one velocity: two rays of a track fix it together with the recorded position.
#[test]
fn the_mover_is_one_body() {
    let o = WorldOptions { mover_fraction: 1.0, mover_speed_m_s: 1.2, ..options(60, 300) };
    let world = simulate::<3>(WorldKind::Chain, &o).unwrap();
    let mut velocities: Vec<Vector<3>> = Vec::new();
    for (track, views) in views_of_tracks(&world).iter().enumerate() {
        let start = world.tracks.track().iter().position(|&t| t as usize == track).unwrap();
        let ray = |k: usize| world.tracks.bearing()[start + k];
        let along = |k: usize| normalized(&sub(&world.points[track], &world.centers[views[k]]));
        let anchor = (0..views.len()).find(|&k| angle_between(&ray(k), &along(k)) < 1e-12);
        let anchor = anchor.unwrap_or_else(|| panic!("track {track}: one view sees the recorded position"));
        let other = if anchor == 0 { views.len() - 1 } else { 0 };
        let elapsed_s = world.time_s[views[other]] - world.time_s[views[anchor]];
        velocities.push(velocity_on_ray(&world.points[track], &world.centers[views[other]], &ray(other), elapsed_s));
    }
    let expected = velocities.iter().find(|v| norm(&sub(v, &velocities[0])) < 1e-6).unwrap();
    let agreeing = velocities.iter().filter(|v| norm(&sub(v, expected)) < 1e-6).count();
    assert!(agreeing == 300, "{agreeing} of 300 share a velocity");
    assert!((norm(expected) - 1.2).abs() < 1e-9);
}

/// The horizontal velocity that takes `point` onto the ray from `center` in `elapsed_s`.
fn velocity_on_ray(point: &Vector<3>, center: &Vector<3>, ray: &Vector<3>, elapsed_s: f64) -> Vector<3> {
    // a horizontal motion keeps the height, which gives the distance along the ray
    let distance = (point[2] - center[2]) / ray[2];
    std::array::from_fn(|c| (center[c] + distance * ray[c] - point[c]) / elapsed_s)
}

/// Where each track's point is at a time, by what the world says of its motion.
fn position_at<const D: usize>(world: &World<D>, track: usize, time_s: f64) -> Vector<D> {
    let since_s = time_s - world.point_time_s[track];
    match world.motion[track] {
        Motion::Moves { velocity, acceleration, .. } => std::array::from_fn(|c| {
            world.points[track][c] + since_s * velocity[c] + 0.5 * since_s * since_s * acceleration[c]
        }),
        _ => world.points[track],
    }
}

fn check_bodies<const D: usize>(kind: WorldKind) {
    let o =
        WorldOptions { mover_fraction: 0.3, n_bodies: 25, orientations: Orientations::Random, ..options(120, 4000) };
    let world = simulate::<D>(kind, &o).unwrap();
    let tracks = &world.tracks;
    for o in 0..tracks.len() {
        let (i, j) = (tracks.view()[o] as usize, tracks.track()[o] as usize);
        let ray = sub(&position_at(&world, j, world.time_s[i]), &world.centers[i]);
        let error_rad = angle_between(&world.cam_from_world[i].apply(&normalized(&ray)), &tracks.bearing()[o]);
        assert!(error_rad < 1e-13, "{} in dimension {D}, track {j}: {error_rad}", kind.name());
        assert!(!world.outlier[o]);
        assert!(norm(&ray) > 1.0 || world.motion[j] == Motion::Still, "nothing drives through the camera");
    }
    let views = views_of_tracks(&world);
    let (mut riders, mut speeds) = (vec![Vec::new(); 25], Vec::new());
    for (j, motion) in world.motion.iter().enumerate() {
        let &Motion::Moves { body, velocity, acceleration } = motion else { continue };
        riders[body as usize].push(j);
        speeds.push(norm(&velocity));
        assert!(views[j].len() >= 6 && views[j][views[j].len() - 1] - views[j][0] + 1 == views[j].len());
        assert!(norm(&acceleration) == 0.0 || norm(&velocity) < 2.6, "cars drive straight");
    }
    let share = speeds.len() as f64 / 4000.0;
    assert!((share - 0.3).abs() < 0.03, "{share}");
    assert!(speeds.iter().all(|v| (0.9..2.6).contains(v) || (3.0..14.0).contains(v)), "{speeds:?}");
    assert!(riders.iter().all(|tracks| tracks.len() > 10), "about as many on each");
    for tracks in &riders {
        // rigid: what is between two of its points never changes
        let between =
            |a: usize, b: usize, time_s: f64| sub(&position_at(&world, a, time_s), &position_at(&world, b, time_s));
        for pair in tracks.windows(2) {
            let (early, late) = (between(pair[0], pair[1], 0.0), between(pair[0], pair[1], 100.0));
            assert!(norm(&sub(&early, &late)) < 1e-9 && norm(&early) < 5.5, "{early:?} {late:?}");
        }
    }
}

#[test]
fn many_bodies_are_rigid_near_and_seen_exactly() {
    for kind in [WorldKind::Street, WorldKind::Corridor, WorldKind::Line, WorldKind::StopAndGo, WorldKind::Chain] {
        check_bodies::<2>(kind);
        check_bodies::<3>(kind);
    }
}

/// Cars and people leave all else as it is, noise and false directions too, and more movers keep the ones there were.
#[test]
fn bodies_have_a_stream_of_their_own() {
    let still = WorldOptions { noise_rad: 1e-3, outlier_fraction: 0.2, ..options(60, 800) };
    let few = WorldOptions { mover_fraction: 0.2, n_bodies: 8, ..still.clone() };
    let more = WorldOptions { mover_fraction: 0.4, ..few.clone() };
    let [still, few, more] = [still, few, more].map(|o| simulate::<3>(WorldKind::Street, &o).unwrap());
    assert_eq!(still.centers, few.centers);
    let (mut moving, mut kept) = (0, 0);
    for j in 0..800 {
        match few.motion[j] {
            Motion::Still => assert_eq!(still.points[j], few.points[j]),
            motion => {
                moving += 1;
                kept += usize::from(motion == more.motion[j] && few.points[j] == more.points[j]);
            }
        }
    }
    assert!(moving > 100 && kept == moving, "{kept} of {moving}");
    let share = mean(few.outlier.iter().map(|&outlier| f64::from(outlier)));
    assert!((share - 0.2).abs() < 0.03, "only false directions: {share}");
}

#[test]
fn bodies_in_tiny_worlds() {
    for n_views in [1, 2, 3, 7] {
        for frame_interval_s in [1e-3, 1.0, 1e4] {
            let o = WorldOptions { mover_fraction: 1.0, n_bodies: 3, frame_interval_s, ..options(n_views, 20) };
            let world = simulate::<3>(WorldKind::Street, &o).unwrap();
            assert!(world.motion.iter().all(|motion| matches!(motion, Motion::Moves { .. })));
            assert!(views_of_tracks(&world).iter().all(|views| views.len() >= n_views.min(6)));
        }
    }
}

#[test]
fn points_go_to_infinity_along_their_rays() {
    let o = WorldOptions { infinity_fraction: 0.8, ..options(100, 5000) };
    let world = simulate::<3>(WorldKind::Street, &o).unwrap();
    let near = simulate::<3>(WorldKind::Street, &options(100, 5000)).unwrap();
    let far: Vec<_> = world.points.iter().filter(|p| norm(p) > 9e4).collect();
    assert!((far.len() as f64 / 5000.0 - 0.8).abs() < 0.02, "{}", far.len());
    assert!(far.iter().all(|p| norm(p) < 1.1e6));
    let kept = world.points.iter().zip(&near.points).filter(|(a, b)| a == b).count();
    assert_eq!(kept + far.len(), 5000);
    let exactly = WorldOptions { infinity_fraction: 1.0, infinity_distance: (1e17, 1e17), ..options(30, 100) };
    let world = simulate::<3>(WorldKind::Street, &exactly).unwrap();
    let mut first_seen = vec![None; 100];
    for o in 0..world.tracks.len() {
        let seen = world.tracks.bearing()[o];
        let first = first_seen[world.tracks.track()[o] as usize].get_or_insert(seen);
        assert!(angle_between(first, &seen) < 1e-15);
    }
}

#[test]
fn orientation_error_turns_what_is_returned_only() {
    let truth = WorldOptions { orientations: Orientations::Random, ..options(2000, 2000) };
    let exact = simulate::<3>(WorldKind::Street, &truth).unwrap();
    let o = WorldOptions { orientation_error_rad: 0.01, ..truth };
    let off = simulate::<3>(WorldKind::Street, &o).unwrap();
    assert_eq!(exact.tracks, off.tracks);
    let squared = exact.cam_from_world.iter().zip(&off.cam_from_world).map(|(exact, off)| {
        // trace = 1 + 2 cos(angle)
        let m = *off.compose(&exact.inverse()).matrix();
        (f64::acos((m[0][0] + m[1][1] + m[2][2] - 1.0) / 2.0)).powi(2)
    });
    let per_axis = (mean(squared) / 3.0).sqrt();
    assert!((per_axis / 0.01 - 1.0).abs() < 0.04, "{per_axis}");
    let plane = simulate::<2>(WorldKind::Street, &o).unwrap();
    let exact = simulate::<2>(WorldKind::Street, &WorldOptions { orientation_error_rad: 0.0, ..o }).unwrap();
    let squared = exact.cam_from_world.iter().zip(&plane.cam_from_world).map(|(exact, off)| {
        let m = *off.compose(&exact.inverse()).matrix();
        m[1][0].atan2(m[0][0]).powi(2)
    });
    assert!((mean(squared).sqrt() / 0.01 - 1.0).abs() < 0.06);
}

#[test]
fn angle_errors_are_uniform_in_each_angle() {
    let o = options(40, 200);
    let exact = simulate::<3>(WorldKind::Box, &o).unwrap();
    let off = simulate::<3>(WorldKind::Box, &WorldOptions { angle_error_rad: 0.02, ..o.clone() }).unwrap();
    assert_eq!((&exact.centers, &exact.points), (&off.centers, &off.points));
    let angles = |v: &[f64; 3]| [v[1].atan2(v[0]), v[2].clamp(-1.0, 1.0).asin()];
    let pairs = exact.tracks.bearing().iter().zip(off.tracks.bearing()).map(|(a, b)| (angles(a), angles(b)));
    // a bearing near a pole may go over it, and leaves by the other side
    let away = pairs.filter(|(a, _)| a[1].abs() < 1.5);
    let errors: Vec<[f64; 2]> = away
        .map(|(a, b)| [0, 1].map(|k| b[k] - a[k]))
        .map(|[theta, phi]| [theta - std::f64::consts::TAU * (theta / std::f64::consts::TAU).round(), phi])
        .collect();
    for k in 0..2 {
        assert!(errors.iter().all(|e| e[k].abs() < 0.02 + 1e-9));
        let variance = mean(errors.iter().map(|e| e[k] * e[k]));
        assert!((variance / (0.02_f64.powi(2) / 3.0) - 1.0).abs() < 0.06, "{variance}");
    }
    assert!(mean(errors.iter().map(|e| e[0] * e[1])).abs() < 0.05 * 0.02_f64.powi(2));
}

#[test]
fn random_orientations_are_uniform() {
    let o = WorldOptions { orientations: Orientations::Random, ..options(20_000, 1) };
    let world = simulate::<3>(WorldKind::Box, &WorldOptions { max_views: Some(2), ..o }).unwrap();
    for r in 0..3 {
        for c in 0..3 {
            let entry = |rotation: &Rotation<3>| rotation.matrix()[r][c];
            // every entry is uniform in [-1, 1]
            assert!(mean(world.cam_from_world.iter().map(entry)).abs() < 0.02);
            assert!((mean(world.cam_from_world.iter().map(|q| entry(q).powi(2))) - 1.0 / 3.0).abs() < 0.01);
        }
    }
}

#[test]
fn same_seed_same_bytes_and_noise_leaves_the_scene_alone() {
    for kind in WorldKind::all().filter(|kind| *kind != WorldKind::Ellipse) {
        let o = options(30, 200);
        let world = simulate::<3>(kind, &o).unwrap();
        assert_eq!(world, simulate::<3>(kind, &o).unwrap());
        let other = simulate::<3>(kind, &WorldOptions { seed: 8, ..o.clone() }).unwrap();
        assert_ne!(world.points, other.points, "{}", kind.name());
        let worse = WorldOptions { noise_rad: 1e-3, outlier_fraction: 0.1, orientation_error_rad: 0.1, ..o };
        let worse = simulate::<3>(kind, &worse).unwrap();
        assert_eq!((&world.centers, &world.points), (&worse.centers, &worse.points));
        assert_eq!(world.tracks.view(), worse.tracks.view());
        assert_ne!(world.tracks.bearing(), worse.tracks.bearing());
    }
}

#[test]
fn the_window_is_respected() {
    for kind in WorldKind::all().filter(|kind| *kind != WorldKind::Weak && *kind != WorldKind::Ellipse) {
        let o = WorldOptions { min_views: Some(3), max_views: Some(3), ..options(50, 200) };
        let world = simulate::<3>(kind, &o).unwrap();
        assert_eq!(world.tracks.len(), 600, "{}", kind.name());
        assert!(views_of_tracks(&world).iter().all(|views| views.len() == 3));
    }
}

#[test]
fn options_out_of_range_or_of_no_use_are_refused() {
    let ok = options(20, 50);
    let refused = [
        (WorldKind::Street, WorldOptions { n_views: 0, ..ok.clone() }, "n_views is 0, expected a number from 1"),
        (WorldKind::Street, WorldOptions { n_points: 0, ..ok.clone() }, "n_points is 0"),
        (WorldKind::Street, WorldOptions { noise_rad: f64::NAN, ..ok.clone() }, "noise_rad is NaN"),
        (WorldKind::Street, WorldOptions { outlier_fraction: 1.5, ..ok.clone() }, "outlier_fraction is 1.5"),
        (WorldKind::Street, WorldOptions { min_views: Some(21), ..ok.clone() }, "min_views is 21"),
        (
            WorldKind::Street,
            WorldOptions { min_views: Some(5), max_views: Some(4), ..ok.clone() },
            "not above max_views",
        ),
        (WorldKind::Street, WorldOptions { depth_max_m: Some(-1.0), ..ok.clone() }, "depth_max_m is -1"),
        (WorldKind::Street, WorldOptions { mover_fraction: 0.6, operator_fraction: 0.6, ..ok.clone() }, "at most 1"),
        (
            WorldKind::Street,
            WorldOptions { conic: Some(Conic::Circle), ..ok.clone() },
            "no meaning in the world \"street\"",
        ),
        (WorldKind::Room, WorldOptions { depth_min_m: Some(2.0), ..ok.clone() }, "it belongs to street, line"),
        (WorldKind::Weak, WorldOptions { n_clusters: Some(1), ..ok.clone() }, "n_clusters is 1"),
        (WorldKind::Weak, WorldOptions { n_links: Some(60), ..ok.clone() }, "n_points is 50"),
        (WorldKind::Weak, WorldOptions { wobble_m: Some(0.1), ..ok.clone() }, "belongs to weak (chain)"),
        (
            WorldKind::Weak,
            WorldOptions { n_links: Some(3), weak_mode: Some(WeakMode::Chain), ..ok.clone() },
            "n_links has no meaning in the world \"weak (chain)\"",
        ),
        (WorldKind::Street, WorldOptions { n_bodies: 0, ..ok.clone() }, "n_bodies is 0, expected a number from 1"),
        (WorldKind::Room, WorldOptions { n_bodies: 2, ..ok.clone() }, "n_bodies has no meaning in the world \"room\""),
        (WorldKind::StopAndGo, WorldOptions { go_views: Some(0), ..ok.clone() }, "go_views is 0"),
        (WorldKind::Ellipse, ok.clone(), "exists in dimension 2 only"),
    ];
    for (kind, o, expected) in refused {
        let message = simulate::<3>(kind, &o).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
    assert!(simulate::<2>(WorldKind::Cylinder, &ok).unwrap_err().to_string().contains("dimension 3 only"));
    assert!(simulate::<4>(WorldKind::Box, &ok).unwrap_err().to_string().contains("expected 2 or 3"));
    let message = "strete".parse::<WorldKind>().unwrap_err().to_string();
    assert!(message.contains("\"strete\"") && message.contains("street, room, corridor"), "{message}");
}
