/** The large answers: cloud, grid, voxels, surface, heights. Field numbers are those of the protos. */
import { floats, integers, joined, signed, walk } from './protobuf';
import type { GridGeometry } from './types';

export interface Cloud {
  version: string;
  total: number;
  voxel: number;
  /** x y z of each point, metres, map frame. */
  positions: Float32Array;
  /** RGB of each point, if there is colour. */
  colours: Uint8Array | null;
  /** One a point, if the map keeps them. */
  intensities: Float32Array | null;
}

function version(stamp: Uint8Array): string {
  let found = '0';
  walk(stamp, (field, value) => { if (field === 1) found = String(value); });
  return found;
}

function geometry(bytes: Uint8Array): GridGeometry {
  const grid: GridGeometry = { resolution_m: 1, origin: { x: 0, y: 0 }, width: 0, height: 0 };
  walk(bytes, (field, value, inner) => {
    if (field === 1) grid.resolution_m = value;
    if (field === 2) walk(inner, (axis, metres) => { grid.origin![axis === 1 ? 'x' : 'y'] = metres; });
    if (field === 3) grid.width = value;
    if (field === 4) grid.height = value;
  });
  return grid;
}

/** GetCloudResponse. */
export function cloud(answer: Uint8Array): Cloud {
  const positions: Uint8Array[] = [], colours: Uint8Array[] = [], intensities: Uint8Array[] = [];
  const found = { version: '0', total: 0, voxel: 0 };
  walk(answer, (field, _, chunk) => {
    if (field !== 1) return;
    walk(chunk, (inner, value, bytes) => {
      if (inner === 1) found.version = version(bytes);
      if (inner === 2) found.total = value;
      if (inner === 4) found.voxel = value;
      if (inner !== 3) return;
      walk(bytes, (channel, __, content) => {
        if (channel === 2) positions.push(content);
        if (channel === 3) colours.push(content);
        if (channel === 4) intensities.push(content);
      });
    });
  });
  const all = floats(joined(positions.length ? positions : [new Uint8Array()]));
  const coloured = joined(colours.length ? colours : [new Uint8Array()]);
  const bright = floats(joined(intensities.length ? intensities : [new Uint8Array()]));
  return {
    ...found, positions: all,
    colours: coloured.length && coloured.length === all.length ? coloured : null,
    intensities: bright.length && bright.length * 3 === all.length ? bright : null,
  };
}

export interface Grid { version: string; geometry: GridGeometry; cells: Int8Array }

/** GetOccupancyGridResponse; nothing while nothing was mapped. */
export function grid(answer: Uint8Array): Grid | null {
  let shape: GridGeometry | null = null, of = '0';
  const cells: Uint8Array[] = [];
  walk(answer, (field, _, chunk) => {
    if (field !== 1) return;
    walk(chunk, (inner, __, bytes) => {
      if (inner === 1) of = version(bytes);
      if (inner === 2) shape = geometry(bytes);
      if (inner === 4) cells.push(bytes);
    });
  });
  if (!shape || !cells.length) return null;
  return { version: of, geometry: shape, cells: new Int8Array(joined(cells).slice().buffer) };
}

export interface Voxels { version: string; size: number; blocks: { x: number; y: number; z: number; cells: Int8Array }[] }

/** GetVoxelsResponse. */
export function voxels(answer: Uint8Array): Voxels {
  const found: Voxels = { version: '0', size: 0.1, blocks: [] };
  walk(answer, (field, value, bytes) => {
    if (field === 1) found.version = version(bytes);
    if (field === 2) found.size = value;
    if (field !== 3) return;
    const block = { x: 0, y: 0, z: 0, cells: new Int8Array() };
    walk(bytes, (inner, number, content) => {
      if (inner === 1) block.x = signed(number);
      if (inner === 2) block.y = signed(number);
      if (inner === 3) block.z = signed(number);
      if (inner === 4) block.cells = new Int8Array(content.slice().buffer);
    });
    found.blocks.push(block);
  });
  return found;
}

export interface Surface {
  version: string; positions: Float32Array; normals: Float32Array; colours: Uint8Array; triangles: Uint32Array;
}

/** GetMeshResponse. */
export function surface(answer: Uint8Array): Surface {
  const parts: Uint8Array[][] = [[], [], [], [], []];
  let of = '0';
  walk(answer, (field, _, bytes) => {
    if (field === 1) of = version(bytes);
    else if (field <= 5) parts[field - 1]!.push(bytes);
  });
  const part = (field: number): Uint8Array => joined(parts[field - 1]!.length ? parts[field - 1]! : [new Uint8Array()]);
  return {
    version: of, positions: floats(part(2)), normals: floats(part(3)), colours: part(4).slice(), triangles: integers(part(5)),
  };
}

export interface Heights { version: string; geometry: GridGeometry; ground: Float32Array; traversability: Float32Array }

/** GetHeightsResponse; nothing while nothing was mapped. */
export function heights(answer: Uint8Array): Heights | null {
  let of = '0', shape: GridGeometry | null = null;
  const ground: Uint8Array[] = [], passable: Uint8Array[] = [];
  walk(answer, (field, _, bytes) => {
    if (field === 1) of = version(bytes);
    if (field === 2) shape = geometry(bytes);
    if (field === 3) ground.push(bytes);
    if (field === 9) passable.push(bytes);
  });
  if (!shape || !ground.length) return null;
  return { version: of, geometry: shape, ground: floats(joined(ground)), traversability: floats(joined(passable)) };
}
