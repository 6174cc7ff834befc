/** Which parts of a session's cloud are asked for, when, and how fine. */
import * as answers from '../answers';
import { connection, of, query, read, readBytes } from '../api';
import type { Changes, MapSummary } from '../types';
import { cut, edgeFor, keyOf, levels, squareOf, voxelAt, type Square } from './blocks';
import type { CloudLayer } from './cloud';

/** The first picture of a large map: the whole of it by few points. */
const FIRST_POINTS = 40_000;
/** A map with no more points than this comes at once. */
const WHOLE_POINTS = 400_000;
/** What is asked for at one time: a browser has six connections, and others want some. */
const AT_ONCE = 2;
const CHANGES_MS = 1000;

export class CloudLoader {
  private edge = 0;
  private voxel = 0.05;
  private version = '0';
  private height: { min: number; max: number } = { min: 0, max: 3 };
  /** Points that each square has at level 0, about. */
  private full = new Map<string, number>();
  private held = new Map<string, number>();
  private queue = new Set<string>();
  private running = 0;
  private stale = false;
  private busy = false;
  private lastAt = 0;
  private total = 0;
  /** By how much a level has fewer points than the one below it. */
  private ratio = 4;

  constructor(
    private id: string, private layer: CloudLayer, private signal: AbortSignal,
    private budget: () => number, private eye: () => { x: number; y: number; z: number }, private first: () => void,
  ) {
    const timer = setInterval(() => void this.tick(), 250);
    signal.addEventListener('abort', () => clearInterval(timer));
    void this.begin();
  }

  /** The map has changed. */
  touch(): void { this.stale = true; }

  get isWhole(): boolean { return !this.queue.size && !this.running; }

  private path = (values: Record<string, string | number | undefined>): string => of(this.id, '/map/cloud' + query(values));

  private async begin(): Promise<void> {
    this.busy = true;
    try {
      // Asked before the points: what changes while they come is told by the next question.
      const [changes, summary] = await Promise.all([this.changes('0'), read<MapSummary>(of(this.id, '/map'), this.signal)]);
      this.total = Number(summary.num_points);
      this.voxel = summary.voxel_size_m;
      const isSmall = this.total <= WHOLE_POINTS;
      const far = answers.cloud(await readBytes(this.path({ max_points: isSmall ? undefined : FIRST_POINTS }), this.signal));
      this.layer.clear();
      this.held.clear();
      this.full.clear();
      this.queue.clear();
      if (!far.positions.length) { this.edge = 0; return; }
      this.version = changes.version;
      this.edge = edgeOf(changes.squares);
      this.measure(far.positions);
      const share = isSmall ? 1 : this.total / Math.max(1, far.positions.length / 3);
      const level = isSmall ? 0 : Math.max(1, Math.round(Math.log2(Math.max(1, far.voxel / this.voxel))));
      if (level) this.ratio = Math.min(4, Math.max(1.2, share ** (1 / level)));
      for (const piece of cut(far, this.edge)) {
        this.layer.put(piece, isSmall ? this.voxel : far.voxel || this.voxel);
        this.full.set(piece.key, piece.positions.length / 3 * share);
        this.held.set(piece.key, level);
        if (level) this.queue.add(piece.key);
      }
      this.first();
    } catch { /* Told where it is asked; begun again when the server answers. */ this.stale = true; } finally { this.busy = false; this.lastAt = performance.now(); }
  }

  private measure(positions: Float32Array): void {
    this.height = { min: Infinity, max: -Infinity };
    for (let i = 2; i < positions.length; i += 3) {
      this.height.min = Math.min(this.height.min, positions[i]!);
      this.height.max = Math.max(this.height.max, positions[i]!);
    }
  }

  /** All of a small map in one answer. */
  private async whole(): Promise<void> {
    const cloud = answers.cloud(await readBytes(this.path({}), this.signal));
    const pieces = cut(cloud, this.edge);
    this.measure(cloud.positions);
    const there = new Set(pieces.map(piece => piece.key));
    for (const key of [...this.layer.parts.keys()]) if (!there.has(key)) { this.layer.drop(key); this.held.delete(key); this.full.delete(key); }
    for (const piece of pieces) {
      this.layer.put(piece, this.voxel);
      this.full.set(piece.key, piece.positions.length / 3);
      this.held.set(piece.key, 0);
    }
    this.total = cloud.positions.length / 3;
    this.queue.clear();
  }

  private async changes(since: string): Promise<{ version: string; squares: Tile[] }> {
    const answer = await read<Changes>(of(this.id, '/map/changes' + query({ layer: 'MAP_LAYER_CLOUD', since_version: since })), this.signal);
    return {
      version: answer.stamp?.map_version ?? since,
      squares: (answer.regions ?? []).map(r => ({ x: r.min?.x ?? 0, y: r.min?.y ?? 0, edge: (r.max?.x ?? 0) - (r.min?.x ?? 0) })),
    };
  }

