/** What is under the pointer: a loop, a keyframe, a thing, a place on the floor. */
import { Matrix4, Ray, Vector3 } from 'three';
import { boxMatrix, translation } from './geometry';
import type { Stage } from './stage';
import type { Keyframe, Loop, Thing } from './types';
import type { View } from './view';

const NEAR_PX = 9;

export interface Picked {
  view: View;
  loop?: Loop;
  keyframe?: Keyframe;
  thing?: Thing;
  /** On the floor, metres, map frame. */
  ground?: Vector3;
}

function toSegment(px: number, py: number, a: { x: number; y: number }, b: { x: number; y: number }): number {
  const dx = b.x - a.x, dy = b.y - a.y, length = dx * dx + dy * dy;
  const part = length ? Math.max(0, Math.min(1, ((px - a.x) * dx + (py - a.y) * dy) / length)) : 0;
  return Math.hypot(px - a.x - part * dx, py - a.y - part * dy);
}

/** Distance at which a ray enters the unit cube about the origin, if it does. */
function enters(ray: Ray): number | null {
  let near = -Infinity, far = Infinity;
  for (const axis of ['x', 'y', 'z'] as const) {
    const a = (-0.5 - ray.origin[axis]) / ray.direction[axis], b = (0.5 - ray.origin[axis]) / ray.direction[axis];
    near = Math.max(near, Math.min(a, b));
    far = Math.min(far, Math.max(a, b));
  }
  return near <= far && far > 0 ? Math.max(0, near) : null;
}

/** The view whose ground is nearest to the pointer: that in whose box it lies, else the chosen one. */
function under(stage: Stage, views: View[], chosen: View, x: number, y: number): View {
  if (views.length < 2) return chosen;
  const inside = views.filter(view => {
    const place = stage.ground(x, y, view.floor), box = view.box();
    return place && !box.isEmpty() && place.x > box.min.x - 1 && place.x < box.max.x + 1 && place.y > box.min.y - 1 && place.y < box.max.y + 1;
  });
  return inside.includes(chosen) || !inside.length ? chosen : inside[0]!;
}

export function pick(stage: Stage, views: View[], chosen: View, clientX: number, clientY: number, groundOnly = false): Picked {
  const view = under(stage, views, chosen, clientX, clientY);
  const found: Picked = { view };
  const ground = stage.ground(clientX, clientY, view.floor);
  if (ground) found.ground = view.group.worldToLocal(ground);
  if (groundOnly) return found;
  const canvas = stage.renderer.domElement.getBoundingClientRect();
  const px = clientX - canvas.left, py = clientY - canvas.top;
  const screen = (place: Vector3): { x: number; y: number } | null => stage.screen(view.group.localToWorld(place.clone()));

  let best = NEAR_PX;
  if (view.loops.group.visible) for (const { loop, points } of view.loops.arcs) {
    const drawn = points.map(screen);
    for (let i = 1; i < drawn.length; i++) {
      const a = drawn[i - 1], b = drawn[i];
      const distance = a && b ? toSegment(px, py, a, b) : Infinity;
      if (distance < best) { best = distance; found.loop = loop; }
    }
  }
  if (found.loop) return found;

  best = NEAR_PX;
  if (view.keyframes.group.visible) for (const keyframe of view.keyframes.shown) {
    const at = screen(translation(keyframe.t_map_base));
    const distance = at ? Math.hypot(at.x - px, at.y - py) : Infinity;
    if (distance < best) { best = distance; found.keyframe = keyframe; }
  }
  if (found.keyframe && best < NEAR_PX / 2) return found;

  if (view.things.group.visible) {
    const ray = stage.ray(clientX, clientY).ray;
    let nearest = Infinity;
    for (const thing of view.things.shown) {
      const inverse = new Matrix4().multiplyMatrices(view.group.matrixWorld, boxMatrix(thing.box)).invert();
      const distance = enters(ray.clone().applyMatrix4(inverse));
      if (distance === null) continue;
      const metres = stage.camera.position.distanceTo(view.group.localToWorld(translation(thing.box?.t_frame_box)));
      if (metres < nearest) { nearest = metres; found.thing = thing; }
    }
    if (found.thing) delete found.keyframe;
  }
  return found;
}
