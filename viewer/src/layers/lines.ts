/** Lines as wide as they are asked to be, in pixels. */
import { Group, type Vector3 } from 'three';
import { LineMaterial } from 'three/examples/jsm/lines/LineMaterial.js';
import { LineSegments2 } from 'three/examples/jsm/lines/LineSegments2.js';
import { LineSegmentsGeometry } from 'three/examples/jsm/lines/LineSegmentsGeometry.js';
import type { Rgb } from '../colours';

export interface LineStyle { width?: number; opacity?: number; onTop?: boolean }

/** Segments, each with a colour. */
export class Lines {
  readonly group = new Group();
  private material: LineMaterial;
  private lines: LineSegments2 | null = null;

  constructor({ width = 2, opacity = 1, onTop = false }: LineStyle = {}) {
    this.material = new LineMaterial({ linewidth: width, vertexColors: true, transparent: opacity < 1, opacity, depthTest: !onTop });
    this.group.renderOrder = onTop ? 5 : 0;
  }

  /** From, to, from, to, …; one colour a segment, or one for all. */
  set(points: Vector3[], colours: Rgb[] | Rgb): void {
    this.lines?.geometry.dispose();
    this.lines?.removeFromParent();
    this.lines = null;
    const segments = points.length >> 1;
    if (!segments) return;
    const positions = new Float32Array(segments * 6), shades = new Float32Array(segments * 6);
    for (let i = 0; i < segments * 2; i++) {
      points[i]!.toArray(positions, 3 * i);
      const colour = Array.isArray(colours[0]) ? (colours as Rgb[])[i >> 1]! : colours as Rgb;
      for (let k = 0; k < 3; k++) shades[3 * i + k] = (colour[k]! / 255) ** 2.2;
    }
    const geometry = new LineSegmentsGeometry();
    geometry.setPositions(positions);
    geometry.setColors(shades);
    this.lines = new LineSegments2(geometry, this.material);
    this.lines.renderOrder = this.group.renderOrder;
    this.group.add(this.lines);
  }

  style({ width = 2, opacity = 1 }: LineStyle): void {
    Object.assign(this.material, { linewidth: width, opacity, transparent: opacity < 1 });
  }

  dispose(): void {
    this.set([], [0, 0, 0]);
    this.material.dispose();
    this.group.removeFromParent();
  }
}

/** A way as segments. */
export function chain(points: Vector3[], closed = false): Vector3[] {
  const out: Vector3[] = [];
  for (let i = 1; i < points.length; i++) out.push(points[i - 1]!, points[i]!);
  if (closed && points.length > 2) out.push(points.at(-1)!, points[0]!);
  return out;
}
