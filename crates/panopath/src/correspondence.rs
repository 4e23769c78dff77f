//! Tracks from matches between pairs of images.
//!
//! Features are the nodes of a graph and matches its edges. Were all matches right, tracks would be the connected
//! components. One wrong match joins two points, and a component of thousands of features is soon ambiguous: it holds two
//! features of one image, though a point is seen once in an image. Ambiguous components are not dropped but cut where they
//! are weakest, by growing tracks from the best supported match to the worst and refusing joins (Kruskal's order, with
//! conditions):
//!
//! - The support of a match `u - v` is the number of features matched with both, `|N(u) ∩ N(v)|`, its triangles. A chance
//!   match has hardly any. Matches of equal support come in the order of their pair's mean support.
//! - Two tracks that hold features of the same image are never joined.
//! - Two tracks `A`, `B` are joined if enough of the matches there could be between them are there:
//!   `matches(A, B) / #{(u, v) in A x B : the images of u and v were matched} >= min_linkage` (average linkage, counted over
//!   the pairs that were tried). A wrong match between two tracks of ten images is one of a hundred.
//!
//! Union-find with the condition of one feature an image is that of Moulon and Monasse, "Unordered feature tracking made
//! fast and easy" (CVMP 2012), which drops what is ambiguous; growing in the order of confidence follows Kruskal (1956).

use rayon::prelude::*;

/// Support is counted up to here: more triangles say no more, and long tracks would cost the cube of their length.
const MAX_SUPPORT: usize = 7;

/// Below this number of images, which pairs were matched is kept as a table of bits (at most 32 MB).
const MAX_TABLE: usize = 1 << 14;

/// What a caller may choose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CorrespondenceOptions {
    /// Tracks seen in fewer images are left out; at least 2.
    pub min_images: usize,
    /// Least share of the possible matches between two tracks that must be there to join them, from 0 to 1.
    pub min_linkage: f64,
}

impl Default for CorrespondenceOptions {
    fn default() -> Self {
        Self { min_images: 2, min_linkage: 0.2 }
    }
}

/// Matches of all pairs: match `m` with `starts[p] <= m < starts[p + 1]` says that feature `features[m][0]` of image
/// `pairs[p][0]` and feature `features[m][1]` of image `pairs[p][1]` show one point.
#[derive(Debug, Clone, Copy)]
pub struct Matches<'a> {
    /// Number of features of each image.
    pub n_features: &'a [usize],
    /// Images of each pair.
    pub pairs: &'a [[u32; 2]],
    /// Where the matches of each pair begin, and where the last ones end: one more than there are pairs.
    pub starts: &'a [usize],
    /// Features of each match, counted within their images.
    pub features: &'a [[u32; 2]],
}

/// Tracks as flat arrays, in the order of their first feature; within a track, by image.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct FeatureTracks {
    /// Image of each observation.
    pub image: Vec<u32>,
    /// Track of each observation, from 0, ascending.
    pub track: Vec<u32>,
    /// Feature of each observation, counted within its image.
    pub feature: Vec<u32>,
    /// Number of tracks.
    pub n_tracks: usize,
    /// Matches whose two features did not end in one track.
    pub n_cut: usize,
}

/// Why matches cannot be read.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CorrespondenceError {
    /// Starts that do not divide the matches among the pairs.
    #[error(
        "match_starts has {found} entries, expected {expected} that ascend from 0 to {n_matches}, the number of matches"
    )]
    Starts {
        /// How many there are.
        found: usize,
        /// One more than there are pairs.
        expected: usize,
        /// Number of matches.
        n_matches: usize,
    },
    /// A pair of an image with itself, or with one that is not there.
    #[error("pairs[{pair}] is ({}, {}), expected two different images below {n_images}", images[0], images[1])]
    Pair {
        /// Which pair.
        pair: usize,
        /// What it names.
        images: [u32; 2],
        /// Number of images.
        n_images: usize,
    },
    /// A feature that its image does not have.
    #[error("matches[{index}] names feature {feature} of image {image}, which has {n_features} features")]
    Feature {
        /// Which match.
        index: usize,
        /// The feature named.
        feature: u32,
        /// Its image.
        image: u32,
        /// How many features that image has.
        n_features: usize,
    },
    /// More features than can be numbered.
    #[error("n_features adds up to {0}, expected fewer than 2^32 features")]
    TooMany(usize),
    /// An option out of its range.
    #[error("{name} is {found}, expected {expected}")]
    Option {
        /// Which option.
        name: &'static str,
        /// The value given.
        found: f64,
        /// What it may be.
        expected: &'static str,
    },
}

