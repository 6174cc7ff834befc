//! Zones that are stored as cells: the masks of nav2's costmap filters.

use crate::{Error, Result, reason};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use percept_formats::nav2::{self, GridMap, ImageKind, MapYaml, Mode};
use percept_geometry::GridGeometry;
use percept_mapping::DenseGrid;
use percept_planning::{Mask, MaskKind};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Masks of a session, at most.
const MAX_MASKS: usize = 8;
/// What they take together where they are stored, packed, at most.
const MAX_PACKED_BYTES: usize = 1 << 20;
/// Characters of a mask's name, at most.
const MAX_NAME_CHARS: usize = 64;
/// Base and multiplier of a speed mask are within this.
const MAX_FACTOR: f64 = 1e4;

/// A mask with its name.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionMask {
    /// By which it is kept in a change; of its own within the session.
    pub name: String,
    /// What its values mean.
    pub meaning: MaskMeaning,
    /// Where its cells lie, and their values.
    pub cells: Arc<MaskCells>,
}

/// What the values of a mask mean.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MaskMeaning {
    /// Cells that are occupied are keep-out.
    KeepOut,
    /// `base + multiplier * value` limits the speed; the value 0 and unknown do not.
    Speed {
        /// At the value 0.
        base: f64,
        /// More for each step of the value.
        multiplier: f64,
        /// What that is.
        unit: SpeedUnit,
    },
}

/// How a limit of speed is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SpeedUnit {
    /// Per cent of what the robot drives at most.
    Percent,
    /// Metres a second.
    MetresPerSecond,
}

/// The cells of a mask, as they are used and as they are stored.
#[derive(Debug)]
pub struct MaskCells {
    /// Map frame; -1 unknown, 0 to 100.
    pub grid: Arc<DenseGrid>,
    packed: Vec<u8>,
}

impl PartialEq for MaskCells {
    fn eq(&self, other: &Self) -> bool {
        self.grid.geometry == other.grid.geometry && self.packed == other.packed
    }
}

/// A mask as a change has it: what is none stays as it is stored.
#[derive(Debug, Clone, PartialEq)]
pub struct MaskChange {
    /// Its name.
    pub name: String,
    /// What its values mean.
    pub meaning: Option<MaskMeaning>,
    /// Its cells.
    pub cells: Option<Arc<MaskCells>>,
}

impl MaskCells {
    /// Cells of a sound grid.
    ///
    /// # Errors
    /// `OUT_OF_RANGE` for a grid without cells or with values that are none, `GRID_TOO_LARGE`.
    pub fn new(grid: DenseGrid, limits: &crate::Limits) -> Result<Self> {
        let unsound = |e: &dyn std::fmt::Display| Error::invalid(reason::OUT_OF_RANGE, "", e.to_string());
        grid.validate().map_err(|e| unsound(&e))?;
        let (cells, limit) = (grid.cells.len(), limits.max_planning_cells);
        if cells == 0 {
            let size = format!("{} x {}", grid.width, grid.height);
            return Err(unsound(&format!("the mask has {size} cells; give one that has some")));
        }
        if cells > limit {
            let words = format!("the mask has {cells} cells, a search looks at {limit} at most; use a coarser one");
            return Err(Error::exhausted(reason::GRID_TOO_LARGE, "", words));
        }
        let DenseGrid { geometry, width, height, cells } = grid;
        let map = GridMap { geometry, width, height, cells };
        let packed = nav2::encode_image(&map, Mode::Raw, ImageKind::Png).map_err(Error::internal)?;
        let GridMap { geometry, width, height, cells } = map;
        Ok(Self { grid: Arc::new(DenseGrid { geometry, width, height, cells }), packed })
    }

    fn unpacked(packed: Vec<u8>, geometry: GridGeometry) -> std::result::Result<Self, percept_formats::FormatError> {
        let yaml = MapYaml {
            image: String::new(),
            resolution_m: geometry.resolution_m,
            origin: geometry.origin,
            yaw_rad: 0.0,
            negate: false,
            occupied_thresh: 0.65,
            free_thresh: 0.196,
            mode: Mode::Raw,
        };
        let GridMap { geometry, width, height, cells } =
            nav2::decode(&yaml, &packed, &percept_formats::Limits::default())?;
        Ok(Self { grid: Arc::new(DenseGrid { geometry, width, height, cells }), packed })
    }
}

impl MaskMeaning {
    /// For planning, by a robot that drives no faster than this (m/s).
    pub fn kind(&self, max_speed_mps: f64) -> MaskKind {
        match *self {
            Self::KeepOut => MaskKind::KeepOut,
            Self::Speed { base, multiplier, unit: SpeedUnit::Percent } => MaskKind::SpeedLimit { base, multiplier },
            Self::Speed { base, multiplier, unit: SpeedUnit::MetresPerSecond } => {
                let percent = 100.0 / max_speed_mps;
                MaskKind::SpeedLimit { base: base * percent, multiplier: multiplier * percent }
            }
        }
    }

    fn check(&self, grid: &DenseGrid) -> Result<()> {
        let Self::Speed { base, multiplier, unit } = *self else { return Ok(()) };
        for (field, value) in [("speed.base", base), ("speed.multiplier", multiplier)] {
            if !(-MAX_FACTOR..=MAX_FACTOR).contains(&value) {
                let words = format!("{field} is {value}; choose -10000 to 10000");
                return Err(Error::invalid(reason::OUT_OF_RANGE, field, words));
            }
        }
        // A mask that was drawn for this and limits nothing is a mistake: most often a yaml whose mode is trinary.
        let values = grid.cells.iter().copied().filter(|v| *v > 0);
        let (low, high) = values.fold((i8::MAX, 0), |(low, high), v| (low.min(v), high.max(v)));
        let at = |v: i8| base + multiplier * f64::from(v);
        let limits = |v: f64| v > 0.0 && (v < 100.0 || unit == SpeedUnit::MetresPerSecond);
        let has_some = high == 0 || grid.cells.iter().any(|v| *v > 0 && limits(at(*v)));
        if has_some {
            return Ok(());
        }
        let words = format!(
            "no cell limits the speed: the values {low} to {high} come to {} to {}; set mode: scale or raw in the mask's yaml, \
             or another base and multiplier",
            at(low),
            at(high)
        );
        Err(Error::invalid(reason::OUT_OF_RANGE, "speed", words))
    }
}

