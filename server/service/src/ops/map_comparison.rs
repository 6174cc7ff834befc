//! The occupancy grid against an older one of the place: what appeared, what has gone.

use super::maps::{dense, stamp_of};
use super::pictures;
use crate::{Error, ErrorCode, Result, Service, reason};
use percept_formats::GridMap;
use percept_geometry::Timestamp;
use percept_mapping::DenseGrid;
use percept_pictures::{Changes, GridView, PictureError};
use std::sync::Arc;

/// The farthest that walls may be off, cells of the finer grid.
const MAX_TOLERANCE_CELLS: f64 = 10.0;

/// What a map is compared with.
#[derive(Debug, Clone)]
pub enum MapBefore {
    /// The map of a session, as it is now.
    Session(String),
    /// Cells in the map frame.
    Grid(DenseGrid),
}

/// What became of a place.
#[derive(Debug, Clone)]
pub struct MapComparison {
    /// The picture.
    pub png: Vec<u8>,
    /// Cells that changed.
    pub changes: Changes,
    /// Version of the newer map.
    pub map_version: u64,
    /// Stamp of the newest frame in it.
    pub stamp: Timestamp,
}

impl Service {
    /// What appeared in the map of a session and what has gone since an older one of the place.
    ///
    /// # Errors
    /// `MAP_EMPTY`, `GRID_TOO_LARGE`, `OUT_OF_RANGE` naming `tolerance_m`, `SESSION_NOT_FOUND`, `PICTURE_TOO_LARGE`.
    pub async fn compare_maps(
        &self,
        session: &str,
        before: MapBefore,
        tolerance_m: Option<f64>,
    ) -> Result<MapComparison> {
        let after = self.snapshot(session).await?;
        let older = match &before {
            MapBefore::Session(id) => Some(self.snapshot(id).await?),
            MapBefore::Grid(_) => None,
        };
        let (title, limits) = (session.to_owned(), Arc::clone(&self.limits));
        let work = move || {
            let grid = |snapshot: &percept_pipeline::Snapshot| dense(&snapshot.layers.occupancy, None, None, &limits);
            let (map_version, stamp) = (after.map_version, stamp_of(&after));
            let newer = there(grid(&after)?, "")?;
            let (words, older) = match (before, older) {
                (MapBefore::Grid(DenseGrid { geometry, width, height, cells }), _) => {
                    ("the map that was sent".to_owned(), GridMap { geometry, width, height, cells })
                }
                (MapBefore::Session(id), Some(snapshot)) => (id, there(grid(&snapshot)?, "session_id")?),
                (MapBefore::Session(id), None) => return Err(Error::internal(format!("no snapshot of {id}"))),
            };
            let (png, changes) = drawn(&older, &newer, tolerance_m, &format!("{title}, since {words}"))?;
            Ok(MapComparison { png, changes, map_version, stamp })
        };
        self.compute.query(&self.asker(session)?, work).await?
    }
}

fn there(grid: GridMap, field: &str) -> Result<GridMap> {
    if !grid.cells.is_empty() {
        return Ok(grid);
    }
    let error = Error::new(ErrorCode::FailedPrecondition, reason::MAP_EMPTY, "the map is empty; send frames first");
    Err(Error { field: field.to_owned(), ..error })
}

fn drawn(before: &GridMap, after: &GridMap, tolerance_m: Option<f64>, title: &str) -> Result<(Vec<u8>, Changes)> {
    let finer = before.geometry.resolution_m.min(after.geometry.resolution_m);
    let tolerance = tolerance_m.unwrap_or(finer);
    if !(0.0..=MAX_TOLERANCE_CELLS * finer).contains(&tolerance) {
        let most = MAX_TOLERANCE_CELLS * finer;
        let words = format!("tolerance_m is {tolerance}; choose 0 to {most}, ten cells of the finer grid");
        return Err(Error::invalid(reason::OUT_OF_RANGE, "tolerance_m", words));
    }
    let drawn = percept_pictures::before_after(GridView::from(before), GridView::from(after), tolerance, title);
    let (image, changes) = drawn.map_err(|e| match e {
        PictureError::GridTooLarge { .. } => {
            let words = format!("both maps together are too large for a picture: {e}");
            Error::exhausted(reason::PICTURE_TOO_LARGE, "before", words)
        }
        e => pictures::refused(&e),
    })?;
    Ok((pictures::png(Ok(image))?, changes))
}
