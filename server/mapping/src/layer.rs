//! What a layer of the map is: what it takes, how submaps' parts of it are laid over each other, stored and versioned.

use crate::bytes::{Damaged, Reader};
use crate::layers::{LayerBoxes, SubmapLayers};
use nalgebra::{Point2, Point3};
use percept_geometry::{Aabb3, KeyframeScan, Pose};

/// A layer: what it holds of one submap, and how such parts become one.
///
/// A further layer is a file that implements this, and its line in each list of `layers.rs`. A part is filled keyframe by
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
    /// What a keyframe taken at `t_submap_base` says.
    fn prepare(params: &Self::Params, t_submap_base: &Pose, scan: &KeyframeScan) -> Self::Update;
    /// What an update may change, submap's frame; empty if nothing.
    fn touched(params: &Self::Params, update: &Self::Update) -> Aabb3;
    /// Adds an update.
    fn add(&mut self, update: &Self::Update);
    /// Nothing will be added any more.
    fn freeze(&mut self);

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
    /// The part as bytes; the same part always gives the same.
    fn encode(&self, out: &mut Vec<u8>);
    /// The part from its bytes.
    ///
    /// # Errors
    /// `Damaged`.
    fn decode(params: &Self::Params, from: &mut Reader<'_>) -> Result<Self, Damaged>;

    /// This layer's part among those of a submap.
    fn of(layers: &SubmapLayers) -> &Self;
    /// Its box among those of a submap's parts.
    fn bounds(boxes: &LayerBoxes) -> &Aabb3;
}

/// Column and row of a tile of the map: square in x and y, of all heights.
pub type TileKey = (i32, i32);

/// Where a submap lies in the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    /// Submap to map.
    pub t_map_submap: Pose,
    /// Height of its floor in the map, metres: the plane in which a 2D layer turns.
    pub floor_z_m: f64,
}

impl Placement {
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
