/** The robot: a body that points ahead, its axes, and what its cameras see. */
import {
  ArrowHelper, BufferGeometry, Color, ConeGeometry, CylinderGeometry, Group, LineBasicMaterial, LineSegments, Mesh, MeshLambertMaterial, Vector3,
} from 'three';
import { rotation, translation, type Placed } from '../geometry';
import type { Stage } from '../stage';
import type { SensorStatus } from '../types';

/** Never smaller than this on the screen, pixels. */
const LEAST_PX = 22;
const LENGTH_M = 0.55;
const VIEW_M = 0.9;

export class RobotLayer {
  readonly group = new Group();
  private body = new Group();
  private cameras = new Group();
  private material: MeshLambertMaterial;

  constructor(private stage: Stage, colour: string) {
    this.material = new MeshLambertMaterial({ color: new Color(colour) });
    const nose = new Mesh(new ConeGeometry(0.17, 0.34, 24), this.material);
    nose.rotation.z = -Math.PI / 2;
    nose.position.set(0.3, 0, 0.14);
    const base = new Mesh(new CylinderGeometry(0.2, 0.22, 0.22, 32), this.material);
    base.rotation.x = Math.PI / 2;
    base.position.z = 0.13;
    const axis = (x: number, y: number, z: number, colour: number): ArrowHelper =>
      new ArrowHelper(new Vector3(x, y, z), new Vector3(0, 0, 0.14), 0.75, colour, 0.12, 0.06);
    this.body.add(base, nose, axis(1, 0, 0, 0xd8433b), axis(0, 1, 0, 0x21a366), axis(0, 0, 1, 0x2f78d0));
    this.group.add(this.body, this.cameras);
    this.group.visible = false;
  }

  /** Draws the pyramids that cameras see, as they are mounted. */
  setSensors(sensors: SensorStatus[]): void {
    this.cameras.clear();
    for (const { spec } of sensors) {
      const i = spec.intrinsics;
      if (!i?.fx_px) continue;
      const at = (u: number, v: number): Vector3 =>
        new Vector3((u - i.cx_px) / i.fx_px, (v - i.cy_px) / i.fy_px, 1).multiplyScalar(VIEW_M);
      const corners = [at(0, 0), at(i.width_px, 0), at(i.width_px, i.height_px), at(0, i.height_px)], eye = new Vector3();
      const points = corners.flatMap((corner, k) => [eye, corner, corner, corners[(k + 1) % 4]!]);
      const lines = new LineSegments(new BufferGeometry().setFromPoints(points), new LineBasicMaterial({ color: this.material.color }));
      lines.position.copy(translation(spec.t_base_sensor));
      lines.quaternion.copy(rotation(spec.t_base_sensor));
      this.cameras.add(lines);
    }
  }

  place(placed: Placed | null): void {
    this.group.visible = placed !== null;
    if (!placed) return;
    this.group.position.copy(placed.position);
    this.group.quaternion.copy(placed.rotation);
    this.material.emissive.set(placed.lost ? 0x99201a : 0x000000);
    this.stage.draw();
  }

  /** As large as it has to be to be seen. */
  resize(): void {
    const at = this.group.getWorldPosition(new Vector3());
    this.body.scale.setScalar(Math.max(1, LEAST_PX * this.stage.metresPerPixel(at) / LENGTH_M));
  }
}
