/** Layers that a session keeps if it was asked to: surface, voxels, heights of the ground. Read when they are switched on. */
import {
  BoxGeometry, BufferAttribute, BufferGeometry, Color, DoubleSide, Group, InstancedMesh, Matrix4, Mesh, MeshLambertMaterial, type Material,
} from 'three';
import * as answers from '../answers';
import { connection, of, query, readBytes, wordsOf } from '../api';
import { ramp } from '../colours';
import type { Stage } from '../stage';

export type Volume = 'surface' | 'voxels' | 'heights';
const PERIOD_MS = 4000;
/** More would not be drawn in time; the largest of what is asked for. */
const MAX_VOXELS = 400_000;

export class VolumeLayer {
  readonly group = new Group();
  private stale = true;
  private busy = false;
  private at = 0;

  constructor(private id: string, readonly kind: Volume, private stage: Stage, private signal: AbortSignal, private problem: (text: string) => void) {
    this.group.visible = false;
    const timer = setInterval(() => void this.tick(), 300);
    signal.addEventListener('abort', () => { clearInterval(timer); this.clear(); });
  }

  touch(): void { this.stale = true; }

  private async tick(): Promise<void> {
    if (!this.stale || this.busy || !this.group.visible || connection.link !== 'up' || document.hidden) return;
    if (this.at && performance.now() - this.at < PERIOD_MS) return;
    this.busy = true;
    this.stale = false;
    try {
      const object = await this.load();
      if (!this.signal.aborted) {
        this.clear();
        if (object) this.group.add(object);
        this.stage.draw();
      }
    } catch (e) { if (!this.signal.aborted) this.problem(wordsOf(e)); }
    this.at = performance.now();
    this.busy = false;
  }

  private async load(): Promise<Mesh | null> {
    const read = (path: string): Promise<Uint8Array> => readBytes(of(this.id, path), this.signal);
    if (this.kind === 'surface') return surfaceMesh(answers.surface(await read('/map/mesh')));
    if (this.kind === 'voxels') return voxelMesh(answers.voxels(await read('/map/voxels' + query({ occupied_only: true }))));
    return heightMesh(answers.heights(await read('/map/heights')));
  }

  private clear(): void {
    for (const child of this.group.children) {
      const mesh = child as Mesh<BufferGeometry, Material>;
      mesh.geometry.dispose();
      mesh.material.dispose();
    }
    this.group.clear();
  }
}

function surfaceMesh(found: answers.Surface): Mesh | null {
  if (!found.triangles.length) return null;
  const geometry = new BufferGeometry();
  geometry.setAttribute('position', new BufferAttribute(found.positions, 3));
  geometry.setAttribute('normal', new BufferAttribute(found.normals, 3));
  const colours = new Uint8Array(found.colours.length);
  // Vertex colours are taken for linear ones.
  found.colours.forEach((value, i) => { colours[i] = Math.round(255 * (value / 255) ** 2.2); });
  geometry.setAttribute('color', new BufferAttribute(colours, 3, true));
  geometry.setIndex(new BufferAttribute(found.triangles, 1));
  return new Mesh(geometry, new MeshLambertMaterial({ vertexColors: true, side: DoubleSide }));
}

function voxelMesh({ size, blocks }: answers.Voxels): Mesh | null {
  const places: number[] = [];
  for (const block of blocks) block.cells.forEach((cell, i) => {
    if (cell < 50) return;
    places.push((block.x * 8 + (i & 7) + 0.5) * size, (block.y * 8 + (i >> 3 & 7) + 0.5) * size, (block.z * 8 + (i >> 6) + 0.5) * size);
  });
  const n = Math.min(MAX_VOXELS, places.length / 3);
  if (!n) return null;
  const mesh = new InstancedMesh(new BoxGeometry(size * 0.94, size * 0.94, size * 0.94), new MeshLambertMaterial(), n);
  const matrix = new Matrix4(), colour = new Color();
  let low = Infinity, high = -Infinity;
  for (let i = 2; i < places.length; i += 3) { low = Math.min(low, places[i]!); high = Math.max(high, places[i]!); }
  for (let i = 0; i < n; i++) {
    mesh.setMatrixAt(i, matrix.makeTranslation(places[3 * i]!, places[3 * i + 1]!, places[3 * i + 2]!));
    const [r, g, b] = ramp((places[3 * i + 2]! - low) / Math.max(0.1, high - low));
    mesh.setColorAt(i, colour.setRGB(r / 255, g / 255, b / 255, 'srgb'));
  }
  mesh.computeBoundingSphere();
  return mesh;
}

/** The ground, green where a robot can drive, red where it cannot. */
function heightMesh(found: answers.Heights | null): Mesh | null {
  if (!found) return null;
  const { width, height, resolution_m, origin } = found.geometry;
  const positions = new Float32Array(width * height * 3), colours = new Uint8Array(width * height * 3), triangles: number[] = [];
  for (let y = 0; y < height; y++) for (let x = 0; x < width; x++) {
    const i = y * width + x, z = found.ground[i]!, passable = found.traversability[i]!;
    positions.set([(origin?.x ?? 0) + (x + 0.5) * resolution_m, (origin?.y ?? 0) + (y + 0.5) * resolution_m, Number.isFinite(z) ? z : 0], 3 * i);
    const known = Number.isFinite(passable);
    colours.set(known ? [Math.round(160 * (1 - passable)), Math.round(20 + 90 * passable), 30] : [70, 76, 84], 3 * i);
    const corners = [i, i + 1, i + width, i + width + 1];
    if (x + 1 < width && y + 1 < height && corners.every(c => Number.isFinite(found.ground[c]!))) {
      triangles.push(corners[0]!, corners[1]!, corners[3]!, corners[0]!, corners[3]!, corners[2]!);
    }
  }
  if (!triangles.length) return null;
  const geometry = new BufferGeometry();
  geometry.setAttribute('position', new BufferAttribute(positions, 3));
  geometry.setAttribute('color', new BufferAttribute(colours, 3, true));
  geometry.setIndex(triangles);
  geometry.computeVertexNormals();
  return new Mesh(geometry, new MeshLambertMaterial({ vertexColors: true, side: DoubleSide }));
}
