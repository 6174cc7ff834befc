/** Parts of the floor: rooms with their doors, and zones. */
import { DoubleSide, Group, Mesh, MeshBasicMaterial, Shape, ShapeGeometry, Vector2, Vector3 } from 'three';
import { rgb, type Rgb } from '../colours';
import type { Stage } from '../stage';
import type { Rooms, Vector2 as Corner, Zone } from '../types';
import { chain, Lines } from './lines';

const TINTS = ['#5b9bd5', '#d5a45b', '#7bb86f', '#b57bc4', '#d57b7b', '#5bbcb8'];
const DOOR: Rgb = [214, 80, 70];
export const KEEP_OUT = '#d8433b', SLOW = '#e0a020', MASK = '#8d6fc0';
export const zoneColour = (zone: Zone): string => zone.keep_out ? KEEP_OUT : SLOW;

/** Polygons with a border and a faint fill, a little above the floor. */
class Areas {
  readonly group = new Group();
  private lines: Lines;
  private fills = new Group();

  constructor(private lift: number, private opacity: number, width: number) {
    this.lines = new Lines({ width });
    this.group.add(this.fills, this.lines.group);
  }

  set(areas: { outline: Corner[]; colour: string }[], more: { points: Vector3[]; colour: Rgb } | null): void {
    this.clear();
    const points: Vector3[] = [], colours: Rgb[] = [];
    for (const { outline, colour } of areas) {
      if (outline.length < 3) continue;
      const border = chain(outline.map(p => new Vector3(p.x, p.y, this.lift)), true);
      points.push(...border);
      for (let i = 0; i < border.length / 2; i++) colours.push(rgb(colour));
      const shape = new Shape(outline.map(p => new Vector2(p.x, p.y)));
      const material = new MeshBasicMaterial({ color: colour, transparent: true, opacity: this.opacity, side: DoubleSide, depthWrite: false });
      const fill = new Mesh(new ShapeGeometry(shape), material);
      fill.position.z = this.lift;
      this.fills.add(fill);
    }
    if (more) { points.push(...more.points); for (let i = 0; i < more.points.length / 2; i++) colours.push(more.colour); }
    this.lines.set(points, colours);
  }

  private clear(): void {
    for (const fill of this.fills.children) {
      (fill as Mesh<ShapeGeometry, MeshBasicMaterial>).geometry.dispose();
      (fill as Mesh<ShapeGeometry, MeshBasicMaterial>).material.dispose();
    }
    this.fills.clear();
  }
  dispose(): void { this.clear(); this.lines.dispose(); }
}

export class RoomLayer {
  private areas = new Areas(0.02, 0.1, 2.5);
  readonly group = this.areas.group;
  constructor(private stage: Stage) {}

  set({ rooms, doors }: Rooms): void {
    const points = doors.flatMap(door => {
      const along = new Vector3(Math.cos(door.angle_rad), Math.sin(door.angle_rad), 0).multiplyScalar(door.width_m / 2);
      const centre = new Vector3(door.center?.x ?? 0, door.center?.y ?? 0, 0.03);
      return [centre.clone().sub(along), centre.clone().add(along)];
    });
    this.areas.set(rooms.map((room, i) => ({ outline: room.outline, colour: TINTS[i % TINTS.length]! })), { points, colour: DOOR });
    this.stage.draw();
  }
  dispose(): void { this.areas.dispose(); }
}

export class ZoneLayer {
  private areas = new Areas(0.05, 0.22, 3);
  readonly group = this.areas.group;
  constructor(private stage: Stage) {}

  /** Zones, the corners of one that is being drawn, and where masks lie. */
  set(zones: Zone[], draft: Corner[], masks: Corner[][]): void {
    const drawn = draft.length > 1 ? { points: chain(draft.map(p => new Vector3(p.x, p.y, 0.07)), draft.length > 2), colour: rgb(KEEP_OUT) } : null;
    this.areas.set([
      ...zones.map(zone => ({ outline: zone.polygon, colour: zoneColour(zone) })),
      ...masks.map(outline => ({ outline, colour: MASK })),
    ], drawn);
    this.stage.draw();
  }
  dispose(): void { this.areas.dispose(); }
}