/// Joins matched features to tracks in which no image has two features; see the module's text for the method.
///
/// The answer depends on the input alone, not on the number of threads.
///
/// # Errors
/// [`CorrespondenceError`] naming the first entry that cannot be used.
pub fn tracks_from_matches(
    matches: &Matches,
    options: &CorrespondenceOptions,
) -> Result<FeatureTracks, CorrespondenceError> {
    check_options(options)?;
    let nodes = Nodes::new(matches)?;
    let edges = nodes.edges(matches)?;
    let graph = Neighbours::new(nodes.image.len(), &edges);
    let support: Vec<u8> = edges.par_iter().map(|&[u, v]| graph.common(u, v)).collect();
    let tried = TriedPairs::new(matches.n_features.len(), matches.pairs);
    let order = pairs_by_support(matches.starts, &support);
    let mut growth = Growth { clusters: Clusters::new(&nodes), graph, tried, min_linkage: options.min_linkage };
    for level in (1..=MAX_SUPPORT as u8).rev() {
        for m in in_order(matches.starts, &order).filter(|&m| support[m] == level) {
            growth.join(edges[m], false);
        }
    }
    // most wrong matches have no support; by now the tracks that they would join stand, and one look refuses them all
    let refused = growth.refused(&edges);
    for m in in_order(matches.starts, &order).filter(|&m| support[m] == 0) {
        growth.join(edges[m], refused[m]);
    }
    let clusters = growth.clusters;
    let n_cut = edges.iter().filter(|[u, v]| clusters.root(*u) != clusters.root(*v)).count();
    Ok(clusters.into_tracks(&nodes, options.min_images, n_cut))
}

fn check_options(options: &CorrespondenceOptions) -> Result<(), CorrespondenceError> {
    if options.min_images < 2 {
        let found = options.min_images as f64;
        return Err(CorrespondenceError::Option { name: "min_images", found, expected: "2 or more" });
    }
    if !(0.0..=1.0).contains(&options.min_linkage) {
        let found = options.min_linkage;
        return Err(CorrespondenceError::Option { name: "min_linkage", found, expected: "a share from 0 to 1" });
    }
    Ok(())
}

/// Pairs from the highest mean support of their matches to the lowest; ties in the order of the input.
fn pairs_by_support(starts: &[usize], support: &[u8]) -> Vec<usize> {
    let mean: Vec<f64> = starts
        .windows(2)
        .map(|w| support[w[0]..w[1]].iter().map(|&s| f64::from(s)).sum::<f64>() / (w[1] - w[0]).max(1) as f64)
        .collect();
    let mut order: Vec<usize> = (0..mean.len()).collect();
    order.sort_by(|&a, &b| mean[b].total_cmp(&mean[a]));
    order
}

/// All matches, pair by pair.
fn in_order<'a>(starts: &'a [usize], order: &'a [usize]) -> impl Iterator<Item = usize> + 'a {
    order.iter().flat_map(|&pair| starts[pair]..starts[pair + 1])
}

/// Features of all images in one count.
struct Nodes {
    /// First node of each image.
    first: Vec<u32>,
    /// Image of each node.
    image: Vec<u32>,
}

impl Nodes {
    fn new(matches: &Matches) -> Result<Self, CorrespondenceError> {
        let total = matches.n_features.iter().fold(0usize, |sum, &n| sum.saturating_add(n));
        if total >= u32::MAX as usize {
            return Err(CorrespondenceError::TooMany(total));
        }
        let (mut first, mut image) = (Vec::with_capacity(matches.n_features.len()), Vec::with_capacity(total));
        for (i, &n) in matches.n_features.iter().enumerate() {
            first.push(image.len() as u32);
            image.resize(image.len() + n, i as u32);
        }
        Ok(Self { first, image })
    }

