//! Of the tracks that two views share, how many fit both?
//!
//! A pair `(i, k)` shares `n` tracks near enough to tell of places; both accepted `a` of them. In the whole scene the share is `p = sum a / sum n`.
//! False bearings are spread over all pairs and only lower `p`. A pair has a share of its own where
//! `n KL(a / n, 0.85 p) > ln(pairs / chance)`: Chernoff's bound on the chance of so few, for each pair on its own. Such a pair may be
//! two places that look alike, rightly told apart. It is held against the scene only where what was rejected, `p n - a`
//! tracks, outweighs what the scene follows instead: no chain of pairs joins the two views each of which has accepted more.
//! Where parts are joined by scattered tracks no pair shares enough to tell; then groups of views stand in for views.

use rayon::prelude::*;

use super::Finding;
use super::rays::Rays;
use crate::sets::Sets;

/// Two views that share tracks.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tie {
    pub first: u32,
    pub second: u32,
    /// Tracks that both saw.
    pub shared: u32,
    /// Those that both accepted.
    pub agreed: u32,
}

/// All pairs of views of one component that share tracks.
pub(super) struct Ties {
    pub n_views: usize,
    /// Ascending by first view, then by second.
    pub ties: Vec<Tie>,
    /// Views with which each view has accepted most tracks, the most first.
    pub neighbours: Vec<Vec<u32>>,
}

/// Neighbours kept of each view.
const MOST_NEIGHBOURS: usize = 9;
/// A longer track is thinned evenly to so many views before pairs are counted: cost stays linear.
const LONGEST_TRACK: usize = 64;
/// Fewer tracks shared are no evidence.
const LEAST_SHARED: u32 = 8;
/// Tracks that two views must agree on to hang together firmly.
const FIRM: u32 = 8;
/// Share of the scene's agreement that a pair may have without notice.
const MARGIN: f64 = 0.85;

/// Counts the tracks of every pair that are near.
pub(super) fn count<const D: usize>(rays: &Rays<'_, D>, is_near: &[bool]) -> Ties {
    let n_views = rays.tracks.n_views();
    let chunk = n_views.div_ceil(64).max(1);
    let of_chunk = |first: usize| {
        let mut counter = Counter::new(n_views);
        (first..(first + chunk).min(n_views)).map(|i| counter.of_view(rays, is_near, i)).collect::<Vec<_>>()
    };
    let firsts: Vec<usize> = (0..n_views).step_by(chunk).collect();
    let rows: Vec<(Vec<Tie>, Vec<u32>)> = firsts.into_par_iter().map(of_chunk).collect::<Vec<_>>().concat();
    let (ties, neighbours): (Vec<_>, Vec<_>) = rows.into_iter().unzip();
    Ties { n_views, ties: ties.concat(), neighbours }
}

/// Counts against all other views, cleared after each view.
struct Counter {
    shared: Vec<u32>,
    agreed: Vec<u32>,
    touched: Vec<u32>,
}

impl Counter {
    fn new(n_views: usize) -> Self {
        Self { shared: vec![0; n_views], agreed: vec![0; n_views], touched: Vec::new() }
    }

    /// Ties of one view to later ones, and its neighbours.
    fn of_view<const D: usize>(&mut self, rays: &Rays<'_, D>, is_near: &[bool], view: usize) -> (Vec<Tie>, Vec<u32>) {
        for &o in rays.by_view.of(view) {
            let j = rays.tracks.track()[o as usize] as usize;
            if !is_near[j] {
                continue;
            }
            let of_track = rays.sightings(j);
            let is_accepted = rays.accepted[o as usize];
            let step = of_track.len().div_ceil(LONGEST_TRACK).max(1);
            for &(other, other_accepted) in of_track.iter().step_by(step) {
                let k = other as usize;
                if k == view || rays.view_component[k] != rays.view_component[view] {
                    continue;
                }
                if self.shared[k] == 0 {
                    self.touched.push(k as u32);
                }
                self.shared[k] += 1;
                self.agreed[k] += u32::from(is_accepted && other_accepted);
            }
        }
        self.touched.sort_unstable();
        let touched = std::mem::take(&mut self.touched);
        let all: Vec<Tie> = touched.into_iter().map(|k| self.take(view as u32, k)).collect();
        let mut nearest: Vec<&Tie> = all.iter().filter(|t| t.agreed > 0).collect();
        nearest.sort_by_key(|t| (std::cmp::Reverse(t.agreed), t.second));
        let neighbours = nearest.iter().take(MOST_NEIGHBOURS).map(|t| t.second).collect();
        (all.iter().filter(|t| t.first < t.second).copied().collect(), neighbours)
    }

    fn take(&mut self, first: u32, second: u32) -> Tie {
        let shared = std::mem::take(&mut self.shared[second as usize]);
        Tie { first, second, shared, agreed: std::mem::take(&mut self.agreed[second as usize]) }
    }
}

/// Places where the scene is torn: one finding for each group of pairs that hang together.
///
/// Pairs of views first; where these share too little to tell, groups of views that hang together firmly.
pub(super) fn tears(ties: &Ties, chance: f64) -> Vec<Finding> {
    let usable = ties.ties.iter().filter(|t| t.shared >= LEAST_SHARED);
    let (shared, agreed) =
        usable.fold((0, 0), |(shared, agreed), t| (shared + u64::from(t.shared), agreed + u64::from(t.agreed)));
    let elsewhere = agreed as f64 / shared.max(1) as f64;
    let mut findings = group(ties.n_views, &guilty(ties, elsewhere, chance), elsewhere);
    if findings.is_empty() {
        let (firm, members) = between_firm_groups(ties);
        findings = group(ties.n_views, &guilty(&firm, elsewhere, chance), elsewhere);
        for finding in &mut findings {
            if let Finding::Torn { first, second, .. } = finding {
                for side in [first, second] {
                    *side = side.iter().flat_map(|&g| members[g as usize].iter().copied()).collect();
                    side.sort_unstable();
                }
            }
        }
    }
    findings
}

