/** Where the robot was: its trajectory, its keyframes, and the loops between them. */
import { BufferAttribute, BufferGeometry, Group, Points, Vector3 } from 'three';
import { LOOP_COLOURS, rgb, type Rgb } from '../colours';
import { before, translation } from '../geometry';
import type { Stage } from '../stage';
import type { Keyframe, Loop, TrajectoryPose } from '../types';
import { seconds } from '../words';
import { Lines } from './lines';
import { PointStyle } from './points';

const LOST: Rgb = [216, 67, 59];

export class TrajectoryLayer {
  private lines = new Lines({ width: 3 });
  readonly group = this.lines.group;
  constructor(private stage: Stage, private colour: Rgb) {}

  /** All of it, or what was driven until a time. */
  set(poses: TrajectoryPose[], until_s: number | null): void {
    const end = until_s === null ? poses.length : before(poses, until_s) + 1;
    const points: Vector3[] = [], colours: Rgb[] = [];
    for (let i = 1; i < end; i++) {
      const a = poses[i - 1]!, b = poses[i]!;
      if (a.scale !== b.scale) continue;
      points.push(translation(a.t_map_base), translation(b.t_map_base));
      colours.push(b.state === 'TRACKING_STATE_LOST' ? LOST : this.colour);
    }
    for (const point of points) point.z += 0.03;
    this.lines.set(points, colours);
    this.stage.draw();
  }
  dispose(): void { this.lines.dispose(); }
}

export class KeyframeLayer {
  readonly group = new Group();
  private style = new PointStyle();
  private points: Points<BufferGeometry> | null = null;
  shown: Keyframe[] = [];
  constructor(private stage: Stage, private colour: Rgb) {}

  set(keyframes: Iterable<Keyframe>, until_s: number | null): void {
    this.shown = [...keyframes].filter(k => until_s === null || seconds(k.stamp_ns) <= until_s);
    this.points?.geometry.dispose();
    this.points?.removeFromParent();
    const n = this.shown.length;
    const positions = new Float32Array(3 * n), shades = new Uint8Array(4 * n);
    this.shown.forEach((keyframe, i) => {
      translation(keyframe.t_map_base).add(new Vector3(0, 0, 0.04)).toArray(positions, 3 * i);
      shades.set([...this.colour.map(c => Math.round(c * 0.72)), 255], 4 * i);
    });
    const geometry = new BufferGeometry();
    geometry.setAttribute('position', new BufferAttribute(positions, 3));
    geometry.setAttribute('shade', new BufferAttribute(shades, 4, true));
    this.points ??= new Points(geometry, this.style.material({ value: 1 }));
    this.points.geometry = geometry;
    // Six pixels whatever the distance: the smallest and the largest size of the style meet there.
    this.points.material = this.style.material({ value: 0.09 });
    this.group.add(this.points);
    this.stage.draw();
  }

  resize(): void {
    this.style.scale.value = this.stage.renderer.domElement.height / 2 / Math.tan(this.stage.camera.fov * Math.PI / 360);
  }
}

/** A loop as it is drawn. */
export interface Arc { loop: Loop; points: Vector3[] }

export class LoopLayer {
  private lines = new Lines({ width: 2.5 });
  readonly group = this.lines.group;
  arcs: Arc[] = [];
  constructor(private stage: Stage) {}

  /** Bows over the floor: keyframes that saw the same place stand side by side. */
  set(loops: Iterable<Loop>, keyframes: Map<string, Keyframe>, until_s: number | null): void {
    this.arcs = [];
    const points: Vector3[] = [], colours: Rgb[] = [];
    for (const loop of loops) {
      const from = keyframes.get(loop.from_keyframe_id), to = keyframes.get(loop.to_keyframe_id);
      if (!from || !to || (until_s !== null && seconds(to.stamp_ns) > until_s)) continue;
      const a = translation(from.t_map_base), b = translation(to.t_map_base);
      const rise = 0.25 + 0.15 * a.distanceTo(b), steps = 12;
      const arc = Array.from({ length: steps + 1 }, (_, i) => {
        const part = i / steps;
        return a.clone().lerp(b, part).add(new Vector3(0, 0, 0.05 + 4 * rise * part * (1 - part)));
      });
      this.arcs.push({ loop, points: arc });
      const colour = rgb(LOOP_COLOURS[loop.state] ?? '#8a94a3');
      for (let i = 1; i < arc.length; i++) { points.push(arc[i - 1]!, arc[i]!); colours.push(colour); }
    }
    // Hundreds would cover what they lie over.
    this.lines.style(this.arcs.length > 60 ? { width: 1.5, opacity: 0.35 } : { width: 2.5 });
    this.lines.set(points, colours);
    this.stage.draw();
  }
  dispose(): void { this.lines.dispose(); }
}
