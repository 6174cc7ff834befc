//! The catalogue of reasons: every stable word by which an error is told apart, with what it means and what to do.
//!
//! Errors take their reason from here, and a test holds that there is none elsewhere. `docs/reasons.md`, the REST
//! door's `/reasons` and the OpenAPI document show it; after a change run `docs/refresh-reasons`.

use crate::ErrorCode;

/// A reason, as the catalogue has it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Entry {
    /// Stable, upper-case.
    pub name: &'static str,
    /// The code that it comes with where a request is refused for it.
    pub code: ErrorCode,
    /// What it means, and what to do.
    pub about: &'static str,
}

macro_rules! reasons {
    ($($code:ident { $($name:ident: $about:literal,)* })*) => {
        $($(
            #[doc = $about]
            pub const $name: &str = stringify!($name);
        )*)*

        /// Every reason, by code.
        pub static CATALOGUE: &[Entry] =
            &[$($(Entry { name: stringify!($name), code: ErrorCode::$code, about: $about },)*)*];
    };
}

reasons! {
    InvalidArgument {
        BODY_BROKEN: "The body ended before its length; send it whole.",
        CLASS_NAME_INVALID: "The name of a class is empty, longer than 31 bytes, or has control characters.",
        CLOCK_SET_BACK: "The sensor's stamps lie far before its last; if that one was wrong, declare the sensor under another name; if the robot's clock was set back, all its sensors, with a time_offset_s.",
        CLOUD_DEGENERATE: "All points of the cloud are one; check the driver.",
        CLOUD_EMPTY: "The cloud has no finite point; check the sensor.",
        COLOUR_SIZE_MISMATCH: "Depth and colour have different sizes; register them to each other first.",
        CONTENT_ENCODING_UNSUPPORTED: "The body is compressed in a way that is not read; send it as it is, or as gzip.",
        CORRESPONDENCES_TOO_FEW: "There are fewer pairs of points than the method needs; send more.",
        CORRECTION_INVALID: "The correction cannot be made of this object; the message says why.",
        COVARIANCE_NOT_SYMMETRIC: "A covariance is not symmetric; send both halves alike.",
        DESCRIPTORS_DIFFER: "Features of two methods cannot be compared; extract both with one.",
        DISPLAY_NAME_INVALID: "A display name is too long, or cannot be shown.",
        ENUM_UNKNOWN: "An enum's value is unspecified or unknown to this server; choose one of the contract's.",
        EVALUATION_INVALID: "What is to be compared does not fit together; the message says what.",
        FIELD_IMMUTABLE: "The field is fixed once it is set; the message says what to do instead.",
        FIELD_MISSING: "A field that is needed is not set.",
        FIELD_READ_ONLY: "The field is told by the server and set by nobody; leave it out of the mask.",
        FILE_INVALID: "A file or encoded image is damaged, or not of the format that was said.",
        FILTERS_INVALID: "Filters do not fit together; the message says which.",
        FORMAT_MISMATCH: "The file is of another format than was said.",
        FORMAT_UNKNOWN: "The file's format is not one that is read or written.",
        HEADER_INVALID: "A header of the request cannot be read.",
        HOST_UNKNOWN: "The request's Host is no name of this server; call it by its address, or add the name to listen.allowed_hosts.",
        ID_INVALID: "An id has other characters than a-z A-Z 0-9 _ -, or not 1 to 64 of them.",
        IMAGE_EMPTY: "An image has no pixels.",
        IMAGE_SIZE_MISMATCH: "Two images that belong together have different sizes.",
        INDEX_OUT_OF_RANGE: "An index points beyond the list that it belongs to.",
        INTRINSICS_MISMATCH: "The image's size is not that of the declared intrinsics; declare those of this resolution.",
        MAP_UNUSABLE: "The map that was given shows no place from which it could be looked at: nothing is free, or no ground has room above.",
        JSON_INVALID: "The body is not as JSON, or not as the message has it; the field says where.",
        KEY_MISMATCH: "The zenoh key and the message name different sessions or sensors; make them the same.",
        LABEL_SELECTOR_INVALID: "A label selector is not of the form key=value,key.",
        LABELS_INVALID: "A label's key or value has characters that it must not have, or too many.",
        LEVELS_TOO_MANY: "More levels of resolution than are allowed; ask for fewer.",
        MASK_PATH_UNKNOWN: "The mask names a field that does not exist, or that no mask can name.",
        MEDIA_TYPE_UNSUPPORTED: "The body's media type is not read; send application/json or application/x-protobuf.",
        MESSAGE_EXPANDS: "The message has so many small elements that it would take far more memory than it has bytes; send fewer at a time.",
        MESSAGE_INVALID: "The payload is no message of the contract.",
        METHOD_NOT_ALLOWED: "The path does not serve this HTTP method; Allow lists those that it does.",
        MODEL_INVALID: "The model is no whole ONNX file, uses what is not supported, or has other inputs or outputs than its spec says; the message says what.",
        NODE_ID_INVALID: "A node of the scene graph is robot, object/NUMBER or room/NUMBER.",
        NO_MODEL: "No model explains enough of the pairs; send better ones, or allow for more error.",
        NOT_FINITE: "A number is not finite.",
        ORDER_INVALID: "A list's order is not one that there is.",
        ORIGIN_UNSUPPORTED: "The file's format cannot keep that origin; write it as another, or without.",
        OUT_OF_RANGE: "A number lies outside of its bounds; the message says them.",
        PAGE_TOKEN_INVALID: "The page token is not of this list; start without it.",
        PARAMETER_OUT_OF_RANGE: "A parameter lies outside of its bounds, or is of the wrong kind; the message says them.",
        PATH_INVALID: "The path holds a word that is not what it must be.",
        PATH_MISMATCH: "The path and the body name different things; leave it out of the body.",
        PATTERN_INVALID: "A pattern of session ids has characters that no id has; only * stands for others.",
        PROTOBUF_INVALID: "The body is no encoded message of the rpc.",
        QUATERNION_NOT_UNIT: "A quaternion's norm is not 1; normalise it, in the order x, y, z, w.",
        QUERY_INVALID: "The query has a name that is unknown, given twice, or a value of another kind.",
        RANGE_NOT_SATISFIABLE: "The range lies outside of the file; Content-Range says its size.",
        REGION_EMPTY: "A region's smallest corner is not below its largest.",
        REGION_TOO_FAR: "The region lies farther away than cells can be numbered.",
        REGISTRATION_INVALID: "The clouds, or the settings, do not do for registration; the message says why.",
        RESOLUTION_NOT_A_MULTIPLE: "The resolution is no multiple of the map's own.",
        ROOM_NAME_AMBIGUOUS: "Several rooms have this name; give the room's number.",
        SCAN_EMPTY: "The scan has no beam.",
        SENSOR_DECLARED_TWICE: "Two sensors have one name; names are unique in a session.",
        SENSOR_KIND_MISMATCH: "The frame is not of the kind that the sensor was declared with.",
        SIZE_MISMATCH: "An array is not as long as its declared shape.",
        STAMP_BEFORE_TRAJECTORY: "The time lies before the first frame; the message says the range.",
        STAMP_IMPLAUSIBLE: "The stamp lies hours in the future, or leaps there; set the clocks, and send nanoseconds since 1970.",
        STAMP_NEGATIVE: "The stamp is negative; send nanoseconds since 1970.",
        STAMP_NOT_INCREASING: "The stamp is not after the sensor's last; send frames in order, each once.",
        STAMP_REPEATED: "Another frame of the sensor had this stamp; each has its own, in nanoseconds.",
        STAMP_ZERO: "The stamp is 0; stamp each message with the robot's clock.",
        STEP_HAS_CLOUD: "A step of a toolbox pipeline names a cloud; only the first input does.",
        STEPS_INVALID: "The steps of a toolbox pipeline do not fit together.",
        STRIDE_TOO_SMALL: "A row stride is shorter than a row.",
        TIME_OFFSET_TOO_LARGE: "A point's time lies farther from the stamp than any sweep takes; send seconds.",
        TOO_MANY_LABELS: "A session has at most 32 labels.",
        TRAJECTORY_RANGE_INVALID: "The part of the trajectory that is asked for cannot be: ends exchanged, or ways of thinning mixed.",
        UPLOAD_MIXED: "The parts of an upload are of different kinds; send one kind.",
        VIEWS_INVALID: "Views do not fit the pixels, or each other.",
        VOXEL_TOO_SMALL: "The voxels are too small for the cloud's extent; make them larger.",
        WEBSOCKET_REQUIRED: "The address speaks Foxglove's WebSocket protocol, and the request is no handshake of it; open it in Foxglove.",
    }
    NotFound {
        CLASS_NOT_FOUND: "No examples of this class were given in the session; list its classes.",
        CLOUD_NOT_FOUND: "No cloud is kept under this handle; it was dropped or forgotten: upload it again.",
        DETECTOR_NOT_FOUND: "There is no learned detector of this name, or not for this caller; the message lists them.",
        FILE_NOT_FOUND: "A map has no file of this name; the message lists them.",
        FRAME_NOT_FOUND: "The session has no frame of this name; the message lists them.",
        KEY_UNKNOWN: "There is no such zenoh key; the message lists them.",
        LOOP_NOT_FOUND: "The session has no loop of this number.",
        OBJECT_NOT_FOUND: "The session has no object of this number.",
        OPERATION_NOT_FOUND: "There is no such operation, or not for this caller: it was deleted, its time is over, or its server was stopped; start it again.",
        RECORDING_NOT_FOUND: "The session has no recording of this id at this server; list those that it has.",
        ROOM_NOT_FOUND: "The session's map has no room of this number, or of this name.",
        ROUTE_NOT_FOUND: "There is nothing at this path; /openapi.json lists what there is.",
        SENSOR_NOT_FOUND: "The session has no sensor of this name; declare it first.",
        SESSION_NOT_FOUND: "There is no such session, or not for this caller.",
    }
    AlreadyExists {
        DETECTOR_EXISTS: "A learned detector of this name is there already; choose another name, or delete that one.",
        SESSION_EXISTS: "A session of this id exists already; choose another id, or use it.",
    }
    FailedPrecondition {
        DATA_DAMAGED: "Stored data of the session are damaged; what is whole can be read. Restore it from a backup.",
        DETECTOR_IN_USE: "A session names the detector in params.detection.learned; change that first.",
        DETECTOR_OF_SERVER: "The detector is of the server's folder; who runs the server can take it away.",
        LAYER_OFF: "The session does not keep this layer of the map; create one whose parameters enable it.",
        MAP_EMPTY: "Nothing was mapped yet; send frames first.",
        MAP_NOT_EMPTY: "The session has a map already; import into a new session, before frames come.",
        NO_POSE_YET: "No frame was registered yet; send frames first.",
        NOT_RECORDED: "The session is not recorded, and was not since the server began; start a recording first.",
        NOT_RESTORABLE: "The session's map cannot be built from what is stored; the server's log has the cause.",
        ODOM_NOT_KNOWN: "The pose in odom was not kept for that time: lengths were in a unit of their own.",
        OBJECT_NOT_IN_MAP: "The object is not found in the map as it is now, so that nothing can be learned from it; label it alone, or look at it again.",
        OPERATION_CANCELLED: "The operation was cancelled before it was done; start it again.",
        OPERATION_NOT_DONE: "The operation has no result yet; wait for its end.",
        OPERATION_UNDER_WAY: "The operation has not ended; cancel it, or wait for its end.",
        POSE_NOT_COMPARABLE: "A camera alone cannot be compared with the map where somebody says that it is; the session has to find it.",
        POSE_REFUTED: "What the robot sees does not fit the map where it is said to be, within a metre and half a radian; nothing was changed. Point it out more precisely, or let it be looked for.",
        RECORDING_OFF: "The server has no folder for recordings; who runs it can start it with --record FOLDER, or set recording.dir.",
        RECORDING_UNDER_WAY: "The recording has not ended; stop it first.",
        RECORD_TOO_LARGE: "Something of the session is larger than the storage takes; the server's log says what.",
        ROBOT_SILENT: "No frame of the sensor that moves the pose came within five seconds; nothing was changed. Send frames, and say it again.",
        SCALE_CHANGES: "The time lies between frames whose lengths are in different units.",
        SENSOR_IN_USE: "The sensor has sent frames, which are in the map as it was declared; declare the changed one under another name.",
        SESSION_FAULTED: "The session is set apart after damage or repeated failure; what is whole can be read.",
        SESSION_NOT_MAPPING: "The session is of mode INGEST_ONLY, in which frames are counted and not kept; use one of mode MAPPING.",
        STAMP_AFTER_TRAJECTORY: "The time lies after the newest frame; ask again when frames of that time were sent.",
        STORE_REFUSED: "The storage refuses the session's data for good; the server's log has the cause.",
        TRAJECTORY_EMPTY: "No frame was registered yet; send frames first.",
    }
    Aborted {
        ETAG_MISMATCH: "It was changed since it was read; read it again, and change what is there now.",
    }
    ResourceExhausted {
        CLOUD_TOO_LARGE: "The cloud has more points than limits.max_cloud_points; thin it.",
        DESCRIPTORS_TOO_MANY: "More features than can be compared at a time; send fewer.",
        GRID_TOO_LARGE: "The grid has more cells than are answered, or searched, at a time; ask for a region, or coarser.",
        IMAGE_TOO_LARGE: "The image has more pixels than limits.max_image_pixels; shrink it.",
        KEPT_CLOUDS_FULL: "No room for more kept clouds; drop some, or wait until they are forgotten.",
        MEMORY_EXHAUSTED: "Messages under way have taken all memory that they may; try again.",
        MESH_TOO_LARGE: "The surface has more triangles than are answered at a time; ask for a region.",
        MESSAGE_TOO_LARGE: "The message is larger than limits.max_message_bytes; send less at a time.",
        MODEL_TOO_LARGE: "The model is larger than limits.max_detector_bytes, or a run of it takes more than is allowed; choose a smaller one.",
        NEIGHBOURS_TOO_MANY: "The answer would hold too many neighbours; ask for fewer points, or a smaller radius.",
        OPERATIONS_FULL: "No room for the operation's request or result; delete operations that have ended, or wait until they are forgotten.",
        PICTURE_TOO_LARGE: "The picture would have too many pixels; ask for a smaller one.",
        RATE_LIMITED: "The tenant's quota of requests, frames, bytes or computing time is used up for the moment; try again after the time that is told.",
        SAMPLE_TOO_LARGE: "More points are to be sampled than the method can; ask for fewer.",
        SCAN_TOO_LARGE: "The scan has more beams than limits.max_cloud_points.",
        SERVER_BUSY: "As many requests wait to be computed as may; try again.",
        TOO_MANY_ANSWERS: "More sessions fit the wildcard of a zenoh key than are answered for; name fewer.",
        TOO_MANY_DETECTORS: "The server, or the tenant, keeps as many uploaded detectors as it may; delete some.",
        TOO_MANY_EXAMPLES: "The session keeps as many examples of classes as it may; forget a class.",
        TOO_MANY_OPERATIONS: "As many operations are kept as may; delete some that have ended, or wait.",
        TOO_MANY_QUERIES: "More points, rays or boxes than are answered at a time; ask in several.",
        TOO_MANY_ROOM_NAMES: "As many rooms have names as may; take some away.",
        TOO_MANY_SENSORS: "The session has as many sensors as it may.",
        TOO_MANY_SESSIONS: "The server, or the tenant, holds as many sessions as it may; delete some.",
        TOO_MANY_STREAMS: "As many ingest streams are open as may; close some, or try again.",
        TOO_MANY_WATCHERS: "As many watchers are there as may; close some, or try again.",
        UPLOAD_TOO_LARGE: "The upload is larger than limits.max_upload_bytes; thin it.",
    }
    Unauthenticated {
        CREDENTIALS_EXPIRED: "The key or token has expired, or was revoked during the call; renew it.",
        CREDENTIALS_INVALID: "The key, token or certificate is not one of this server's.",
        CREDENTIALS_MISSING: "The request says nobody's name; send a key or token, or a certificate.",
        CREDENTIALS_NOT_YET_VALID: "The token holds only from a later time on; check the clocks.",
        CREDENTIALS_REVOKED: "The key, or the rule for the certificate, was revoked; ask for another one.",
        CREDENTIALS_WITHOUT_GRANT: "The credentials are good, and grant nothing here; ask for access.",
    }
    PermissionDenied {
        ORIGIN_FORBIDDEN: "A page of another origin asks for what only this server's own pages may.",
        PERMISSION_DENIED: "The credentials do not allow this; the message says what is needed.",
    }
    Unavailable {
        IDENTITY_PROVIDER_UNAVAILABLE: "The identity provider's keys cannot be had at the moment; try again.",
        NODE_SILENT: "The server has lost touch with the storage that it shares with others; try again.",
        NOT_YET_DURABLE: "It was taken in, and is not durable yet; it will be. Send it again to learn when.",
        SESSION_ELSEWHERE: "Another server has the session; ask that one.",
        SESSION_STOPPED: "The session has just been put to sleep; try again, which wakes it.",
        STARTING: "The server is starting; try again.",
        STOPPING: "The server is stopping; try again, or another one.",
        STORAGE_FAULT: "The storage fails at the moment; queries go on, frames are refused until it is well.",
        STORAGE_FENCED: "Another server has taken over the data; talk to that one.",
        STORAGE_FULL: "The storage is full; make room. Queries go on, frames are refused until there is some.",
        STORAGE_SLOW: "The storage did not take the last frames in time.",
        STREAM_IDLE: "The stream was closed because nothing came for limits.stream_idle_timeout_s; open it again.",
        TOO_MANY_CONNECTIONS: "As many connections are open as may; close some, or try again.",
    }
    DeadlineExceeded {
        BODY_TOO_SLOW: "The body did not come within limits.body_timeout_s; send it faster, or less.",
        COMPUTATION_TOO_LONG: "The computation took longer than limits.max_computation_ms, or an operation than limits.max_operation_s; ask for less.",
        CANCELLED: "The caller has gone, or its deadline has passed; nothing was answered.",
        DEADLINE_EXCEEDED: "The deadline that the caller gave has passed.",
    }
    Internal {
        INTERNAL: "A fault of the server's; its log has the cause, under the trace of the request.",
        PIPELINE_FAILED: "The frame made the session fail; it goes on from what is stored, without this frame.",
    }
}

/// The entry of a reason.
pub fn entry(name: &str) -> Option<&'static Entry> {
    CATALOGUE.iter().find(|entry| entry.name == name)
}

/// The catalogue as a page.
pub fn markdown() -> String {
    let mut page = "# Reasons\n\n\
        Every error says why by a stable, upper-case reason: in gRPC's `google.rpc.ErrorInfo`, in REST's\n\
        `application/problem+json`, in acknowledgements, and in what is told of faults and readiness. The words beside it may\n\
        change with any version. Written by `docs/refresh-reasons` from `server/service/src/reason.rs`.\n"
        .to_owned();
    let mut code = None;
    for entry in CATALOGUE {
        if code != Some(entry.code) {
            page.push_str(&format!("\n## {}\n\n| reason | what it means |\n| --- | --- |\n", entry.code.name()));
            code = Some(entry.code);
        }
        page.push_str(&format!("| `{}` | {} |\n", entry.name, entry.about));
    }
    page
}

#[cfg(test)]
mod tests;
