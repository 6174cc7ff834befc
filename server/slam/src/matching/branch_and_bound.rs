//! Branch and bound: where in a map a set of points fits best, without a good guess.
//!
//! Source: Hess et al., "Real-time loop closure in 2D LIDAR SLAM", 2016, section V. Each level bounds the one below
//! from above, so that the result is that of trying every pose. Levels are stored at a quarter of their own spacing: bounds look
//! a quarter farther than they need to, for 2.3 times the finest one's memory besides it.

#[cfg(test)]
mod tests;

use nalgebra::{Isometry2, Point2, Vector2};
use percept_geometry::GridGeometry;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Levels above the finest: a cell of the coarsest is 32 fine ones wide.
const DEPTH: u32 = 5;
/// Cells of a level are so many times smaller than what it bounds, as a power of two. The finer they are, the closer the bounds, and the
/// more memory they take: a search of the Freiburg 101 log for one view visits 500,000 nodes in the median with 0, 194,000 with 2.
const FINER: u32 = 2;
/// Reach of a point's likelihood, fine cells. Where a point is worth a quarter of what it is at its place.
const REACH: i32 = 2;
/// Standard deviation of a point, fine cells. Halved 79 and 27.8, with 0.78 instead of 0.91 of the frames placed at
/// once, doubled 104 and 35.1 ([`crate::loops::planar`]).
const SIGMA: f64 = 1.2;
/// Points farther than this do not make the steps of the angle finer, metres. A cell of 0.1 m there is a step of 8
/// mrad. Halved and doubled as it is ([`crate::loops::planar`]).
const MAX_LEVER_M: f64 = 12.0;
/// A pose nearer than this to another one is the same optimum, metres and radians. Halved 104 and 35.2, doubled 101 and
/// 26.7 ([`crate::loops::planar`]).
const SAME: (f64, f64) = (1.0, 0.35);
/// Nodes that a search may visit, a microsecond or so each. A lidar that sees 5.5 m fits in many places nearly alike: on such a log
/// (`planar_log lidar2d-intel --max-range 5.5 --no-odometry`) searches of 15 m take up to 520,000, and with 200,000 no loop is
/// closed any more once the robot has been lost. Of them so many at least beyond the coarsest ones, which there are more of
/// in a larger map.
const PATIENCE: usize = 600_000;
const PATIENCE_BEYOND: usize = 300_000;
/// A coarsest node is one sum, any other leads to four: so many of the former count as one. The sums' ratio.
const ROOTS_A_NODE: usize = 4;
/// Another optimum this good, as a share of the best one's score, leaves a match open. Times 0.7 87 and 47.4, with 0.99
/// 102 and 26.7 ([`crate::loops::planar`]).
pub(crate) const RIVAL: f64 = 0.85;
/// Points of a query, at most: the rest is not looked at. Halved and doubled as it is ([`crate::loops::planar`]).
const MOST_POINTS: usize = 256;
/// Points summed up before a node is looked at again whether it can still be good enough. Halved and doubled as it is
/// ([`crate::loops::planar`]).
const CHUNK: usize = 16;
/// Fine cells at most along an edge, which take 220 MB if all of them are wanted: of larger maps, cells are larger.
const MAX_CELLS: f64 = 8192.0;

/// One level: upper bounds for shifts within a cell.
#[derive(Debug, Clone)]
struct Level {
    width: i32,
    height: i32,
    cells: Vec<u8>,
}

impl Level {
    #[inline]
    fn at(&self, x: i32, y: i32) -> u32 {
        // Negative ones are large, too.
        if x as u32 >= self.width as u32 || y as u32 >= self.height as u32 {
            return 0;
        }
        u32::from(self.cells[(y * self.width + x) as usize])
    }

    /// Half as many cells along each edge, each the largest of four.
    fn halved(&self) -> Self {
        let (width, height) = ((self.width + 1) / 2, (self.height + 1) / 2);
        let mut cells = vec![0u8; (width * height) as usize];
        for y in 0..self.height {
            let (from, to) = ((y * self.width) as usize, (y / 2 * width) as usize);
            for (x, &v) in self.cells[from..from + self.width as usize].iter().enumerate() {
                let cell = &mut cells[to + x / 2];
                *cell = v.max(*cell);
            }
        }
        Self { width, height, cells }
    }

