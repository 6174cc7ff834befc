//! What a layer of the map is: what it takes, how submaps' parts of it are laid over each other, stored and versioned.

use crate::bytes::{Damaged, Reader};
use crate::keyframe_view::KeyframeView;
use nalgebra::{Point2, Point3};
use percept_geometry::{Aabb3, Pose};

/// A layer: what it holds of one submap, and how such parts become one.
///
/// A further layer is a file that implements this, and its line in the list of `layers.rs`. A part is filled keyframe by
/// keyframe in the submap's own frame, then frozen. The map's is composed of the parts, tile by tile, in the order in which
/// the submaps were begun: each part is laid over what those before it have left, so it has to hold what it saw free as
/// well as what it hit.
pub trait Layer: Clone + Send + Sync + Sized + 'static {
    /// What can be tuned.
    type Params: Copy + Send + Sync;
    /// What one keyframe says, whatever the part holds: many can be prepared at once.
    type Update: Send;
    /// A tile while parts are laid over each other.
    type Under: Clone + Send + Sync;
    /// A composed tile, for reading.
    type Tile: PartialEq + Send + Sync;

    /// An empty part; parameters are sound.
    fn new(params: &Self::Params) -> Self;
    /// What a keyframe says.
    fn prepare(params: &Self::Params, view: &KeyframeView<'_>) -> Self::Update;
    /// What an update may change, submap's frame; empty if nothing.
    fn touched(params: &Self::Params, update: &Self::Update) -> Aabb3;
    /// Adds an update.
    fn add(&mut self, update: &Self::Update);
    /// Nothing will be added any more.
    fn freeze(&mut self);

    /// Edge of a cell or voxel, metres; 0 of a layer that is off.
    fn cell_m(params: &Self::Params) -> f64;
    /// How far from a sensor it keeps what was seen, metres; 0 of a layer that is off.
    fn range_max_m(params: &Self::Params) -> f64;
    /// Edge of a tile of the map, metres.
    fn tile_edge_m(params: &Self::Params) -> f64;
    /// A tile of which nothing is known.
    fn unknown(params: &Self::Params, tile: TileKey) -> Self::Under;
    /// Lays this part over what earlier ones say of a tile.
    fn overlay(&self, params: &Self::Params, place: &Placement, tile: TileKey, under: &mut Self::Under);
    /// The tile as it is read; none if nothing is known of it.
    fn finish(params: &Self::Params, tile: TileKey, under: &Self::Under) -> Option<Self::Tile>;

    /// What the part takes, bytes.
    fn memory_bytes(&self) -> usize;
    /// What a tile takes, bytes.
    fn tile_bytes(tile: &Self::Tile) -> usize;
    /// What a tile takes while parts are laid over each other, bytes.
    fn under_bytes(under: &Self::Under) -> usize;
    /// Where the part says anything: tiles of its own frame.
    fn footprint(&self, params: &Self::Params) -> Footprint;
    /// The part as bytes; the same part always gives the same.
    fn encode(&self, out: &mut Vec<u8>);
    /// The part from its bytes.
    ///
    /// # Errors
    /// `Damaged`.
    fn decode(params: &Self::Params, from: &mut Reader<'_>) -> Result<Self, Damaged>;
}

/// Column and row of a tile of the map: square in x and y, of all heights.
pub type TileKey = (i32, i32);

/// Tiles of a submap's frame in which its part says anything: a box around them says little, as a robot sees far through doors.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Footprint(Vec<TileKey>);

impl Footprint {
    /// Of tiles in any order.
    pub(crate) fn of(mut tiles: Vec<TileKey>) -> Self {
        tiles.sort_unstable();
        tiles.dedup();
        Self(tiles)
    }

    /// Whether the part says anything in a tile of its own frame.
    pub(crate) fn holds(&self, tile: TileKey) -> bool {
        self.0.binary_search(&tile).is_ok()
    }

    /// Whether the part may say anything about a tile of the map. It and the floor lie within `bounds`, map frame.
    pub(crate) fn reaches(&self, edge_m: f64, place: &Placement, bounds: &Aabb3, tile: TileKey) -> bool {
        if place.is_aligned() {
            return self.holds(tile);
        }
        // Means of voxels may stick out of their tile by what rounding errs.
        let margin = 1e-3;
        let at = |k: i32| f64::from(k) * edge_m;
        let (low, high) = (bounds.min.z.min(place.floor_z_m) - margin, bounds.max.z.max(place.floor_z_m) + margin);
        let column = Aabb3 {
            min: Point3::new(at(tile.0) - margin, at(tile.1) - margin, low),
            max: Point3::new(at(tile.0) + edge_m + margin, at(tile.1) + edge_m + margin, high),
        };
        let Some((first, last)) = tiles_of(edge_m, &moved(&place.t_map_submap.inverse(), &column)) else {
            return false;
        };
        let columns = self.0.partition_point(|t| t.0 < first.0)..self.0.partition_point(|t| t.0 <= last.0);
        self.0[columns].iter().any(|t| (first.1..=last.1).contains(&t.1))
    }

    pub(crate) fn memory_bytes(&self) -> usize {
        size_of_val(&self.0[..])
    }
}

/// Where a submap lies in the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    /// Submap to map.
    pub t_map_submap: Pose,
    /// Height of its floor in the map, metres: the plane in which a 2D layer turns.
    pub floor_z_m: f64,
}

