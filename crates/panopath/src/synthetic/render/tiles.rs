//! Which items each part of a frame may show, the nearest first, and the ray that meets them.
//!
//! A tile is a square of pixels, enclosed by four planes through the camera. It lists the items that reach between these,
//! but for those behind a box that covers the whole tile. A ray then tests two or three items, and what it meets is what
//! it would meet of all.

use rayon::prelude::*;

use super::city::{Block, City, FAR_M, GROUND, Hit, Item, Ray, SKY, Veil};
use crate::geometry::{Rotation, Vector, cross, dot, norm, sub};

/// Where the rows and columns of a panorama are, and how it is turned.
pub(super) struct Frame {
    pub center: Vector<3>,
    /// Axes of the camera in the world: right, down, forward.
    pub axes: [Vector<3>; 3],
    pub width_px: usize,
    pub height_px: usize,
    /// Angle of a pixel.
    pub delta: f64,
}

impl Frame {
    pub fn of(center: Vector<3>, cam_from_world: &Rotation<3>, width_px: usize) -> Self {
        let world_from_cam = cam_from_world.inverse();
        let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| world_from_cam.apply(&axis));
        Self { center, axes, width_px, height_px: width_px / 2, delta: std::f64::consts::TAU / width_px as f64 }
    }
}

/// An item that is near enough to be seen.
struct Near {
    item: Item,
    /// The nearest and the farthest that it may be.
    distance: [f64; 2],
    /// The box about it, as seen from the camera.
    low: Vector<3>,
    high: Vector<3>,
    /// Rows of tiles that it may reach, and columns, which go on from the first after the last.
    rows: [usize; 2],
    columns: [usize; 2],
}

/// All tiles of a frame.
pub(super) struct Tiles {
    nears: Vec<Near>,
    /// Lists of tiles, row by row: where each begins, and entries of `nears`.
    rows: Vec<(Vec<u32>, Vec<u32>)>,
    /// Binary logarithm of the size of a tile.
    shift: u32,
}

/// What one tile may show.
#[derive(Clone, Copy)]
pub(super) struct Tile<'a> {
    nears: &'a [Near],
    list: &'a [u32],
}

impl Tiles {
    pub fn of(frame: &Frame, city: &City, movers: &[Block]) -> Self {
        // small enough for planes to enclose them closely
        let shift = (frame.width_px / 64).clamp(1, 16).ilog2();
        let tile_px = 1 << shift;
        let mut nears = near_items(frame, city, movers, tile_px);
        nears.sort_by(|a, b| a.distance[0].total_cmp(&b.distance[0]));
        let n_rows = frame.height_px.div_ceil(tile_px);
        let rows = (0..n_rows).into_par_iter().map(|row| row_of_tiles(frame, &nears, row, tile_px)).collect();
        Self { nears, rows, shift }
    }

    /// The tile of a pixel.
    #[inline(always)]
    pub fn at(&self, x_px: usize, y_px: usize) -> Tile<'_> {
        let (first, items) = &self.rows[y_px >> self.shift];
        let column = x_px >> self.shift;
        Tile { nears: &self.nears, list: &items[first[column] as usize..first[column + 1] as usize] }
    }
}

fn near_items(frame: &Frame, city: &City, movers: &[Block], tile_px: usize) -> Vec<Near> {
    let blocks = city.blocks.iter().chain(movers).enumerate();
    let blocks = blocks.map(|(k, block)| (Item::Block(k as u32), block.low, block.high));
    let posts = city.posts.iter().enumerate().map(|(k, post)| {
        let corner = |sign: f64, z: f64| [post.at[0] + sign * post.radius, post.at[1] + sign * post.radius, z];
        (Item::Post(k as u32), corner(-1.0, post.low), corner(1.0, post.high))
    });
    let balls = city.balls.iter().enumerate().map(|(k, ball)| {
        (Item::Ball(k as u32), ball.center.map(|x| x - ball.radius), ball.center.map(|x| x + ball.radius))
    });
    let near = |(item, low, high)| Near::of(frame, item, &low, &high, tile_px);
    blocks.chain(posts).chain(balls).filter_map(near).collect()
}