    /// Each cell the largest of `width` from itself on, along both axes.
    fn reaching(&self, width: usize) -> Self {
        let (w, h) = (self.width as usize, self.height as usize);
        let mut rows = self.cells.clone();
        for (row, from) in rows.chunks_exact_mut(w).zip(self.cells.chunks_exact(w)) {
            for ahead in 1..width.min(w) {
                row.iter_mut().zip(&from[ahead..]).for_each(|(a, &b)| *a = b.max(*a));
            }
        }
        let mut cells = rows.clone();
        for ahead in 1..width.min(h) {
            cells.iter_mut().zip(&rows[ahead * w..]).for_each(|(a, &b)| *a = b.max(*a));
        }
        Self { cells, ..*self }
    }
}

/// Likelihood of points of a map at several resolutions.
#[derive(Debug)]
pub(crate) struct Pyramid {
    geometry: GridGeometry,
    /// Finest first.
    levels: Vec<Level>,
}

/// Where to search: a pose and half widths (metres, radians).
#[derive(Debug, Clone, Copy)]
pub(crate) struct Region {
    pub(crate) center: Isometry2<f64>,
    pub(crate) translation: f64,
    pub(crate) rotation: f64,
}

/// A pose and how well the query fits there: the sum of its points' likelihoods, 0 to 255 each.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fit {
    pub(crate) t: Isometry2<f64>,
    #[cfg(test)]
    sum: u32,
}

impl Fit {
    /// Whether all poses around `t`, up to a distance, are the same optimum.
    fn is_near(&self, t: &Isometry2<f64>, up_to: f64) -> bool {
        let d = self.t.inverse() * t;
        d.translation.vector.norm() + up_to < SAME.0 && d.rotation.angle().abs() < SAME.1
    }
}

/// What a search came to.
#[derive(Debug, Clone)]
pub(crate) enum Outcome {
    /// The best pose and all others that are nearly as good, best first; none is good where it is empty.
    Found(Vec<Fit>),
    /// Too many poses fit nearly alike.
    Undecided,
}

/// A search for the best pose and all that are nearly as good, which can be left and gone on with.
#[derive(Debug)]
pub(crate) struct Search {
    grid: Shifts,
    /// What a pose has to be above, as a sum over the query.
    least: u32,
    /// A pose this good, as a share of the best one's score, is nearly as good.
    rival: f64,
    /// So many poses at most.
    most: usize,
    /// The next angle whose coarsest nodes have not been looked at.
    next_angle: i32,
    open: Open,
    found: Vec<Fit>,
}

/// Nodes to be looked at, by how good they can be: a heap for every few sums, each small enough to be quick.
#[derive(Debug, Default)]
struct Open {
    heaps: Vec<BinaryHeap<Node>>,
    /// No heap beyond it holds anything.
    end: usize,
}

impl Open {
    /// Sums of a heap, as a power of two.
    const SUMS: u32 = 5;

    fn push(&mut self, node: Node) {
        let at = (node.sum >> Self::SUMS) as usize;
        if self.heaps.len() <= at {
            self.heaps.resize_with(at + 1, BinaryHeap::new);
        }
        self.heaps[at].push(node);
        self.end = self.end.max(at + 1);
    }

    /// The greatest.
    fn pop(&mut self) -> Option<Node> {
        while let Some(last) = self.end.checked_sub(1) {
            match self.heaps[last].pop() {
                Some(node) => return Some(node),
                None => self.end = last,
            }
        }
        None
    }
}

impl Search {
    /// What looking at all coarsest nodes takes, in nodes.
    pub(crate) fn num_roots(&self) -> usize {
        (2 * self.grid.num_angles + 1) as usize * self.grid.num_coarsest_as_nodes()
    }

    /// Nodes after which it is given up.
    pub(crate) fn patience(&self) -> usize {
        PATIENCE.max(self.num_roots() + PATIENCE_BEYOND)
    }

