/** Messages of percept.v1 as the viewer reads them, in protobuf's JSON: 64-bit integers are text. */

export interface Vector2 { x: number; y: number }
export interface Vector3 { x: number; y: number; z: number }
export interface Quaternion { x: number; y: number; z: number; w: number }
export interface Pose { translation?: Vector3; rotation?: Quaternion }

export interface PoseEstimate {
  stamp_ns: string;
  state: string;
  t_map_base?: Pose;
  inlier_ratio: number;
  rmse_m: number;
  map_version: string;
  scale: string;
  relocalised: boolean;
  tentative: boolean;
  lost_message: string;
  scale_message: string;
  waiting_message: string;
  led_by: string;
}

export interface CameraIntrinsics {
  width_px: number; height_px: number; fx_px: number; fy_px: number; cx_px: number; cy_px: number;
}
export interface SensorSpec { sensor_id: string; kind: string; t_base_sensor?: Pose; intrinsics?: CameraIntrinsics }
/** The newest 50 frames of a stream; absent is not known. */
export interface StreamFigures {
  arrival_rate_hz?: number; jitter_s?: number; longest_interval_s?: number; delay_s?: number; quiet_s?: number; frame_bytes?: number;
  latency_p50_s?: number; latency_p95_s?: number; measured_ratio?: number; median_range_m?: number;
}
export interface StreamTrouble { kind: string; message: string }
export interface StreamNote { stream: string; message: string }
export interface SensorStatus {
  spec: SensorSpec;
  accepted: string; rejected: string; dropped: string; gaps: string;
  rate_hz?: number;
  last_stamp_ns?: string;
  verdict: string;
  verdict_message: string;
  figures?: StreamFigures;
  troubles: StreamTrouble[];
}

export interface Zone { polygon: Vector2[]; keep_out?: boolean; speed_share?: number; name: string }
export interface ZoneMask { name: string; keep_out?: boolean; geometry?: GridGeometry }
export interface GridGeometry { resolution_m: number; origin?: Vector2; width: number; height: number }

interface Enabled { enabled: boolean }
export interface Session {
  session_id: string;
  display_name: string;
  mode: string;
  state: string;
  params?: { preset?: string; map?: { voxels?: Enabled; height?: Enabled; surface?: Enabled } };
  sensors: SensorStatus[];
  stream_notes: StreamNote[];
  pose?: PoseEstimate;
  num_keyframes: string;
  num_objects: string;
  map_version: string;
  queue_length: number;
  last_used_ns: string;
  fault?: { reason: string; message: string };
  etag: string;
  zones: Zone[];
  zone_masks: ZoneMask[];
}

export interface TrajectoryPose { stamp_ns: string; t_map_base?: Pose; state: string; keyframe_id?: string; scale: string }
export interface Keyframe { keyframe_id: string; stamp_ns: string; sensor_id: string; t_map_base?: Pose; num_points: number }
export interface Loop {
  loop_id: string; from_keyframe_id: string; to_keyframe_id: string; inlier_ratio: number; state: string;
}

export interface OrientedBox { t_frame_box?: Pose; size_m?: Vector3 }
export interface PastState { stamp_ns: string; label: string; state: string; box?: OrientedBox }
export interface Thing {
  object_id: string;
  label: string;
  confidence: number;
  box?: OrientedBox;
  state: string;
  velocity_mps?: Vector3;
  first_seen_ns: string;
  last_seen_ns: string;
  num_observations: string;
  class_probabilities: { label: string; probability: number }[];
  history: PastState[];
}
export interface ObjectChange { object_id: string; kind: string; object?: Thing; merged_into?: string }

export interface Room {
  room_id: string; kind: string; name: string; likely_use: string; was_entered: boolean;
  center?: Vector2; area_m2: number; outline: Vector2[]; object_ids: string[];
}
export interface Door { room_id_1: string; room_id_2: string; center?: Vector2; width_m: number; angle_rad: number }
export interface Rooms { rooms: Room[]; doors: Door[]; map_version: string }

export interface SceneNode { node_id: string; kind: string; label: string; t_map_node?: Pose }
export interface Relation {
  subject_id: string; kind: string; object_id: string; strength: number; frame: string; distance_m: number;
}
export interface SceneGraph { map_version: string; nodes: SceneNode[]; relations: Relation[] }

export interface Waypoint { x_m: number; y_m: number; yaw_rad: number; clearance_m?: number; time_s: number }
export interface Path { waypoints: Waypoint[]; length_m: number; duration_s: number; min_clearance_m?: number }
export interface Blocking { position?: Vector2; obstacle?: Vector2; state: string; object_id?: string }
export interface NoPath { reason: string; detail: string; blocking?: Blocking }
export interface PlanAnswer { path?: Path; no_path?: NoPath; stamp?: { map_version: string } }

export interface MapSummary { num_points: string; voxel_size_m: number; occupancy?: GridGeometry; num_keyframes: string }
export interface Region2 { min?: Vector2; max?: Vector2 }
export interface Changes { stamp?: { map_version: string }; regions: Region2[] }

/** An event of one session in the stream of all. */
export interface FleetEvent {
  token: string;
  session_id: string;
  stamp_ns: string;
  pose?: PoseEstimate;
  keyframe_added?: Keyframe;
  object_changed?: ObjectChange;
  loop_changed?: Loop;
  map_version?: string;
  life?: { step: string; state: string };
  new_etag?: string;
  resync?: Record<string, never>;
}