impl Placement {
    /// Of what is in the map's own frame.
    pub(crate) fn of_map() -> Self {
        Self { t_map_submap: Pose::identity(), floor_z_m: 0.0 }
    }

    /// Whether the submap's frame is the map's: its cells are the map's cells then.
    pub fn is_aligned(&self) -> bool {
        self.t_map_submap == Pose::identity()
    }

    /// The submap's coordinates of the points of the map's floor: `origin + x * along_x + y * along_y`, for x, y in metres.
    pub(crate) fn floor_in_submap(&self) -> impl Fn(Point2<f64>) -> Point2<f64> + use<> {
        let t_submap_map = self.t_map_submap.inverse();
        let at = |x: f64, y: f64| (t_submap_map * Point3::new(x, y, self.floor_z_m)).xy();
        let origin = at(0.0, 0.0);
        let (along_x, along_y) = (at(1.0, 0.0) - origin, at(0.0, 1.0) - origin);
        move |p| origin + along_x * p.x + along_y * p.y
    }
}

/// A box after a motion: around all its corners.
pub(crate) fn moved(t_a_b: &Pose, b: &Aabb3) -> Aabb3 {
    let mut out = Aabb3::empty();
    if !b.is_empty() {
        for corner in 0..8 {
            let axis = |i: usize| if corner >> i & 1 == 0 { b.min[i] } else { b.max[i] };
            out.grow(&(t_a_b * Point3::new(axis(0), axis(1), axis(2))));
        }
    }
    out
}

/// Both boxes in one.
pub(crate) fn joined(a: &Aabb3, b: &Aabb3) -> Aabb3 {
    Aabb3 { min: a.min.inf(&b.min), max: a.max.sup(&b.max) }
}

/// Tiles that a box in the map reaches into: smallest and largest column and row; none of an empty box.
pub(crate) fn tiles_of(edge_m: f64, b: &Aabb3) -> Option<(TileKey, TileKey)> {
    if b.is_empty() {
        return None;
    }
    // A float beyond the range of i32 becomes the nearest that is in it.
    let tile = |v: f64| (v / edge_m).floor() as i32;
    Some(((tile(b.min.x), tile(b.min.y)), (tile(b.max.x), tile(b.max.y))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use percept_geometry::se3;

    #[test]
    fn a_part_reaches_every_tile_of_the_map_that_what_it_says_comes_to_lie_in() {
        let (edge, mut far) = (3.2, 0);
        for i in 0..400 {
            let spread = |m: u32| f64::from((i as u32).wrapping_mul(m) >> 16) / 65536.0 - 0.5;
            let turn =
                Vector3::new(0.02 * spread(668_265_263), 0.02 * spread(374_761_393), 6.0 * spread(1_103_515_245));
            let shift = Vector3::new(9.0 * spread(2_654_435_761), 9.0 * spread(2_246_822_519), spread(3_266_489_917));
            let t_map_submap = Pose::from_parts(shift.into(), nalgebra::UnitQuaternion::from_scaled_axis(turn));
            let place = Placement { t_map_submap, floor_z_m: 0.1 };
            // Something at some height in one tile of the submap.
            let p = Point3::new(40.0 * spread(2_147_483_647), 40.0 * spread(97_531), 6.0 * spread(19_260_817) + 3.0);
            let tile = |p: &Point3<f64>| ((p.x / edge).floor() as i32, (p.y / edge).floor() as i32);
            let footprint = Footprint::of(vec![tile(&p), tile(&p)]);
            let mut bounds = Aabb3::empty();
            bounds.grow(&(t_map_submap * p));
            let lands = tile(&(t_map_submap * p));
            assert!(footprint.reaches(edge, &place, &bounds, lands), "{i}");
            far += usize::from(!footprint.reaches(edge, &place, &bounds, (lands.0 + 2, lands.1 - 1)));
            let aligned = Placement { t_map_submap: Pose::identity(), floor_z_m: 0.0 };
            assert!(footprint.reaches(edge, &aligned, &bounds, tile(&p)));
            assert!(!footprint.reaches(edge, &aligned, &bounds, (tile(&p).0, tile(&p).1 + 1)));
        }
        assert!(far > 350, "{far}");
        assert!(!Footprint::of(vec![]).reaches(
            edge,
            &Placement { t_map_submap: se3::from_xy_yaw(0.1, 0.0, 0.0), floor_z_m: 0.0 },
            &Aabb3::empty(),
            (0, 0)
        ));
    }
}
