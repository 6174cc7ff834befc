/** The point cloud: its parts, how many of their points are drawn, and their colours. */
import { Box3, Frustum, Group, Matrix4, Vector3 } from 'three';
import type { Stage } from '../stage';
import type { Piece } from './blocks';
import { PointPart, PointStyle } from './points';
import { shade, type Range, type Shades } from './shading';

/** Points that a square pixel of a part is worth. */
const POINTS_PER_PIXEL = 1.2;
/** Colours are made anew for so long in one frame, milliseconds. */
const COLOURING_MS = 8;

export class CloudLayer {
  readonly group = new Group();
  readonly style = new PointStyle();
  readonly parts = new Map<string, PointPart>();
  private uncoloured = new Set<PointPart>();
  private known: { top: number; body: Box3 } | null = null;

  constructor(private stage: Stage, private shades: () => Shades) {}

  get count(): number { return [...this.parts.values()].reduce((sum, part) => sum + part.count, 0); }
  get hasOwn(): boolean { return [...this.parts.values()].some(part => part.isColourful); }
  get hasBrightness(): boolean { return [...this.parts.values()].some(part => part.bright); }

  /** Puts a part in, or in the place of the one that was there. */
  put(piece: Piece, voxel: number): void {
    let part = this.parts.get(piece.key);
    if (part) part.set(piece.positions, piece.own, piece.bright);
    else {
      part = new PointPart(this.style, piece.positions, piece.own, piece.bright);
      this.parts.set(piece.key, part);
      this.group.add(part.object);
    }
    part.voxel = voxel;
    part.isColourful = !!piece.own && isColourful(piece.own);
    this.known = null;
    shade(part, this.shades());
    this.stage.draw();
  }

  /** Keeps a share of a part's points. */
  thin(key: string, share: number, voxel: number): void {
    const part = this.parts.get(key);
    if (!part) return;
    const n = Math.ceil(part.count * share);
    this.put({ key, positions: part.positions.slice(0, 3 * n), own: part.own?.slice(0, 3 * n) ?? null, bright: part.bright?.slice(0, n) ?? null }, voxel);
  }

  drop(key: string): void {
    this.parts.get(key)?.dispose();
    this.parts.delete(key);
    this.known = null;
    this.stage.draw();
  }

  clear(): void { for (const key of [...this.parts.keys()]) this.drop(key); }

  /** Colours all points anew, a few in each frame. */
  recolour(): void {
    this.uncoloured = new Set(this.parts.values());
    this.stage.draw();
  }

  private colourSome(): void {
    const until = performance.now() + COLOURING_MS;
    for (const part of this.uncoloured) {
      if (performance.now() > until) { this.stage.draw(); return; }
      this.uncoloured.delete(part);
      shade(part, this.shades());
    }
  }

  /** Points that each part in view is worth, by the area that it takes; what is out of view is left out. */
  private wants(): Map<PointPart, number> {
    const { camera, host } = this.stage;
    const frustum = new Frustum().setFromProjectionMatrix(new Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse));
    const focal = host.clientHeight / 2 / Math.tan(camera.fov * Math.PI / 360);
    const wants = new Map<PointPart, number>();
    for (const part of this.parts.values()) {
      const sphere = part.sphere.clone().applyMatrix4(this.group.matrixWorld);
      if (!frustum.intersectsSphere(sphere)) { part.show(0); continue; }
      const distance = Math.max(camera.near, camera.position.distanceTo(sphere.center) - sphere.radius);
      const radius = sphere.radius * focal / distance;
      const area = Math.min(Math.PI * radius * radius, host.clientWidth * host.clientHeight * 2);
      wants.set(part, Math.min(part.count, area * POINTS_PER_PIXEL));
    }
    return wants;
  }

  /** Shares a budget of points out; returns how many were wanted. */
  prepare(): { wanted: number; apply: (share: number) => void } {
    this.colourSome();
    this.style.scale.value = this.stage.renderer.domElement.height / 2 / Math.tan(this.stage.camera.fov * Math.PI / 360);
    const wants = this.wants();
    const wanted = [...wants.values()].reduce((sum, n) => sum + n, 0);
    return { wanted, apply: share => { for (const [part, n] of wants) part.show(n * share); } };
  }

  /** A box of most points: the few that lie far out would make the rest small. */
  body(): Box3 {
    const top = this.style.top.value;
    if (this.known?.top !== top) this.known = { top, body: this.measure() };
    return this.known.body.clone();
  }

  private measure(): Box3 {
    const samples: Vector3[] = [];
    for (const part of this.parts.values()) {
      const step = Math.max(1, Math.floor(this.count / 20_000)) * 3;
      for (let i = 0; i < part.positions.length; i += step) {
        const z = part.positions[i + 2]!;
        if (z <= this.style.top.value) samples.push(new Vector3(part.positions[i], part.positions[i + 1], z));
      }
    }
    const range = (axis: 'x' | 'y' | 'z', share: number): Range => {
      const sorted = samples.map(s => s[axis]).sort((a, b) => a - b);
      return { min: sorted[Math.floor(share * (sorted.length - 1))]!, max: sorted[Math.ceil((1 - share) * (sorted.length - 1))]! };
    };
    if (!samples.length) return new Box3();
    const [x, y, z] = [range('x', 0.01), range('y', 0.01), range('z', 0.01)];
    return new Box3(new Vector3(x.min, y.min, z.min), new Vector3(x.max, y.max, z.max));
  }

  dispose(): void { this.clear(); this.group.removeFromParent(); }
}

/** A cloud without colour is grey all over. */
function isColourful(own: Uint8Array): boolean {
  for (let i = 0; i < own.length; i += 3 * 37) {
    const r = own[i]!, g = own[i + 1]!, b = own[i + 2]!;
    if (Math.max(r, g, b) - Math.min(r, g, b) > 24) return true;
  }
  return false;
}