impl Near {
    fn of(frame: &Frame, item: Item, low: &Vector<3>, high: &Vector<3>, tile_px: usize) -> Option<Self> {
        let (low, high) = (sub(low, &frame.center), sub(high, &frame.center));
        let to_box: Vector<3> = std::array::from_fn(|c| low[c].max(-high[c]).max(0.0));
        let middle: Vector<3> = std::array::from_fn(|c| 0.5 * (low[c] + high[c]));
        let (radius, away) = (0.5 * norm(&sub(&high, &low)), norm(&middle));
        let distance = [norm(&to_box), away + radius];
        if distance[0] >= FAR_M {
            return None;
        }
        let mut near = Self { item, distance, low, high, rows: [0, usize::MAX], columns: [0, usize::MAX] };
        if radius < 0.99 * away {
            near.set_reach(frame, &middle, (radius / away).asin() + 2.0 * frame.delta, tile_px);
        }
        Some(near)
    }

    /// Rows and columns of tiles of a cap of the sphere about a direction.
    fn set_reach(&mut self, frame: &Frame, to: &Vector<3>, angle: f64, tile_px: usize) {
        let [right, down, forward] = frame.axes.map(|axis| dot(&axis, to));
        let below = down.atan2((right * right + forward * forward).sqrt());
        let (width, height) = (frame.width_px as f64, frame.height_px as f64);
        let row = |angle: f64| ((angle / frame.delta + 0.5 * height).max(0.0) / tile_px as f64) as usize;
        self.rows = [row(below - angle), row(below + angle)];
        // a cap that holds a pole has all azimuths
        if below.abs() + angle < 1.55 {
            let aside = (angle.sin() / below.cos()).min(1.0).asin();
            let from = (right.atan2(forward) - aside) / frame.delta + 0.5 * width;
            let first = from.rem_euclid(width) as usize / tile_px;
            // one more since it may begin anywhere in a tile, and one since the last tile of a row may be cut
            let more = (2.0 * aside / frame.delta) as usize / tile_px + 3;
            if more < frame.width_px / tile_px {
                self.columns = [first, first + more];
            }
        }
    }
}

/// Lists of the tiles of one row.
fn row_of_tiles(frame: &Frame, nears: &[Near], row: usize, tile_px: usize) -> (Vec<u32>, Vec<u32>) {
    let n = frame.width_px.div_ceil(tile_px);
    let bounds: Vec<Bounds> = (0..n).map(|column| Bounds::of(frame, row, column, tile_px)).collect();
    let mut hidden_from = vec![f64::INFINITY; n];
    let mut lists = vec![Vec::new(); n];
    for (k, near) in nears.iter().enumerate().filter(|(_, near)| near.rows[0] <= row && row <= near.rows[1]) {
        for column in near.columns[0]..=near.columns[1].min(near.columns[0] + n - 1) {
            let column = column % n;
            if near.distance[0] < hidden_from[column] && bounds[column].reached_by(near, frame.delta) {
                lists[column].push(k as u32);
                if let Item::Block(_) = near.item {
                    hidden_from[column] = hidden_from[column].min(bounds[column].covered_by(near));
                }
            }
        }
    }
    let begin = |sum: &mut u32, list: &Vec<u32>| Some(std::mem::replace(sum, *sum + list.len() as u32));
    let mut first: Vec<u32> = lists.iter().scan(0, begin).collect();
    first.push(lists.iter().map(|list| list.len() as u32).sum());
    (first, lists.concat())
}

/// A tile as part of the sphere: corners of a quadrilateral about it, and the normals of its sides, inwards.
struct Bounds {
    corners: [Vector<3>; 4],
    inwards: [Vector<3>; 4],
}

impl Bounds {
    fn of(frame: &Frame, row: usize, column: usize, tile_px: usize) -> Self {
        let (width, height) = (frame.width_px as f64, frame.height_px as f64);
        let from = |tile: usize, end: f64| ((tile * tile_px) as f64).min(end);
        let azimuth = [column, column + 1].map(|tile| (from(tile, width) - 0.5 * width) * frame.delta);
        let below = [row, row + 1].map(|tile| (from(tile, height) - 0.5 * height) * frame.delta);
        // a row of pixels bends away from the equator less than a great circle does: on the side of the equator the
        // great circle must touch it in its middle
        let bend = (0.5 * (azimuth[1] - azimuth[0])).cos();
        let touching = |below: f64| (below.tan() * bend).atan();
        let top = if below[0] > 0.0 { touching(below[0]) } else { below[0] };
        let bottom = if below[1] < 0.0 { touching(below[1]) } else { below[1] };
        let corner = |below: f64, azimuth: f64| {
            let level = below.cos();
            let own = [level * azimuth.sin(), below.sin(), level * azimuth.cos()];
            std::array::from_fn(|c| (0..3).map(|k| own[k] * frame.axes[k][c]).sum())
        };
        let [left, right] = azimuth;
        let corners = [corner(top, left), corner(top, right), corner(bottom, right), corner(bottom, left)];
        let inwards = std::array::from_fn(|k| {
            let normal = cross(&corners[k], &corners[(k + 1) % 4]);
            normal.map(|x| x / norm(&normal).max(1e-9))
        });
        Self { corners, inwards }
    }

