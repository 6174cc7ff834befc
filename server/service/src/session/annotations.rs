//! What people add to a map: zones, and names of rooms.

use nalgebra::Point2;
use percept_planning::{Zone, ZoneKind};
use serde::{Deserialize, Serialize};

/// A zone with its name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(from = "Record", into = "Record")]
pub struct SessionZone {
    /// For people; may be empty.
    pub name: String,
    /// The area, and what holds there.
    pub zone: Zone,
}

/// As it is stored.
#[derive(Serialize, Deserialize)]
struct Record {
    #[serde(default, skip_serializing_if = "String::is_empty")]
    name: String,
    polygon: Vec<[f64; 2]>,
    /// None: keep out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    speed_share: Option<f64>,
}

impl From<Record> for SessionZone {
    fn from(r: Record) -> Self {
        let kind = r.speed_share.map_or(ZoneKind::KeepOut, |share| ZoneKind::SpeedLimit { share });
        let polygon = r.polygon.iter().map(|[x, y]| Point2::new(*x, *y)).collect();
        Self { name: r.name, zone: Zone { polygon, kind } }
    }
}

impl From<SessionZone> for Record {
    fn from(z: SessionZone) -> Self {
        let speed_share = match z.zone.kind {
            ZoneKind::KeepOut => None,
            ZoneKind::SpeedLimit { share } => Some(share),
        };
        Self { name: z.name, polygon: z.zone.polygon.iter().map(|p| [p.x, p.y]).collect(), speed_share }
    }
}

/// What people call a room: pinned to a place as a keyframe sees it, so that it moves with the map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RoomName {
    /// The name.
    pub name: String,
    /// Number of the keyframe.
    pub keyframe: u64,
    /// The place in that keyframe's base, metres.
    pub at: [f64; 2],
}
