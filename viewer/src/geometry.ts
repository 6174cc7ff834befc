/** Poses, boxes and polygons. */
import { Matrix4, Quaternion, Vector3 } from 'three';
import type { OrientedBox, Pose, TrajectoryPose, Vector2 } from './types';
import { seconds } from './words';

export const translation = (pose: Pose | undefined): Vector3 =>
  new Vector3(pose?.translation?.x ?? 0, pose?.translation?.y ?? 0, pose?.translation?.z ?? 0);

export function rotation(pose: Pose | undefined): Quaternion {
  const q = pose?.rotation;
  return q ? new Quaternion(q.x, q.y, q.z, q.w) : new Quaternion();
}

export const matrix = (pose: Pose | undefined): Matrix4 =>
  new Matrix4().compose(translation(pose), rotation(pose), new Vector3(1, 1, 1));

/** Heading about z, radians. */
export function yaw(pose: Pose | undefined): number {
  const q = rotation(pose);
  return Math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z));
}

export const size = (box: OrientedBox | undefined): Vector3 =>
  new Vector3(box?.size_m?.x ?? 0, box?.size_m?.y ?? 0, box?.size_m?.z ?? 0);

/** The unit cube about the origin to the box. */
export const boxMatrix = (box: OrientedBox | undefined): Matrix4 =>
  new Matrix4().compose(translation(box?.t_frame_box), rotation(box?.t_frame_box), size(box));

/** A robot at a time. */
export interface Placed { position: Vector3; rotation: Quaternion; lost: boolean }

/** The index of the last pose at or before a time; -1 if there is none. */
export function before(poses: TrajectoryPose[], time_s: number): number {
  let low = 0, high = poses.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (seconds(poses[middle]!.stamp_ns) <= time_s) low = middle + 1; else high = middle;
  }
  return low - 1;
}

/** Where a robot was at a time, between the two poses around it. */
export function poseAt(poses: TrajectoryPose[], time_s: number): Placed | null {
  const at = Math.max(0, before(poses, time_s));
  const a = poses[at], b = poses[at + 1] ?? a;
  if (!a || !b) return null;
  const from = seconds(a.stamp_ns), span = seconds(b.stamp_ns) - from;
  const share = span > 0 ? Math.min(1, Math.max(0, (time_s - from) / span)) : 0;
  return {
    position: translation(a.t_map_base).lerp(translation(b.t_map_base), share),
    rotation: rotation(a.t_map_base).slerp(rotation(b.t_map_base), share),
    lost: a.state === 'TRACKING_STATE_LOST' || b.state === 'TRACKING_STATE_LOST',
  };
}

export function contains(polygon: Vector2[], x: number, y: number): boolean {
  let inside = false;
  polygon.forEach((a, i) => {
    const b = polygon[(i + 1) % polygon.length]!;
    if (a.y > y !== b.y > y && x < a.x + (b.x - a.x) * (y - a.y) / (b.y - a.y)) inside = !inside;
  });
  return inside;
}

export const middle = (polygon: Vector2[]): Vector2 => ({
  x: polygon.reduce((sum, p) => sum + p.x, 0) / Math.max(1, polygon.length),
  y: polygon.reduce((sum, p) => sum + p.y, 0) / Math.max(1, polygon.length),
});