    /// The two nodes of each match.
    fn edges(&self, matches: &Matches) -> Result<Vec<[u32; 2]>, CorrespondenceError> {
        let (starts, n_matches, n_images) = (matches.starts, matches.features.len(), self.first.len());
        let divides = starts.first() == Some(&0) && starts.last() == Some(&n_matches) && starts.is_sorted();
        if starts.len() != matches.pairs.len() + 1 || !divides {
            let (found, expected) = (starts.len(), matches.pairs.len() + 1);
            return Err(CorrespondenceError::Starts { found, expected, n_matches });
        }
        let mut edges = Vec::with_capacity(n_matches);
        for (pair, &images) in matches.pairs.iter().enumerate() {
            if images[0] == images[1] || images.iter().any(|&i| i as usize >= n_images) {
                return Err(CorrespondenceError::Pair { pair, images, n_images });
            }
            let [a, b] = images.map(|i| (self.first[i as usize], matches.n_features[i as usize]));
            for index in starts[pair]..starts[pair + 1] {
                let [f, g] = matches.features[index];
                for (feature, image, n_features) in [(f, images[0], a.1), (g, images[1], b.1)] {
                    if feature as usize >= n_features {
                        return Err(CorrespondenceError::Feature { index, feature, image, n_features });
                    }
                }
                edges.push([a.0 + f, b.0 + g]);
            }
        }
        Ok(edges)
    }
}

/// Neighbours of each node, ascending, each once.
struct Neighbours {
    starts: Vec<usize>,
    node: Vec<u32>,
}

impl Neighbours {
    fn new(n_nodes: usize, edges: &[[u32; 2]]) -> Self {
        let mut starts = vec![0usize; n_nodes + 1];
        for node in edges.as_flattened() {
            starts[*node as usize + 1] += 1;
        }
        for i in 0..n_nodes {
            starts[i + 1] += starts[i];
        }
        let scattered = scatter(&starts, edges.iter().flat_map(|&[u, v]| [(u, v), (v, u)]));
        // the transpose of a symmetric graph is itself, and going through it by node leaves every list ascending
        let by_node =
            (0..n_nodes).flat_map(|u| scattered[starts[u]..starts[u + 1]].iter().map(move |&v| (v, u as u32)));
        Self::without_repeats(&starts, &scatter(&starts, by_node))
    }

    fn without_repeats(starts: &[usize], ascending: &[u32]) -> Self {
        let mut unique = Self { starts: vec![0; starts.len()], node: Vec::with_capacity(ascending.len()) };
        for u in 0..starts.len() - 1 {
            let mut last = u32::MAX;
            for &v in &ascending[starts[u]..starts[u + 1]] {
                if v != last {
                    unique.node.push(v);
                    last = v;
                }
            }
            unique.starts[u + 1] = unique.node.len();
        }
        unique
    }

    fn of(&self, node: u32) -> &[u32] {
        &self.node[self.starts[node as usize]..self.starts[node as usize + 1]]
    }

    /// Number of common neighbours, up to [`MAX_SUPPORT`].
    fn common(&self, u: u32, v: u32) -> u8 {
        let (a, b) = (self.of(u), self.of(v));
        let (mut i, mut j, mut count) = (0, 0, 0);
        while i < a.len() && j < b.len() && count < MAX_SUPPORT {
            let (x, y) = (a[i], b[j]);
            count += usize::from(x == y);
            i += usize::from(x <= y);
            j += usize::from(y <= x);
        }
        count as u8
    }
}

/// Puts `(key, value)` into the list of its key, lists lying one after another from `starts`.
fn scatter(starts: &[usize], entries: impl Iterator<Item = (u32, u32)>) -> Vec<u32> {
    let mut next = starts.to_vec();
    let mut lists = vec![0; starts.last().copied().unwrap_or(0)];
    for (key, value) in entries {
        lists[next[key as usize]] = value;
        next[key as usize] += 1;
    }
    lists
}

/// Which pairs of images were matched.
enum TriedPairs {
    Table { words: usize, bits: Vec<u64> },
    Sorted(Vec<[u32; 2]>),
}

