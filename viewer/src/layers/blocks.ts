/** A cloud cut into squares of the map, so that a change is loaded alone and what is far is drawn thinly. */
import type { Cloud } from '../answers';
import { shuffled } from './points';

export interface Square { x: number; y: number }
export interface Piece { key: string; positions: Float32Array; own: Uint8Array | null; bright: Float32Array | null }

export const keyOf = (square: Square): string => `${square.x},${square.y}`;

export function squareOf(key: string): Square {
  const [x, y] = key.split(',').map(Number);
  return { x: x!, y: y! };
}

const WIDE = 2 ** 24;
/** A square as one number, which is found faster than text. */
const number = (square: Square): number => (square.x + WIDE / 2) * WIDE + square.y + WIDE / 2;

/** The points of a cloud by square, each piece in random order; `only` keeps one square. */
export function cut(cloud: Cloud, edge: number, only?: string): Piece[] {
  const { positions, colours, intensities } = cloud;
  const members = new Map<number, number[]>();
  const single = only === undefined ? null : number(squareOf(only));
  for (let i = 0; i < positions.length; i += 3) {
    const key = number({ x: Math.floor(positions[i]! / edge), y: Math.floor(positions[i + 1]! / edge) });
    if (single !== null && key !== single) continue;
    const list = members.get(key);
    if (list) list.push(i / 3); else members.set(key, [i / 3]);
  }
  return [...members].map(([square, list]) => {
    const y = square % WIDE - WIDE / 2, key = keyOf({ x: Math.floor(square / WIDE) - WIDE / 2, y });
    const order = shuffled(Uint32Array.from(list)), n = order.length;
    const piece: Piece = {
      key, positions: new Float32Array(n * 3), own: colours && new Uint8Array(n * 3), bright: intensities && new Float32Array(n),
    };
    for (let i = 0; i < n; i++) {
      const from = order[i]!;
      for (let k = 0; k < 3; k++) {
        piece.positions[3 * i + k] = positions[3 * from + k]!;
        if (piece.own) piece.own[3 * i + k] = colours![3 * from + k]!;
      }
      if (piece.bright) piece.bright[i] = intensities![from]!;
    }
    return piece;
  });
}

/** The edge of squares for a map: few enough to draw, and whole numbers of the server's. */
export function edgeFor(width_m: number, height_m: number, tile_m: number, most = 160): number {
  let edge = tile_m;
  while (Math.ceil(width_m / edge) * Math.ceil(height_m / edge) > most) edge *= 2;
  return edge;
}

/** How far points are apart at a level: each one's voxels are twice as large. */
export const voxelAt = (voxel: number, level: number): number => voxel * 2 ** level;

/**
 * Levels for squares by distance, such that about `limit` points are held. `full` is what each square has at level 0, and each level
 * has `ratio` times fewer: 4 on dense surfaces, less where points lie apart.
 */
export function levels(squares: { full: number; distance: number }[], limit: number, ratio: number): number[] {
  const at = (near: number): number[] =>
    squares.map(s => Math.max(0, Math.min(6, Math.floor(Math.log2(Math.max(1e-9, s.distance / near))) + 1)));
  const held = (all: number[]): number => all.reduce((sum, level, i) => sum + squares[i]!.full / ratio ** level, 0);
  for (let near = 4096; near > 1; near /= 1.5) {
    const all = at(near);
    if (held(all) <= limit) return all;
  }
  return at(1);
}
