/** A planned path, or what is in its way. */
import { Group, Mesh, MeshBasicMaterial, RingGeometry, SphereGeometry, Vector3, DoubleSide } from 'three';
import { rgb } from '../colours';
import type { Stage } from '../stage';
import type { PlanAnswer, Vector2 } from '../types';
import { duration, metres, word } from '../words';
import { chain, Lines } from './lines';

const WAY = '#d23fc0', BLOCKED = '#e5352b';

export class PlanLayer {
  readonly group = new Group();
  /** What is said at the goal. */
  label: { place: Vector3; text: string; colour: string } | null = null;
  private lines = new Lines({ width: 5, onTop: true });
  private goal = new Mesh(new RingGeometry(0.16, 0.24, 40), new MeshBasicMaterial({ color: WAY, side: DoubleSide }));
  private obstacle = new Mesh(new SphereGeometry(0.12, 20, 12), new MeshBasicMaterial({ color: BLOCKED }));

  constructor(private stage: Stage) {
    this.group.add(this.lines.group, this.goal, this.obstacle);
    this.clear();
  }

  show(goal: Vector2, answer: PlanAnswer): void {
    const { path, no_path } = answer;
    const text = path ? `${metres(path.length_m)} · ${duration(path.duration_s)}` : `no path: ${word(no_path?.reason ?? '')}`;
    this.label = { place: new Vector3(goal.x, goal.y, 0.1), text, colour: path ? WAY : BLOCKED };
    this.goal.visible = true;
    this.goal.position.set(goal.x, goal.y, 0.06);
    this.goal.material.color.set(path ? WAY : BLOCKED);
    const way = (path?.waypoints ?? []).map(p => new Vector3(p.x_m, p.y_m, 0.08));
    const block = no_path?.blocking;
    this.obstacle.visible = !!block?.obstacle;
    if (block?.obstacle) this.obstacle.position.set(block.obstacle.x, block.obstacle.y, 0.12);
    const cross = block?.position && block.obstacle
      ? [new Vector3(block.position.x, block.position.y, 0.12), new Vector3(block.obstacle.x, block.obstacle.y, 0.12)] : [];
    this.lines.set(way.length ? chain(way) : cross, rgb(way.length ? WAY : BLOCKED));
    this.stage.draw();
  }

  clear(): void {
    this.label = null;
    this.goal.visible = this.obstacle.visible = false;
    this.lines.set([], [0, 0, 0]);
    this.stage.draw();
  }

  /** What marks a place is as large as can be seen. */
  resize(): void {
    for (const mark of [this.goal, this.obstacle]) {
      const size = this.stage.metresPerPixel(mark.getWorldPosition(new Vector3()));
      mark.scale.setScalar(Math.max(1, 10 * size / 0.2));
    }
  }
  dispose(): void { this.lines.dispose(); }
}
