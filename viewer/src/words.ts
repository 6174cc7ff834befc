/** Values as people read them. */

const PREFIX = /^(OBJECT_STATE|OBJECT_CHANGE_KIND|TRACKING_STATE|SESSION_STATE|SESSION_MODE|SENSOR_KIND|LOOP_STATE|STREAM_VERDICT|STREAM_TROUBLE_KIND|RELATION_KIND|NO_PATH_REASON|BLOCKING_STATE|ROOM_KIND|LIFE_STEP|SCALE|SCENE_NODE_KIND)_/;

/** An enum's name: `LOOP_STATE_ACTIVE` is "active". */
export const word = (name: string): string => name.replace(PREFIX, '').toLowerCase().replaceAll('_', ' ');

export const metres = (value: number | undefined, digits = 2): string => `${(value ?? 0).toFixed(digits)} m`;

export const percent = (share: number): string => `${(100 * share).toFixed(0)} %`;

export const degrees = (radians: number): string => `${(radians * 180 / Math.PI).toFixed(1)}°`;

/** 4 s, 1 min 5 s, 2 h 3 min. */
export function duration(seconds: number): string {
  const s = Math.max(0, seconds);
  if (s < 60) return `${s.toFixed(1)} s`;
  if (s < 3600) return `${Math.floor(s / 60)} min ${Math.floor(s % 60)} s`;
  return `${Math.floor(s / 3600)} h ${Math.floor((s % 3600) / 60)} min`;
}

/** 950, 12.3 k, 1.95 M. */
export function count(value: number): string {
  if (value < 10_000) return String(Math.round(value));
  return value < 1e6 ? `${(value / 1e3).toFixed(value < 1e5 ? 1 : 0)} k` : `${(value / 1e6).toFixed(2)} M`;
}

export const seconds = (ns: string | number | undefined): number => Number(ns ?? 0) / 1e9;
