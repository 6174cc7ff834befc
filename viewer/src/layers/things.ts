/** Things as boxes in the colour of their class, with an arrow for what moves. */
import { BoxGeometry, Color, Group, InstancedMesh, MeshLambertMaterial, Vector3 } from 'three';
import { classColour, rgb, type Rgb } from '../colours';
import { boxMatrix } from '../geometry';
import type { Stage } from '../stage';
import type { Thing } from '../types';
import { Lines } from './lines';

const EDGES: [number, number][] = [[0, 1], [1, 3], [3, 2], [2, 0], [4, 5], [5, 7], [7, 6], [6, 4], [0, 4], [1, 5], [2, 6], [3, 7]];
const CORNERS = Array.from({ length: 8 }, (_, i) => new Vector3(i & 1 ? 0.5 : -0.5, i & 2 ? 0.5 : -0.5, i & 4 ? 0.5 : -0.5));

export class ThingLayer {
  readonly group = new Group();
  shown: Thing[] = [];
  private edges = new Lines({ width: 2 });
  private bold = new Lines({ width: 4.5 });
  private fill: InstancedMesh<BoxGeometry, MeshLambertMaterial> | null = null;

  constructor(private stage: Stage) { this.group.add(this.edges.group, this.bold.group); }

  set(things: Thing[], chosen: string | null): void {
    this.shown = things;
    const points: Vector3[] = [], colours: Rgb[] = [], bold: Vector3[] = [];
    let boldColour: Rgb = [0, 0, 0];
    this.clearFill();
    if (things.length) {
      this.fill = new InstancedMesh(new BoxGeometry(), new MeshLambertMaterial({ transparent: true, opacity: 0.16, depthWrite: false }), things.length);
      this.group.add(this.fill);
    }
    things.forEach((thing, i) => {
      const matrix = boxMatrix(thing.box), colour = rgb(classColour(thing.label));
      this.fill!.setMatrixAt(i, matrix);
      this.fill!.setColorAt(i, new Color().setRGB(colour[0] / 255, colour[1] / 255, colour[2] / 255, 'srgb'));
      const corners = CORNERS.map(corner => corner.clone().applyMatrix4(matrix));
      const edges = EDGES.flatMap(([a, b]) => [corners[a]!, corners[b]!]);
      points.push(...edges);
      for (let k = 0; k < EDGES.length; k++) colours.push(colour);
      if (thing.object_id === chosen) { bold.push(...edges); boldColour = colour; }
      const v = thing.velocity_mps;
      if (thing.state === 'OBJECT_STATE_MOVING' && v && Math.hypot(v.x, v.y) > 0.05) {
        const from = new Vector3().setFromMatrixPosition(matrix), to = from.clone().add(new Vector3(v.x, v.y, v.z));
        const side = new Vector3(-v.y, v.x, 0).multiplyScalar(0.12), back = from.clone().lerp(to, 0.75);
        points.push(from, to, to, back.clone().add(side), to, back.clone().sub(side));
        colours.push(colour, colour, colour);
      }
    });
    if (this.fill) this.fill.computeBoundingSphere();
    this.edges.set(points, colours);
    this.bold.set(bold, boldColour);
    this.stage.draw();
  }

  private clearFill(): void {
    this.fill?.geometry.dispose();
    this.fill?.material.dispose();
    this.fill?.removeFromParent();
    this.fill?.dispose();
    this.fill = null;
  }
  dispose(): void { this.clearFill(); this.edges.dispose(); this.bold.dispose(); }
}