impl SessionMask {
    /// A mask of these cells.
    ///
    /// # Errors
    /// `OUT_OF_RANGE` for speeds that are none.
    pub fn new(name: String, meaning: MaskMeaning, cells: Arc<MaskCells>) -> Result<Self> {
        meaning.check(&cells.grid)?;
        Ok(Self { name, meaning, cells })
    }

    /// For planning, by a robot that drives no faster than this (m/s).
    pub fn mask(&self, max_speed_mps: f64) -> Mask<'_> {
        Mask { grid: &self.cells.grid, kind: self.meaning.kind(max_speed_mps) }
    }

    /// For a picture.
    pub fn drawn(&self, max_speed_mps: f64, occupied_probability: f64) -> percept_pictures::ZoneMask {
        let kind = self.meaning.kind(max_speed_mps);
        let of = |value: i8| {
            let value = u8::try_from(value).ok()?;
            match kind {
                MaskKind::KeepOut if f64::from(value) >= 100.0 * occupied_probability => {
                    Some(percept_pictures::ZoneKind::KeepOut)
                }
                MaskKind::KeepOut => None,
                kind => Some(percept_pictures::ZoneKind::SpeedLimit { share: kind.speed_share(value)? }),
            }
        };
        percept_pictures::ZoneMask { grid: Arc::clone(&self.cells.grid), kinds: (-1..=100).map(of).collect() }
    }
}

/// What becomes of the masks of a session.
///
/// # Errors
/// `OUT_OF_RANGE`, `DISPLAY_NAME_INVALID`, `FIELD_MISSING`, `GRID_TOO_LARGE`, naming the mask.
pub(super) fn changed(stored: &[SessionMask], changes: &[MaskChange]) -> Result<Vec<SessionMask>> {
    if changes.len() > MAX_MASKS {
        let words = format!("there are {} masks, at most {MAX_MASKS} are stored; merge some", changes.len());
        return Err(Error::invalid(reason::OUT_OF_RANGE, "zone_masks", words));
    }
    let mut out: Vec<SessionMask> = Vec::with_capacity(changes.len());
    for (i, change) in changes.iter().enumerate() {
        let place = format!("zone_masks[{i}]");
        if out.iter().any(|mask| mask.name == change.name) {
            let words = format!("two masks are called {:?}; give each a name of its own", change.name);
            return Err(Error::invalid(reason::DISPLAY_NAME_INVALID, format!("{place}.name"), words));
        }
        out.push(one(stored, change).map_err(|e| e.within(&place))?);
    }
    let packed: usize = out.iter().map(|mask| mask.cells.packed.len()).sum();
    if packed > MAX_PACKED_BYTES {
        let words = format!("the masks take {packed} bytes packed, the limit is {MAX_PACKED_BYTES}; use coarser ones");
        return Err(Error::exhausted(reason::GRID_TOO_LARGE, "zone_masks", words));
    }
    Ok(out)
}

fn one(stored: &[SessionMask], change: &MaskChange) -> Result<SessionMask> {
    let MaskChange { name, meaning, cells } = change;
    let num_chars = name.chars().count();
    if num_chars == 0 || num_chars > MAX_NAME_CHARS || name.chars().any(char::is_control) {
        let words = format!("the name has to have 1 to {MAX_NAME_CHARS} characters, and no control characters");
        return Err(Error::invalid(reason::DISPLAY_NAME_INVALID, "name", words));
    }
    let old = stored.iter().find(|mask| mask.name == *name);
    let missing = |field: &str, words: String| Error::invalid(reason::FIELD_MISSING, field, words);
    let Some(cells) = cells.clone().or_else(|| old.map(|mask| Arc::clone(&mask.cells))) else {
        let words = format!("there is no map, and no stored mask is called {name:?}; give a grid, or nav2 files");
        return Err(missing("map", words));
    };
    let Some(meaning) = meaning.or(old.map(|mask| mask.meaning)) else {
        return Err(missing("kind", "kind is missing; set keep_out, or give speed".to_owned()));
    };
    SessionMask::new(name.clone(), meaning, cells)
}

/// As it is stored.
#[derive(Serialize, Deserialize)]
struct Record {
    name: String,
    meaning: MaskMeaning,
    resolution_m: f64,
    origin: [f64; 2],
    /// A PNG whose pixels are the values, 255 unknown; base64.
    png: String,
}

impl Serialize for SessionMask {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        let geometry = &self.cells.grid.geometry;
        let record = Record {
            name: self.name.clone(),
            meaning: self.meaning,
            resolution_m: geometry.resolution_m,
            origin: [geometry.origin.x, geometry.origin.y],
            png: STANDARD.encode(&self.cells.packed),
        };
        record.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for SessionMask {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        use serde::de::Error as _;
        let Record { name, meaning, resolution_m, origin, png } = Record::deserialize(deserializer)?;
        let packed = STANDARD.decode(png).map_err(D::Error::custom)?;
        let geometry = GridGeometry::new(resolution_m, origin.into());
        let cells = Arc::new(MaskCells::unpacked(packed, geometry).map_err(D::Error::custom)?);
        Ok(Self { name, meaning, cells })
    }
}
