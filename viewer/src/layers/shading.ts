/** Colours of points by what they are coloured by. */
import { ramp, rgb, type Rgb } from '../colours';
import type { PointPart } from './points';
import type { Thing, TrajectoryPose } from '../types';
import { boxMatrix } from '../geometry';
import { classColour } from '../colours';
import { Matrix4, Vector3 } from 'three';
import { seconds } from '../words';

export type ColourBy = 'own' | 'height' | 'class' | 'time' | 'reflectance' | 'robot';

export interface Range { min: number; max: number }

/** What colours are made of, of one session. */
export interface Shades {
  by: ColourBy;
  height: Range;
  brightness: Range;
  robot: Rgb;
  dark: boolean;
  things: Thing[];
  times: PassTimes | null;
}

const TABLE: Rgb[] = Array.from({ length: 256 }, (_, i) => ramp(i / 255));

/** Writes the colour of every point of a part. */
export function shade(part: PointPart, s: Shades): void {
  const out = part.shades.array as Uint8Array, { positions, own, bright } = part;
  const put = (i: number, c: Rgb): void => { out[4 * i] = c[0]; out[4 * i + 1] = c[1]; out[4 * i + 2] = c[2]; out[4 * i + 3] = 255; };
  const scaled = (value: number, range: Range): Rgb =>
    TABLE[Math.max(0, Math.min(255, Math.round(255 * (value - range.min) / Math.max(1e-6, range.max - range.min))))]!;
  const plain: Rgb = s.dark ? [120, 130, 142] : [150, 158, 168];
  const boxes = s.by === 'class' ? s.things.map(thing => ({ inside: tester(thing), colour: rgb(classColour(thing.label)) })) : [];
  for (let i = 0, n = part.count; i < n; i++) {
    const x = positions[3 * i]!, y = positions[3 * i + 1]!, z = positions[3 * i + 2]!;
    if (s.by === 'own' && own) put(i, [own[3 * i]!, own[3 * i + 1]!, own[3 * i + 2]!]);
    else if (s.by === 'reflectance' && bright) put(i, scaled(bright[i]!, s.brightness));
    else if (s.by === 'time' && s.times) put(i, TABLE[s.times.at(x, y)]!);
    else if (s.by === 'class') put(i, boxes.find(b => b.inside(x, y, z))?.colour ?? plain);
    else if (s.by === 'robot') put(i, s.robot);
    else put(i, scaled(z, s.height));
  }
  part.shades.needsUpdate = true;
}

function tester(thing: Thing): (x: number, y: number, z: number) => boolean {
  const inverse: Matrix4 = boxMatrix(thing.box).invert();
  const centre = new Vector3().setFromMatrixPosition(boxMatrix(thing.box));
  const size = thing.box?.size_m;
  const reach = size ? Math.hypot(size.x, size.y, size.z) / 2 + 0.05 : 0;
  const at = new Vector3();
  return (x, y, z) => {
    if (Math.abs(x - centre.x) > reach || Math.abs(y - centre.y) > reach) return false;
    at.set(x, y, z).applyMatrix4(inverse);
    return Math.abs(at.x) <= 0.53 && Math.abs(at.y) <= 0.53 && Math.abs(at.z) <= 0.53;
  };
}

/** When the robot was nearest to a place: each cell takes the time of the nearest pose, which grows from cell to cell. */
export class PassTimes {
  private cells: Uint8Array;
  private x0: number;
  private y0: number;
  private width: number;
  private height: number;
  private cell: number;

  constructor(poses: TrajectoryPose[], bounds: { min: { x: number; y: number }; max: { x: number; y: number } }) {
    const span = Math.max(bounds.max.x - bounds.min.x, bounds.max.y - bounds.min.y, 1);
    this.cell = Math.max(0.25, span / 400);
    this.x0 = bounds.min.x;
    this.y0 = bounds.min.y;
    this.width = Math.ceil((bounds.max.x - bounds.min.x) / this.cell) + 1;
    this.height = Math.ceil((bounds.max.y - bounds.min.y) / this.cell) + 1;
    const known = new Uint8Array(this.width * this.height);
    this.cells = new Uint8Array(this.width * this.height);
    const first = seconds(poses[0]?.stamp_ns), last = Math.max(first + 1e-3, seconds(poses.at(-1)?.stamp_ns));
    let front: number[] = [];
    for (const pose of poses) {
      const at = this.index(pose.t_map_base?.translation?.x ?? 0, pose.t_map_base?.translation?.y ?? 0);
      if (!known[at]) front.push(at);
      known[at] = 1;
      this.cells[at] = Math.round(255 * (seconds(pose.stamp_ns) - first) / (last - first));
    }
    while (front.length) {
      const next: number[] = [];
      for (const at of front) {
        const x = at % this.width;
        for (const to of [x > 0 ? at - 1 : -1, x < this.width - 1 ? at + 1 : -1, at - this.width, at + this.width]) {
          if (to < 0 || to >= known.length || known[to]) continue;
          known[to] = 1;
          this.cells[to] = this.cells[at]!;
          next.push(to);
        }
      }
      front = next;
    }
  }

  private index(x: number, y: number): number {
    const column = Math.max(0, Math.min(this.width - 1, Math.floor((x - this.x0) / this.cell)));
    const row = Math.max(0, Math.min(this.height - 1, Math.floor((y - this.y0) / this.cell)));
    return row * this.width + column;
  }

  /** 0 to 255 of the drive. */
  at(x: number, y: number): number { return this.cells[this.index(x, y)]!; }
}