impl TriedPairs {
    fn new(n_images: usize, pairs: &[[u32; 2]]) -> Self {
        if n_images > MAX_TABLE {
            let mut sorted: Vec<[u32; 2]> = pairs.iter().map(|&[a, b]| [a.min(b), a.max(b)]).collect();
            sorted.sort_unstable();
            return Self::Sorted(sorted);
        }
        let words = n_images.div_ceil(64);
        let mut bits = vec![0u64; words * n_images];
        for &[a, b] in pairs {
            for (i, j) in [(a as usize, b as usize), (b as usize, a as usize)] {
                bits[i * words + j / 64] |= 1 << (j % 64);
            }
        }
        Self::Table { words, bits }
    }

    fn contains(&self, a: u32, b: u32) -> bool {
        match self {
            Self::Table { words, bits } => bits[a as usize * words + b as usize / 64] >> (b % 64) & 1 == 1,
            Self::Sorted(pairs) => pairs.binary_search(&[a.min(b), a.max(b)]).is_ok(),
        }
    }
}

/// Joins under the conditions of the module's text.
struct Growth {
    clusters: Clusters,
    graph: Neighbours,
    tried: TriedPairs,
    min_linkage: f64,
}

impl Growth {
    /// Joins the sets of a match unless a condition forbids it. `is_refused`: it was, before any set grew.
    fn join(&mut self, [u, v]: [u32; 2], is_refused: bool) {
        let c = &mut self.clusters;
        let (a, b) = (c.root_halving(u), c.root_halving(v));
        if a == b || (is_refused && !c.has_grown[a as usize] && !c.has_grown[b as usize]) {
            return;
        }
        let n_links = c.n_links(a, b, &self.graph, self.min_linkage * c.product(a, b));
        if self.may_join(a, b, n_links) {
            self.clusters.merge(a, b);
        }
    }

    /// Whether two sets with `n_links` matches between them may be joined.
    fn may_join(&self, a: u32, b: u32, n_links: usize) -> bool {
        self.are_linked(a, b, n_links) && !self.clusters.share_an_image(a, b)
    }

    /// Whether `n_links` is enough of the matches that there could be; stops counting those when it is not.
    fn are_linked(&self, a: u32, b: u32, n_links: usize) -> bool {
        let c = &self.clusters;
        let is_enough = |n_possible: f64| n_links as f64 >= self.min_linkage * n_possible;
        if is_enough(c.product(a, b)) {
            return true;
        }
        let mut n_possible = 0;
        for u in c.members(a) {
            n_possible += c.members(b).iter().filter(|v| self.tried.contains(u.image, v.image)).count();
            if !is_enough(n_possible as f64) {
                return false;
            }
        }
        true
    }

    /// Matches that would be refused now. The matches of two sets are counted and judged together, which needs no search
    /// for them, and goes through the sets in the order in which they lie.
    fn refused(&mut self, edges: &[[u32; 2]]) -> Vec<bool> {
        self.clusters.has_grown.fill(false);
        let mut between: Vec<([u32; 2], [u32; 2], usize)> = Vec::new();
        for (m, &[u, v]) in edges.iter().enumerate() {
            let (a, b) = (self.clusters.root_halving(u), self.clusters.root_halving(v));
            if a != b {
                between.push(([a.min(b), a.max(b)], [u.min(v), u.max(v)], m));
            }
        }
        between.par_sort_unstable();
        let sets: Vec<_> = between.chunk_by(|x, y| x.0 == y.0).collect();
        let judge = |matches: &&[([u32; 2], [u32; 2], usize)]| {
            let [a, b] = matches[0].0;
            // a match that is given twice counts once
            self.may_join(a, b, matches.chunk_by(|x, y| x.1 == y.1).count())
        };
        let verdicts: Vec<bool> = sets.par_iter().map(judge).collect();
        let mut refused = vec![false; edges.len()];
        for (matches, may_join) in sets.iter().zip(verdicts) {
            for &(_, _, m) in *matches {
                refused[m] = !may_join;
            }
        }
        refused
    }
}

/// A feature in a set.
#[derive(Clone, Copy, Default)]
struct Member {
    node: u32,
    image: u32,
}