/// Pairs that agree too seldom, and outweigh what the scene follows instead.
fn guilty(ties: &Ties, elsewhere: f64, chance: f64) -> Vec<Tie> {
    let usable = ties.ties.iter().filter(|t| t.shared >= LEAST_SHARED);
    let bound = (usable.clone().count() as f64 / chance).ln();
    let suspects = usable.filter(|t| surprise(t, MARGIN * elsewhere) > bound);
    let rejected = |t: &Tie| elsewhere * f64::from(t.shared) - f64::from(t.agreed);
    unoutweighed(ties, suspects.map(|t| (*t, rejected(t))).collect())
}

/// Views joined by pairs that agree on `FIRM` tracks, named by the first of them; ties summed over pairs between groups.
fn between_firm_groups(ties: &Ties) -> (Ties, Vec<Vec<u32>>) {
    let mut sets = Sets::new(ties.n_views);
    ties.ties.iter().filter(|t| t.agreed >= FIRM).for_each(|t| {
        sets.join(t.first as usize, t.second as usize);
    });
    let mut members = vec![Vec::new(); ties.n_views];
    (0..ties.n_views).for_each(|i| members[sets.find(i)].push(i as u32));
    let mut sums: std::collections::BTreeMap<(u32, u32), (u32, u32)> = std::collections::BTreeMap::new();
    for t in &ties.ties {
        let (a, b) = (sets.find(t.first as usize) as u32, sets.find(t.second as usize) as u32);
        if a != b {
            let sum = sums.entry((a.min(b), a.max(b))).or_default();
            *sum = (sum.0 + t.shared, sum.1 + t.agreed);
        }
    }
    let of_groups = sums.into_iter().map(|((first, second), (shared, agreed))| Tie { first, second, shared, agreed });
    (Ties { n_views: ties.n_views, ties: of_groups.collect(), neighbours: Vec::new() }, members)
}

/// Chernoff's bound: `-ln` of the chance of so few agreements where each has probability `expected`.
fn surprise(tie: &Tie, expected: f64) -> f64 {
    let n = f64::from(tie.shared);
    let share = f64::from(tie.agreed) / n;
    if share >= expected {
        return 0.0;
    }
    let term = |p: f64, q: f64| if p > 0.0 { p * (p / q).ln() } else { 0.0 };
    n * (term(share, expected) + term(1.0 - share, 1.0 - expected))
}

/// Those pairs whose views no chain joins of pairs that each accepted more than this pair has rejected.
fn unoutweighed(ties: &Ties, mut suspects: Vec<(Tie, f64)>) -> Vec<Tie> {
    suspects.sort_by(|(a, x), (b, y)| y.total_cmp(x).then((a.first, a.second).cmp(&(b.first, b.second))));
    let mut followed: Vec<&Tie> = ties.ties.iter().filter(|t| t.agreed > 0).collect();
    followed.sort_by_key(|t| (std::cmp::Reverse(t.agreed), t.first, t.second));
    let mut sets = Sets::new(ties.n_views);
    let mut next = 0;
    let mut guilty = Vec::new();
    for (tie, rejected) in suspects {
        while next < followed.len() && f64::from(followed[next].agreed) >= rejected {
            sets.join(followed[next].first as usize, followed[next].second as usize);
            next += 1;
        }
        if sets.find(tie.first as usize) != sets.find(tie.second as usize) {
            guilty.push(tie);
        }
    }
    guilty
}

/// Pairs that share views, together; each group in two sides where it has them.
fn group(n_views: usize, guilty: &[Tie], elsewhere: f64) -> Vec<Finding> {
    // node i is view i on one side, node n + i on the other: a pair joins the sides crosswise
    let n = n_views;
    let (mut sets, mut sides) = (Sets::new(n_views), Sets::new(2 * n_views));
    for t in guilty {
        let (first, second) = (t.first as usize, t.second as usize);
        sets.join(first, second);
        sides.join(first, second + n);
        sides.join(second, first + n);
    }
    let mut groups: std::collections::BTreeMap<usize, Vec<&Tie>> = std::collections::BTreeMap::new();
    for t in guilty {
        groups.entry(sets.find(t.first as usize)).or_default().push(t);
    }
    let findings = groups.into_values().map(|pairs| {
        let mut views: Vec<u32> = pairs.iter().flat_map(|t| [t.first, t.second]).collect();
        views.sort_unstable();
        views.dedup();
        let begin = sides.find(views[0] as usize);
        let has_sides = begin != sides.find(views[0] as usize + n);
        let (first, second) = views.into_iter().partition(|&i| !has_sides || sides.find(i as usize) == begin);
        let shared: u64 = pairs.iter().map(|t| u64::from(t.shared)).sum();
        let agreed: u64 = pairs.iter().map(|t| u64::from(t.agreed)).sum();
        Finding::Torn { first, second, shared, share: agreed as f64 / shared as f64, elsewhere }
    });
    findings.collect()
}