    /// Whether some of the box about an item, or of the footprints that it shares in, may be inside all four planes.
    fn reached_by(&self, near: &Near, delta: f64) -> bool {
        let margin = 2.0 * delta * near.distance[1] + 1e-9;
        self.inwards.iter().all(|n| {
            let farthest: f64 = (0..3).map(|c| (n[c] * near.low[c]).max(n[c] * near.high[c])).sum();
            farthest > -margin
        })
    }

    /// Where the box covers the whole tile: all of what lies beyond this is hidden.
    fn covered_by(&self, near: &Near) -> f64 {
        // any direction between the corners leads to a point of the box between those that the corners meet
        let mut farthest = 0.0_f64;
        for corner in &self.corners {
            match enter(&near.low, &near.high, &corner.map(|x| 1.0 / x), FAR_M) {
                Some((distance, _)) => farthest = farthest.max(distance),
                None => return f64::INFINITY,
            }
        }
        farthest
    }
}

/// Distance and axis of the face through which a ray enters a box, if that is before `limit`. From within there is nothing
/// to see.
#[inline(always)]
fn enter(low: &Vector<3>, high: &Vector<3>, inverse: &Vector<3>, limit: f64) -> Option<(f64, usize)> {
    let (mut enter, mut leave, mut axis) = (0.0, limit, 3);
    for c in 0..3 {
        let (a, b) = (low[c] * inverse[c], high[c] * inverse[c]);
        let (near, far) = if a < b { (a, b) } else { (b, a) };
        if near > enter {
            (enter, axis) = (near, c);
        }
        if far < leave {
            leave = far;
        }
    }
    (enter < leave && axis < 3).then_some((enter, axis))
}

impl Tile<'_> {
    /// The first solid along a ray.
    #[inline(always)]
    pub fn solid(&self, ray: &Ray) -> Hit {
        let mut hit = ground_or_sky(ray);
        for near in self.list.iter().map(|&k| &self.nears[k as usize]) {
            if near.distance[0] >= hit.distance {
                break;
            }
            near.meet(ray, &mut hit);
        }
        hit
    }

    /// The first solid along a ray, and what veils it, in `veils`.
    #[inline(always)]
    pub fn trace(&self, ray: &Ray, city: &City, veils: &mut Vec<Veil>) -> Hit {
        veils.clear();
        let mut hit = ground_or_sky(ray);
        for near in self.list.iter().map(|&k| &self.nears[k as usize]) {
            if near.distance[0] >= hit.distance {
                break;
            }
            let cover = match near.item {
                Item::Block(_) => {
                    near.meet(ray, &mut hit);
                    None
                }
                Item::Post(k) => city.posts[k as usize].cover(ray),
                Item::Ball(k) => city.balls[k as usize].cover(ray),
            };
            if let Some((distance, share)) = cover {
                veils.push(Veil { distance, share, item: near.item });
            }
        }
        if !veils.is_empty() {
            veils.retain(|veil| veil.distance < hit.distance);
            veils.sort_by(|a, b| a.distance.total_cmp(&b.distance));
        }
        hit
    }
}

impl Near {
    #[inline(always)]
    fn meet(&self, ray: &Ray, hit: &mut Hit) {
        if let Item::Block(k) = self.item
            && let Some((distance, axis)) = enter(&self.low, &self.high, &ray.inverse, hit.distance)
        {
            *hit = Hit { distance, block: k, axis };
        }
    }
}

#[inline(always)]
fn ground_or_sky(ray: &Ray) -> Hit {
    let down = -ray.from[2] * ray.inverse[2];
    if down > 0.0 && down < FAR_M {
        Hit { distance: down, block: GROUND, axis: 2 }
    } else {
        Hit { distance: FAR_M, block: SKY, axis: 2 }
    }
}

/// A block that is elsewhere in each frame is numbered on from those of the city.
pub(super) fn block_of<'a>(city: &'a City, movers: &'a [Block], k: u32) -> &'a Block {
    city.blocks.get(k as usize).unwrap_or_else(|| &movers[k as usize - city.blocks.len()])
}