/// Disjoint sets of nodes. The members of a set lie together, since they are read far more often than sets are joined.
struct Clusters {
    parent: Vec<u32>,
    size: Vec<u32>,
    /// Where the members of each root begin in `pool`; there is room for the next power of two of them.
    begin: Vec<usize>,
    pool: Vec<Member>,
    /// Whether a set was joined to that of a root.
    has_grown: Vec<bool>,
}

impl Clusters {
    fn new(nodes: &Nodes) -> Self {
        let n = nodes.image.len();
        let pool = nodes.image.iter().zip(0..).map(|(&image, node)| Member { node, image }).collect();
        let (parent, begin) = ((0..n as u32).collect(), (0..n).collect());
        Self { parent, size: vec![1; n], begin, pool, has_grown: vec![false; n] }
    }

    fn root(&self, mut node: u32) -> u32 {
        while self.parent[node as usize] != node {
            node = self.parent[node as usize];
        }
        node
    }

    /// The root of a node; halves the path to it.
    fn root_halving(&mut self, mut node: u32) -> u32 {
        while self.parent[node as usize] != node {
            let above = self.parent[self.parent[node as usize] as usize];
            self.parent[node as usize] = above;
            node = above;
        }
        node
    }

    fn members(&self, root: u32) -> &[Member] {
        &self.pool[self.begin[root as usize]..][..self.size[root as usize] as usize]
    }

    /// How many matches there would be between two sets if every feature were matched with every other.
    fn product(&self, a: u32, b: u32) -> f64 {
        f64::from(self.size[a as usize]) * f64::from(self.size[b as usize])
    }

    fn merge(&mut self, a: u32, b: u32) {
        let (large, small) = if self.size[a as usize] >= self.size[b as usize] { (a, b) } else { (b, a) };
        let (n_large, n_small) = (self.size[large as usize] as usize, self.size[small as usize] as usize);
        if n_large + n_small > n_large.next_power_of_two() {
            let begin = self.pool.len();
            self.pool.resize(begin + (n_large + n_small).next_power_of_two(), Member::default());
            self.pool.copy_within(self.begin[large as usize]..self.begin[large as usize] + n_large, begin);
            self.begin[large as usize] = begin;
        }
        let (from, to) = (self.begin[small as usize], self.begin[large as usize] + n_large);
        self.pool.copy_within(from..from + n_small, to);
        self.parent[small as usize] = large;
        self.size[large as usize] += n_small as u32;
        self.has_grown[large as usize] = true;
    }

    /// Whether two sets hold features of one image.
    fn share_an_image(&self, a: u32, b: u32) -> bool {
        self.members(a).iter().any(|u| self.members(b).iter().any(|v| u.image == v.image))
    }

    /// Number of matches between two sets that have one; the count stops where it is `enough`.
    fn n_links(&self, a: u32, b: u32, graph: &Neighbours, enough: f64) -> usize {
        let (from, to) = if self.size[a as usize] < self.size[b as usize] { (a, b) } else { (b, a) };
        if enough <= 1.0 {
            return 1; // the one that asks
        }
        let mut count = 0;
        for u in self.members(from) {
            count += graph.of(u.node).iter().filter(|&&v| self.root(v) == to).count();
            if count as f64 >= enough {
                break;
            }
        }
        count
    }

    fn into_tracks(self, nodes: &Nodes, min_images: usize, n_cut: usize) -> FeatureTracks {
        let mut tracks = FeatureTracks { n_cut, ..FeatureTracks::default() };
        let mut done = vec![false; nodes.image.len()];
        for node in 0..nodes.image.len() as u32 {
            let root = self.root(node);
            if done[root as usize] || (self.size[root as usize] as usize) < min_images {
                continue;
            }
            done[root as usize] = true;
            let mut members = self.members(root).to_vec();
            members.sort_unstable_by_key(|m| m.node);
            for Member { node, image } in members {
                tracks.image.push(image);
                tracks.track.push(tracks.n_tracks as u32);
                tracks.feature.push(node - nodes.first[image as usize]);
            }
            tracks.n_tracks += 1;
        }
        tracks
    }
}