    /// Bytes, about.
    pub(crate) fn memory_bytes(&self) -> usize {
        let open: usize = self.open.heaps.iter().map(BinaryHeap::capacity).sum();
        let rotated: usize = self.grid.rotated.iter().map(Vec::capacity).sum();
        open * size_of::<Node>() + rotated * size_of::<(i32, i32)>()
    }
}

/// All shifts of `2^level` cells from (x, y) on at one angle. Ordered by what is looked at first: the best, then the
/// finest; the rest makes the order total.
/// Ten bytes, as a search may leave millions of them open.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Node {
    sum: u16,
    level: Reverse<u8>,
    angle: i16,
    x: i16,
    y: i16,
}

impl Node {
    /// Points of a query have to be so few that the sum holds their likelihoods, and angles and shifts as few as a search has.
    fn new(sum: u32, level: u32, angle: i32, (x, y): (i32, i32)) -> Self {
        Self { sum: sum as u16, level: Reverse(level as u8), angle: angle as i16, x: x as i16, y: y as i16 }
    }
}

impl Pyramid {
    /// Bytes.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.levels.iter().map(|l| l.cells.len()).sum()
    }

    /// Of the points of a map, with cells of so many metres, or of twice as many as often as it takes for the map to have no more than
    /// [`MAX_CELLS`] along an edge; none if there are no points.
    pub(crate) fn new(resolution: f64, points: &[Point2<f64>]) -> Option<Self> {
        let first = *points.first()?;
        let (lo, hi) = points.iter().fold((first, first), |(lo, hi), p| (lo.inf(p), hi.sup(p)));
        // Bounds look one coarsest cell ahead: a margin of it keeps them true at the border.
        let margin = f64::from(1 << DEPTH) + f64::from(REACH);
        let times_too_large = (hi - lo).amax() / resolution / (MAX_CELLS - 2.0 * margin);
        let resolution = resolution * times_too_large.log2().ceil().max(0.0).exp2();
        let cells = |lo: f64, hi: f64| (((hi - lo) / resolution).ceil() + 2.0 * margin) as i32 + 1;
        let geometry = GridGeometry::new(resolution, lo - Vector2::repeat(margin * resolution));
        let (width, height) = (cells(lo.x, hi.x), cells(lo.y, hi.y));
        let mut fine = Level { width, height, cells: vec![0; (width * height) as usize] };
        let kernel = kernel();
        points.iter().for_each(|p| smear(&mut fine, &geometry, &kernel, p));
        let mut plain = fine.clone();
        let mut levels = vec![fine];
        for level in 1..=DEPTH {
            // Where cells are larger than the finest, a shift may begin anywhere within one.
            let (cells, more) = if level > FINER { (1 << FINER, 1) } else { (1 << level, 0) };
            if level > FINER {
                plain = plain.halved();
            }
            levels.push(plain.reaching(cells + more));
        }
        Some(Self { geometry, levels })
    }

    /// The region that holds every pose from which the map could be seen.
    pub(crate) fn everywhere(&self) -> Region {
        let extent = Vector2::new(f64::from(self.levels[0].width), f64::from(self.levels[0].height));
        let half = 0.5 * self.geometry.resolution_m * extent;
        let center = Isometry2::translation(self.geometry.origin.x + half.x, self.geometry.origin.y + half.y);
        Region { center, translation: half.amax(), rotation: std::f64::consts::PI }
    }

    /// Begins a search for what scores more than `min_score`, by the first [`MOST_POINTS`] points of the query.
    pub(crate) fn begin(
        &self,
        query: &[Point2<f64>],
        region: &Region,
        min_score: f64,
        (rival, most): (f64, usize),
    ) -> Search {
        let query = &query[..query.len().min(MOST_POINTS)];
        let grid = Shifts::new(self, query, region);
        let perfect = 255.0 * query.len().max(1) as f64;
        let (least, next_angle) = ((min_score * perfect) as u32, -grid.num_angles);
        Search { grid, least, rival, most, next_angle, open: Open::default(), found: vec![] }
    }

    /// The best pose and all others that are nearly as good, best first; none if that is bad, if they are more than `most`, or
    /// if it takes too long to know.
    pub(crate) fn optima(
        &self,
        query: &[Point2<f64>],
        region: &Region,
        min_score: f64,
        most: (f64, usize),
    ) -> Option<Vec<Fit>> {
        let mut search = self.begin(query, region, min_score, most);
        let mut nodes = search.patience();
        match self.go_on(&mut search, &mut nodes)? {
            Outcome::Found(found) => (!found.is_empty()).then_some(found),
            Outcome::Undecided => None,
        }
    }

    /// Goes on with a search until it has visited about so many nodes, which are counted down; what it came to, if that is
    /// known by then.
    pub(crate) fn go_on(&self, search: &mut Search, nodes: &mut usize) -> Option<Outcome> {
        let coarsest = search.grid.num_coarsest_as_nodes();
        while search.next_angle <= search.grid.num_angles {
            if *nodes < coarsest {
                return None;
            }
            let (first, left) = (search.next_angle, (search.grid.num_angles - search.next_angle + 1) as usize);
            let angles = left.min(*nodes / coarsest);
            *nodes -= angles * coarsest;
            search.next_angle = first + angles as i32;
            let (grid, least) = (&search.grid, search.least);
            let roots = (first..search.next_angle).into_par_iter().flat_map_iter(|a| self.roots(grid, a, least));
            roots.collect::<Vec<_>>().into_iter().for_each(|root| search.open.push(root));
        }
        // The best bound comes first: the first pose that comes is the best.
        while let Some(node) = search.open.pop() {
            if u32::from(node.sum) <= search.least
                || search.found.iter().any(|other| search.grid.is_known(&node, other))
            {
                continue;
            }
            if *nodes == 0 {
                search.open.push(node);
                return None;
            }
            *nodes -= 1;
            if node.level.0 == 0 {
                if search.found.len() == search.most {
                    return Some(Outcome::Undecided);
                }
                if search.found.is_empty() {
                    search.least = (search.rival * f64::from(node.sum)) as u32;
                }
                search.found.push(Fit {
                    t: search.grid.pose(&node),
                    #[cfg(test)]
                    sum: node.sum.into(),
                });
                continue;
            }
            let level = u32::from(node.level.0) - 1;
            let half = 1 << level;
            for (dx, dy) in [(0, 0), (half, 0), (0, half), (half, half)] {
                let (angle, x, y) = (i32::from(node.angle), i32::from(node.x) + dx, i32::from(node.y) + dy);
                if x <= search.grid.reach && y <= search.grid.reach {
                    let sum = self.sum(search.grid.cells(angle), (x, y), level, search.least);
                    if sum > search.least {
                        search.open.push(Node::new(sum, level, angle, (x, y)));
                    }
                }
            }
        }
        Some(Outcome::Found(std::mem::take(&mut search.found)))
    }

    /// The coarsest nodes above `least` at an angle.
    fn roots(&self, grid: &Shifts, angle: i32, least: u32) -> impl Iterator<Item = Node> {
        let shifts = || (-grid.reach..=grid.reach).step_by(1 << DEPTH);
        let at = |(x, y)| {
            let sum = self.sum(grid.cells(angle), (x, y), DEPTH, least);
            (sum > least).then(|| Node::new(sum, DEPTH, angle, (x, y)))
        };
        shifts().flat_map(|y| shifts().map(move |x| (x, y))).filter_map(at).collect::<Vec<_>>().into_iter()
    }

    /// Sum of the bounds at a shift; not more than `least` if it is not above it.
    #[inline]
    fn sum(&self, cells: &[(i32, i32)], (dx, dy): (i32, i32), level: u32, least: u32) -> u32 {
        let l = &self.levels[level as usize];
        let level = level.saturating_sub(FINER);
        let mut sum = 0;
        let mut left = cells.len();
        for chunk in cells.chunks(CHUNK) {
            sum += chunk.iter().map(|&(x, y)| l.at((x + dx) >> level, (y + dy) >> level)).sum::<u32>();
            left -= chunk.len();
            if sum + 255 * left as u32 <= least {
                return 0;
            }
        }
        sum
    }

    fn cell(&self, p: &Point2<f64>) -> (i32, i32) {
        let q = (p - self.geometry.origin) / self.geometry.resolution_m;
        (q.x.floor() as i32, q.y.floor() as i32)
    }
}

