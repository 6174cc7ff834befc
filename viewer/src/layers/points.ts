/** How points are drawn: squares as large as what they stand for, never smaller than can be seen. */
import { BufferAttribute, BufferGeometry, Points, ShaderMaterial, Sphere, Vector3, type IUniform } from 'three';

const VERTEX = `
uniform float scale, spacing, top;
attribute vec4 shade;
varying vec3 ink;
void main() {
  ink = shade.rgb;
  vec4 seen = modelViewMatrix * vec4(position, 1.0);
  gl_Position = projectionMatrix * seen;
  gl_PointSize = clamp(scale * spacing / -seen.z, 1.6, 10.0);
  // What is above the cut is put where nothing is drawn.
  if (position.z > top) gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
}`;
const FRAGMENT = `
varying vec3 ink;
void main() { gl_FragColor = vec4(ink, 1.0); }`;

/** What all parts of a cloud share. */
export class PointStyle {
  /** Pixels of a metre at a distance of one. */
  readonly scale: IUniform<number> = { value: 500 };
  /** Points above this height are left out, metres, map frame. */
  readonly top: IUniform<number> = { value: 1e9 };

  material(spacing: IUniform<number>): ShaderMaterial {
    return new ShaderMaterial({ vertexShader: VERTEX, fragmentShader: FRAGMENT, uniforms: { scale: this.scale, top: this.top, spacing } });
  }
}

/** A part of a cloud in random order, so that its first points are a thinner cloud of the same. */
export class PointPart {
  readonly object: Points<BufferGeometry, ShaderMaterial>;
  private spacing: IUniform<number> = { value: 0.05 };
  /** Edge of the voxels that its points are means of, metres. */
  voxel = 0.05;
  /** It has colour of its own, and not only greys. */
  isColourful = false;
  readonly sphere = new Sphere();

  constructor(style: PointStyle, public positions: Float32Array, public own: Uint8Array | null, public bright: Float32Array | null) {
    this.object = new Points(new BufferGeometry(), style.material(this.spacing));
    this.set(positions, own, bright);
  }

  get count(): number { return this.positions.length / 3; }

  set(positions: Float32Array, own: Uint8Array | null, bright: Float32Array | null): void {
    Object.assign(this, { positions, own, bright });
    this.object.geometry.dispose();
    const geometry = new BufferGeometry();
    geometry.setAttribute('position', new BufferAttribute(positions, 3));
    geometry.setAttribute('shade', new BufferAttribute(new Uint8Array(positions.length / 3 * 4), 4, true));
    geometry.computeBoundingSphere();
    this.sphere.copy(geometry.boundingSphere ?? new Sphere(new Vector3(), 0));
    this.object.geometry = geometry;
  }

  get shades(): BufferAttribute { return this.object.geometry.getAttribute('shade') as BufferAttribute; }

  /** Draws so many of its points, each as large as its share of the surface. */
  show(points: number): void {
    const shown = Math.min(this.count, Math.max(0, Math.round(points)));
    this.object.visible = shown > 0;
    this.object.geometry.setDrawRange(0, shown);
    this.spacing.value = this.voxel * Math.sqrt(this.count / Math.max(1, shown));
  }

  dispose(): void {
    this.object.removeFromParent();
    this.object.geometry.dispose();
    this.object.material.dispose();
  }
}

/** Points in random order, the same each time: x y z, and what belongs to them. */
export function shuffled(order: Uint32Array): Uint32Array {
  let seed = 12345;
  for (let i = order.length - 1; i > 0; i--) {
    seed = (Math.imul(seed, 1664525) + 1013904223) >>> 0;
    const j = Math.floor(seed / 4294967296 * (i + 1));
    const kept = order[i]!;
    order[i] = order[j]!;
    order[j] = kept;
  }
  return order;
}
