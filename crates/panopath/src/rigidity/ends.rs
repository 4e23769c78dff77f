//! Loose ends: members with so few observations that these tell of nothing but the member itself.
//!
//! A member whose observations are independent and no more than its unknowns takes them with it when it is left out: what
//! is left is as determined as before, and the member keeps `unknowns - rows` freedoms of its own. Leaving out goes on
//! until no such member is left.

use super::Sightings;
use crate::lists::Lists;

/// What was left out, and what stays.
pub(super) struct Ends {
    /// Observations of the rest, ascending.
    pub core: Vec<u32>,
    /// Freedoms of the members left out, together.
    pub freedoms: usize,
}

/// Leaves loose ends out. `unknowns` are those of a view; every pair of a view and a track stands once in `observations`.
pub(super) fn without_ends<const D: usize>(scene: &Sightings<'_, D>, observations: &[u32], unknowns: usize) -> Ends {
    let (n_views, n_tracks) = (scene.centers.len(), scene.points.len());
    let at = |of: &[u32], n: usize| Lists::new(n, observations.iter().map(|&o| (of[o as usize], o)));
    let (by_view, by_track) = (at(scene.view, n_views), at(scene.track, n_tracks));
    let mut is_gone = vec![false; scene.view.len()];
    let mut left: Vec<bool> = vec![false; n_views + n_tracks];
    let of = |node: usize| if node < n_views { by_view.of(node) } else { by_track.of(node - n_views) };
    let mut queue: Vec<usize> = (0..n_views + n_tracks).filter(|&n| !of(n).is_empty()).collect();
    let mut freedoms = 0;
    while let Some(node) = queue.pop() {
        if left[node] {
            continue;
        }
        let alive: Vec<u32> = of(node).iter().copied().filter(|&o| !is_gone[o as usize]).collect();
        let own = if node < n_views { unknowns } else { D };
        if !is_end(scene, node < n_views, &alive, own) {
            continue;
        }
        left[node] = true;
        freedoms += own - (D - 1) * alive.len();
        for &o in &alive {
            is_gone[o as usize] = true;
            queue.push(if node < n_views {
                n_views + scene.track[o as usize] as usize
            } else {
                scene.view[o as usize] as usize
            });
        }
    }
    Ends { core: observations.iter().copied().filter(|&o| !is_gone[o as usize]).collect(), freedoms }
}

/// Are these observations, all that a member has, independent, and too few to fix it?
fn is_end<const D: usize>(scene: &Sightings<'_, D>, is_view: bool, alive: &[u32], unknowns: usize) -> bool {
    match alive {
        [] | [_] => true,
        // two rows of directions each, and a turn that both would have to share
        [a, b] if is_view && unknowns > D && 2 * (D - 1) < unknowns => {
            let point = |o: u32| &scene.points[scene.track[o as usize] as usize];
            point(*a) != point(*b)
        }
        _ => false,
    }
}