/// The poses of a search, by numbers: angles and shifts in fine cells.
#[derive(Debug)]
struct Shifts {
    center: Isometry2<f64>,
    resolution: f64,
    num_angles: i32,
    angle_step: f64,
    reach: i32,
    /// Cells of the query, by angle.
    rotated: Vec<Vec<(i32, i32)>>,
}

impl Shifts {
    fn new(pyramid: &Pyramid, query: &[Point2<f64>], region: &Region) -> Self {
        let resolution = pyramid.geometry.resolution_m;
        let lever = query.iter().map(|p| p.coords.norm()).fold(1.0, f64::max).min(MAX_LEVER_M);
        let num_angles = (region.rotation * lever / resolution).ceil().max(1.0) as i32;
        let angle_step = region.rotation / f64::from(num_angles);
        let reach = (region.translation / resolution).ceil() as i32;
        let turned = |a: i32| {
            let angle = region.center.rotation.angle() + f64::from(a) * angle_step;
            let t = Isometry2::new(region.center.translation.vector, angle);
            query.iter().map(|p| pyramid.cell(&(t * p))).collect::<Vec<_>>()
        };
        let rotated = (-num_angles..=num_angles).into_par_iter().map(turned).collect();
        Self { center: region.center, resolution, num_angles, angle_step, reach, rotated }
    }

