//! What each operation needs: the one table, for all doors.
//!
//! An operation is named as its rpc is, whichever door it came through. What is in no line here is refused.

use crate::{Error, Result};
use percept_identity::Access;

/// What an operation is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum About {
    /// One session: of the caller's tenant, and fitting the pattern of a grant.
    Session,
    /// No session, or all that the caller may see: any grant will do.
    Nothing,
}

/// What an operation needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rule {
    /// `Service/Method` of the contract, or `Service/*`.
    pub operation: &'static str,
    /// The least access that a grant must have.
    pub access: Access,
    /// What it is about.
    pub about: About,
    /// Whether the audit log tells when it was done, not only when it was refused.
    pub audited: bool,
}

const fn session(operation: &'static str, access: Access) -> Rule {
    Rule { operation, access, about: About::Session, audited: false }
}

const fn nothing(operation: &'static str, access: Access) -> Rule {
    Rule { operation, access, about: About::Nothing, audited: false }
}

const fn audited(rule: Rule) -> Rule {
    Rule { audited: true, ..rule }
}

use Access::{Admin, Read, Write};

/// Every operation.
#[rustfmt::skip]
pub static RULES: &[Rule] = &[
    audited(session("SessionsService/CreateSession", Write)),
    session("SessionsService/GetSession", Read),
    nothing("SessionsService/ListSessions", Read),
    audited(session("SessionsService/UpdateSession", Write)),
    audited(session("SessionsService/DeleteSession", Admin)),
    audited(session("SessionsService/StartRecording", Write)),
    audited(session("SessionsService/StopRecording", Write)),
    session("SessionsService/ListRecordings", Read),
    audited(session("SessionsService/DeleteRecording", Admin)),
    session("SessionsService/GetPose", Read),
    audited(session("SessionsService/SetPose", Write)),
    session("SessionsService/LookupTransform", Read),
    session("SessionsService/GetTrajectory", Read),
    session("SessionsService/ListKeyframes", Read),
    session("SessionsService/WatchSession", Read),
    nothing("SessionsService/WatchSessions", Read),
    nothing("SessionsService/GetDefaultParams", Read),

    audited(session("SensorsService/DeclareSensor", Write)),
    session("SensorsService/GetSensor", Read),
    session("SensorsService/ListSensors", Read),
    audited(session("SensorsService/UpdateSensor", Write)),
    session("SensorsService/StreamFrames", Write),
    session("SensorsService/SendFrame", Write),
    nothing("SensorsService/SyncTime", Read),
    nothing("ServerService/GetServerInfo", Read),

    session("MapsService/GetMapSummary", Read),
    session("MapsService/GetOccupancyGrid", Read),
    session("MapsService/GetCloud", Read),
    session("MapsService/ListLoops", Read),
    audited(session("MapsService/SetLoopVeto", Write)),
    session("MapsService/OptimiseMap", Write),
    audited(session("MapsService/ImportMap", Write)),
    // The map of another session needs what MapsService/GetOccupancyGrid does, too.
    session("MapsService/CompareMaps", Read),
    session("MapsService/ExportMap", Read),

    session("LayersService/GetVoxels", Read),
    session("LayersService/QueryPoints", Read),
    session("LayersService/CastRays", Read),
    session("LayersService/CheckBoxes", Read),
    session("LayersService/GetHeights", Read),
    session("LayersService/GetMesh", Read),
    session("LayersService/GetChanges", Read),

    session("SceneService/ListObjects", Read),
    session("SceneService/GetObject", Read),
    session("SceneService/GetSceneGraph", Read),
    session("SceneService/GetRooms", Read),
    session("SceneService/NameRoom", Write),
    session("SceneService/CorrectObject", Write),
    session("SceneService/ListObjectClasses", Read),
    session("SceneService/ForgetObjectClass", Write),
    session("SceneService/RouteToRoom", Read),

    // They are the tenant's; deleting one is felt by all of it.
    audited(nothing("DetectorsService/UploadDetector", Write)),
    nothing("DetectorsService/ListDetectors", Read),
    audited(nothing("DetectorsService/DeleteDetector", Admin)),

    // A path is a question about the map; a step of a robot brings a frame.
    session("NavigationService/PlanPath", Read),
    session("NavigationService/DrawPath", Read),
    session("NavigationService/ValidatePath", Read),
    session("NavigationService/WatchPath", Read),
    session("NavigationService/PlanCoverage", Read),
    session("NavigationService/FindFrontiers", Read),
    session("NavigationService/PlanFlight", Read),
    session("NavigationService/Navigate", Write),

    // They take computing time, and memory for clouds, which are the caller's alone. One that works on a session's cloud
    // needs what MapsService/GetCloud does, too.
    nothing("ToolboxKeptCloudsService/*", Write),
    nothing("ToolboxCloudsService/*", Write),
    nothing("ToolboxShapesService/*", Write),
    nothing("ToolboxSegmentationService/*", Write),
    nothing("ToolboxRegistrationService/*", Write),
    nothing("ToolboxDepthService/*", Write),
    nothing("ToolboxImagesService/*", Write),
    nothing("ToolboxPicturesService/*", Write),
    nothing("ToolboxPipelinesService/*", Write),
    nothing("ToolboxPlanningService/*", Write),
    nothing("EvaluationService/*", Write),

    // The caller's own alone; one that is started needs what the plain call does, too.
    nothing("OperationsService/*", Read),
];

/// The rule of an operation; none if there is no such operation.
pub fn rule(operation: &str) -> Option<&'static Rule> {
    let of_all = |rule: &Rule| {
        let service = rule.operation.strip_suffix('*');
        service.is_some_and(|service| operation.starts_with(service) && operation.len() > service.len())
    };
    RULES.iter().find(|rule| rule.operation == operation || of_all(rule))
}

/// The rule of an operation of ours.
pub(super) fn own(operation: &'static str) -> Result<&'static Rule> {
    rule(operation).ok_or_else(|| Error::internal(format!("no rule for {operation}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_operation_has_one_rule_and_what_is_none_has_no_rule() {
        assert_eq!(rule("ToolboxCloudsService/CropCloud").map(|r| r.access), Some(Write));
        assert_eq!(rule("SessionsService/DeleteSession").map(|r| r.access), Some(Admin));
        for none in [
            "",
            "ToolboxCloudsService",
            "ToolboxCloudsService/",
            "ToolboxService/CropCloud",
            "SessionsService/Delete",
            "SessionsService/*x",
        ] {
            assert_eq!(rule(none), None, "{none}");
        }
        for (i, a) in RULES.iter().enumerate() {
            assert!(RULES[i + 1..].iter().all(|b| a.operation != b.operation), "{} is there twice", a.operation);
        }
    }
}
