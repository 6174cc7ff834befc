/** The occupancy grid as a picture on the floor. */
import { DataTexture, Group, Mesh, MeshBasicMaterial, NearestFilter, PlaneGeometry, RGBAFormat, SRGBColorSpace } from 'three';
import { grid, type Grid } from '../answers';
import { connection, of, query, read, readBytes } from '../api';
import type { Stage } from '../stage';
import type { Changes, GridGeometry, MapSummary } from '../types';

const PERIOD_MS = 1500;
/** A larger grid than this is changed in parts, and made coarser for the picture, cells. */
const WHOLE_CELLS = 400_000;
const MAX_EDGE = 4096;

export class GridLayer {
  readonly group = new Group();
  private mesh: Mesh<PlaneGeometry, MeshBasicMaterial> | null = null;
  private held: Grid | null = null;
  private stale = true;
  private busy = false;
  private at = 0;

  constructor(private id: string, private stage: Stage, private signal: AbortSignal, private changed: () => void) {
    const timer = setInterval(() => void this.tick(), 250);
    signal.addEventListener('abort', () => clearInterval(timer));
  }

  get geometry(): GridGeometry | null { return this.held?.geometry ?? null; }
  touch(): void { this.stale = true; }

  private async tick(): Promise<void> {
    if (!this.stale || this.busy || !this.group.visible || connection.link !== 'up' || document.hidden) return;
    if (performance.now() - this.at < PERIOD_MS) return;
    this.busy = true;
    this.stale = false;
    try { await this.refresh(); } catch { if (!this.signal.aborted) this.stale = true; }
    this.at = performance.now();
    this.busy = false;
  }

  private async refresh(): Promise<void> {
    const { occupancy } = await read<MapSummary>(of(this.id, '/map'), this.signal);
    if (!occupancy?.width) { this.clear(); return; }
    const times = Math.ceil(Math.max(occupancy.width, occupancy.height) / MAX_EDGE);
    const held = this.held;
    const alike = held && times === 1 && JSON.stringify(held.geometry) === JSON.stringify(occupancy);
    if (alike && occupancy.width * occupancy.height > WHOLE_CELLS) { await this.patch(held); return; }
    const resolution = times > 1 ? occupancy.resolution_m * times : undefined;
    const whole = grid(await readBytes(of(this.id, '/map/occupancy' + query({ resolution_m: resolution })), this.signal));
    if (!whole) { this.clear(); return; }
    this.held = whole;
    this.paint();
  }

  /** Asks for the rectangle that holds what has changed. */
  private async patch(held: Grid): Promise<void> {
    const changes = await read<Changes>(
      of(this.id, '/map/changes' + query({ layer: 'MAP_LAYER_OCCUPANCY', since_version: held.version })), this.signal);
    if (changes.regions?.length) {
      const pick = (which: 'min' | 'max', axis: 'x' | 'y'): number[] => changes.regions.map(r => r[which]?.[axis] ?? 0);
      const part = grid(await readBytes(of(this.id, '/map/occupancy' + query({
        'region.min.x': Math.min(...pick('min', 'x')), 'region.min.y': Math.min(...pick('min', 'y')),
        'region.max.x': Math.max(...pick('max', 'x')), 'region.max.y': Math.max(...pick('max', 'y')),
      })), this.signal));
      if (part) this.lay(held, part);
    }
    held.version = changes.stamp?.map_version ?? held.version;
    this.paint();
  }

  private lay(held: Grid, part: Grid): void {
    const { resolution_m, origin, width, height } = held.geometry, from = part.geometry;
    const x0 = Math.round(((from.origin?.x ?? 0) - (origin?.x ?? 0)) / resolution_m);
    const y0 = Math.round(((from.origin?.y ?? 0) - (origin?.y ?? 0)) / resolution_m);
    for (let y = 0; y < from.height; y++) for (let x = 0; x < from.width; x++) {
      if (x0 + x >= 0 && x0 + x < width && y0 + y >= 0 && y0 + y < height) held.cells[(y0 + y) * width + x0 + x] = part.cells[y * from.width + x]!;
    }
  }

  /** The ground takes another colour by day and by night. */
  paint(): void {
    const held = this.held;
    if (!held) return;
    const dark = matchMedia('(prefers-color-scheme: dark)').matches;
    const free = dark ? 38 : 255, full = dark ? 200 : 60;
    const { width, height, resolution_m, origin } = held.geometry;
    const pixels = new Uint8Array(width * height * 4);
    held.cells.forEach((cell, i) => {
      if (cell < 0) return;
      const grey = free + (full - free) * cell / 100;
      pixels.set([grey, grey, grey + (dark ? 8 : 0), 255], 4 * i);
    });
    const texture = new DataTexture(pixels, width, height, RGBAFormat);
    Object.assign(texture, { magFilter: NearestFilter, minFilter: NearestFilter, colorSpace: SRGBColorSpace, needsUpdate: true });
    this.clearMesh();
    const material = new MeshBasicMaterial({ map: texture, transparent: true, alphaTest: 0.5, polygonOffset: true, polygonOffsetFactor: 2, polygonOffsetUnits: 8 });
    this.mesh = new Mesh(new PlaneGeometry(width * resolution_m, height * resolution_m), material);
    this.mesh.position.set((origin?.x ?? 0) + width * resolution_m / 2, (origin?.y ?? 0) + height * resolution_m / 2, 0);
    this.group.add(this.mesh);
    this.stage.draw();
    this.changed();
  }

  private clearMesh(): void {
    this.mesh?.material.map?.dispose();
    this.mesh?.material.dispose();
    this.mesh?.geometry.dispose();
    this.mesh?.removeFromParent();
    this.mesh = null;
  }

  clear(): void { this.clearMesh(); this.held = null; this.stage.draw(); }
}