    /// What looking at the coarsest nodes of an angle takes, in nodes.
    fn num_coarsest_as_nodes(&self) -> usize {
        (((2 * self.reach) >> DEPTH) as usize + 1).pow(2) / ROOTS_A_NODE + 1
    }

    fn cells(&self, angle: i32) -> &[(i32, i32)] {
        &self.rotated[(angle + self.num_angles) as usize]
    }

    /// The pose of a node's first shift.
    fn pose(&self, n: &Node) -> Isometry2<f64> {
        let shift = Vector2::new(f64::from(n.x), f64::from(n.y)) * self.resolution;
        let angle = self.center.rotation.angle() + f64::from(n.angle) * self.angle_step;
        Isometry2::new(self.center.translation.vector + shift, angle)
    }

    /// Whether all poses of a node are the same optimum as another fit.
    fn is_known(&self, n: &Node, other: &Fit) -> bool {
        let last = f64::from((1 << n.level.0) - 1) * self.resolution;
        let half = Vector2::repeat(0.5 * last);
        let first = self.pose(n);
        let middle = Isometry2::new(first.translation.vector + half, first.rotation.angle());
        other.is_near(&middle, half.norm())
    }
}

/// Offset and likelihood of the cells around a point.
fn kernel() -> Vec<(i32, i32, u8)> {
    let value = |x: i32, y: i32| (255.0 * (-f64::from(x * x + y * y) / (2.0 * SIGMA * SIGMA)).exp()) as u8;
    (-REACH..=REACH).flat_map(|y| (-REACH..=REACH).map(move |x| (x, y, value(x, y)))).collect()
}

fn smear(fine: &mut Level, geometry: &GridGeometry, kernel: &[(i32, i32, u8)], p: &Point2<f64>) {
    let Some(c) = geometry.cell(p) else { return };
    if c.x < REACH || c.y < REACH || c.x + REACH >= fine.width || c.y + REACH >= fine.height {
        return;
    }
    // Full likelihood is that of a point in the cell itself, and another there adds nothing.
    if fine.cells[(c.y * fine.width + c.x) as usize] == u8::MAX {
        return;
    }
    for &(dx, dy, value) in kernel {
        let cell = &mut fine.cells[((c.y + dy) * fine.width + c.x + dx) as usize];
        *cell = value.max(*cell);
    }
}