  private async tick(): Promise<void> {
    if (this.signal.aborted || connection.link !== 'up' || document.hidden) return;
    if (this.stale && !this.busy && performance.now() - this.lastAt > CHANGES_MS) {
      this.stale = false;
      if (!this.edge) { await this.begin(); return; }
      await this.update();
    }
    this.choose();
    this.pump();
  }

  private async update(): Promise<void> {
    this.busy = true;
    try {
      const { version, squares } = await this.changes(this.version);
      if (!squares.length) { this.version = version; return; }
      const touched = new Set(squares.map(r => keyOf({ x: Math.floor((r.x + r.edge / 2) / this.edge), y: Math.floor((r.y + r.edge / 2) / this.edge) })));
      if (touched.size > 4 && touched.size > this.full.size / 3 && this.total <= WHOLE_POINTS) await this.whole();
      else for (const key of touched) {
        if (!this.full.has(key)) { this.full.set(key, 5000); this.held.set(key, 0); }
        this.queue.add(key);
      }
      this.version = version;
      // A map that has grown is cut into larger squares.
      if (this.full.size > 400) { this.edge = 0; this.stale = true; }
    } catch { this.stale = true; } finally { this.busy = false; this.lastAt = performance.now(); }
  }

  /** Squares that should be finer than they are held, now that the view is another. */
  private choose(): void {
    if (this.total <= this.budget() || !this.full.size) return;
    const keys = [...this.full.keys()], wanted = this.levels(keys);
    keys.forEach((key, i) => {
      const held = this.held.get(key) ?? 9, coarser = wanted[i]! - held;
      if (coarser < 0) this.queue.add(key);
      // What was near and is far now is thinned, or a walk through a large map would gather all of it.
      if (coarser >= 2) {
        this.layer.thin(key, this.ratio ** -coarser, voxelAt(this.voxel, wanted[i]!));
        this.held.set(key, wanted[i]!);
      }
    });
  }

  private levels(keys: string[]): number[] {
    return levels(keys.map(key => ({ full: this.full.get(key) ?? 0, distance: this.distance(key) })), this.budget() * 1.25, this.ratio);
  }

  private distance(key: string): number {
    const square = squareOf(key), eye = this.eye();
    return Math.hypot((square.x + 0.5) * this.edge - eye.x, (square.y + 0.5) * this.edge - eye.y, eye.z - this.height.min);
  }

  private pump(): void {
    while (this.running < AT_ONCE && this.queue.size) {
      const key = [...this.queue].reduce((a, b) => this.distance(a) <= this.distance(b) ? a : b);
      this.queue.delete(key);
      this.running++;
      void this.load(key).finally(() => { this.running--; if (!this.signal.aborted) this.pump(); });
    }
  }

  /** One square: the ball that holds it, and of that what lies in it. */
  private async load(key: string): Promise<void> {
    const square = squareOf(key), edge = this.edge;
    const level = this.total <= this.budget() ? 0 : this.levels([...this.full.keys()])[[...this.full.keys()].indexOf(key)] ?? 0;
    const margin = 1.5, height = this.height.max - this.height.min + 2 * margin;
    const voxel = voxelAt(this.voxel, level);
    try {
      const cloud = answers.cloud(await readBytes(this.path({
        'centre.x': (square.x + 0.5) * edge, 'centre.y': (square.y + 0.5) * edge, 'centre.z': (this.height.min + this.height.max) / 2,
        radius_m: Math.hypot(edge * Math.SQRT1_2, height / 2), voxel_size_m: level ? voxel : undefined,
      }), this.signal));
      if (edge !== this.edge) return;
      const piece = cut(cloud, edge, key)[0];
      if (piece) this.layer.put(piece, voxel); else this.layer.drop(key);
      const points = (piece?.positions.length ?? 0) / 3, full = this.full.get(key) ?? 0;
      if (!level) this.full.set(key, points);
      else if (points > 100 && full > points) this.ratio = Math.min(4, Math.max(1.2, 0.9 * this.ratio + 0.1 * (full / points) ** (1 / level)));
      this.held.set(key, level);
      this.total = [...this.full.values()].reduce((sum, n) => sum + n, 0);
    } catch { if (!this.signal.aborted) { this.queue.add(key); await new Promise(done => setTimeout(done, 1000)); } }
  }
}

interface Tile extends Square { edge: number }

function edgeOf(tiles: Tile[]): number {
  const tile = tiles[0]?.edge ?? 3.2;
  const span = (axis: 'x' | 'y'): number => Math.max(...tiles.map(t => t[axis] + t.edge)) - Math.min(...tiles.map(t => t[axis]));
  return tiles.length ? edgeFor(span('x'), span('y'), tile) : tile;
}
