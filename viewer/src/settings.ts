/** What the viewer shows and how; chosen by the person at it. */
import { Emitter } from './emitter';
import type { ColourBy } from './layers/shading';

export type LayerName =
  'points' | 'grid' | 'robot' | 'trajectory' | 'keyframes' | 'loops' | 'things' | 'rooms' | 'zones' | 'labels' | 'surface' | 'voxels' | 'heights';
export type Mode = 'look' | 'plan' | 'zone';

export class Settings extends Emitter<{ changed: void; mode: Mode; time: void }> {
  layers: Record<LayerName, boolean> = {
    points: true, grid: true, robot: true, trajectory: true, keyframes: true, loops: true, things: true, rooms: true, zones: true, labels: true,
    surface: false, voxels: false, heights: false,
  };
  /** Nothing: the first that there is. */
  colourBy: ColourBy | null = null;
  /** Points that are drawn at most, of all sessions. */
  budget = 2_000_000;
  /** Height above the floor at which points are cut away, metres; nothing: as the session is. */
  cut_m: number | null = null;
  /** Sessions side by side, or each with its origin in the same place. */
  apart = true;
  follow = false;
  mode: Mode = 'look';
  /** Time of the slider, seconds; nothing: live. */
  time_s: number | null = null;

  set(change: Partial<Pick<Settings, 'colourBy' | 'budget' | 'cut_m' | 'apart' | 'follow'>>): void {
    Object.assign(this, change);
    this.tell('changed', undefined);
  }

  toggle(name: LayerName): void {
    this.layers[name] = !this.layers[name];
    this.tell('changed', undefined);
  }

  setMode(mode: Mode): void {
    this.mode = mode;
    this.tell('mode', mode);
  }

  setTime(time_s: number | null): void {
    this.time_s = time_s;
    this.tell('time', undefined);
  }
}
