/** What is under the pointer, beside it. */
import { of, read } from '../api';
import { classColour } from '../colours';
import { make, swatch } from '../dom';
import { boxMatrix } from '../geometry';
import { pick, type Picked } from '../pick';
import type { Settings } from '../settings';
import type { PastState, Thing } from '../types';
import { roomName, type Viewer } from '../viewer';
import { metres, percent, seconds, word } from '../words';
import { Vector3 } from 'three';

/** History of a thing, read when the pointer rests on it. */
class Histories {
  private known = new Map<string, PastState[]>();
  get(session: string, thing: Thing): PastState[] | undefined { return this.known.get(`${session}/${thing.object_id}/${thing.last_seen_ns}`); }
  async read(session: string, thing: Thing): Promise<void> {
    const { object } = await read<{ object: Thing }>(of(session, `/objects/${thing.object_id}`));
    if (this.known.size > 500) this.known.clear();
    this.known.set(`${session}/${thing.object_id}/${thing.last_seen_ns}`, object.history ?? []);
  }
}

export function historyText(history: PastState[], now: Thing): string {
  return history.map(past => `${word(past.state)} ${past.label} at ${seconds(past.stamp_ns).toFixed(1)} s`).join(', ') || `${now.label} since ${seconds(now.first_seen_ns).toFixed(1)} s`;
}

export function tip(viewer: Viewer, settings: Settings): HTMLElement {
  const box = make('div', { className: 'tip', hidden: true });
  const histories = new Histories();
  let at: { x: number; y: number } | null = null, waiting = false, rest = 0;
  const canvas = viewer.stage.renderer.domElement;

  function lines(found: Picked): (Node | string)[] {
    const { view, loop, keyframe, thing, ground } = found;
    if (loop) return [make('b', {}, `loop ${loop.loop_id}`), `${word(loop.state)} · keyframe ${loop.to_keyframe_id} saw ${loop.from_keyframe_id} again`,
      `${percent(loop.inlier_ratio)} of the scan fits · click to ${loop.state === 'LOOP_STATE_VETOED' ? 'take it back' : 'veto it'}`];
    if (keyframe) return [make('b', {}, `keyframe ${keyframe.keyframe_id}`), `${keyframe.sensor_id} · ${keyframe.num_points} points`,
      `${seconds(keyframe.stamp_ns).toFixed(2)} s · ${place(keyframe.t_map_base?.translation)}`];
    if (thing) {
      const s = thing.box?.size_m, history = histories.get(view.data.id, thing);
      const out: (Node | string)[] = [make('b', {}, swatch(classColour(thing.label)), `${thing.label} ${thing.object_id}`),
        `${percent(thing.confidence)} sure · ${word(thing.state)} · seen ${thing.num_observations} times`,
        `${metres(s?.x)} × ${metres(s?.y)} × ${metres(s?.z)} · at ${place(new Vector3().setFromMatrixPosition(boxMatrix(thing.box)))}`];
      if (history) out.push(historyText(history, thing));
      return out;
    }
    if (!ground) return [];
    const room = viewer.roomAt(view, ground.x, ground.y);
    return [`${view.data.session?.display_name || view.data.id}: ${place({ ...ground, z: view.floor })}${room ? ` · ${roomName(room)}` : ''}`];
  }
  const place = (p: { x: number; y: number; z: number } | undefined): string => `${(p?.x ?? 0).toFixed(2)}, ${(p?.y ?? 0).toFixed(2)}, ${(p?.z ?? 0).toFixed(2)} m`;

  function draw(): void {
    waiting = false;
    if (!at || !viewer.chosen) { box.hidden = true; return; }
    const found = pick(viewer.stage, viewer.views, viewer.chosen, at.x, at.y, settings.mode !== 'look');
    const content = lines(found);
    box.hidden = !content.length;
    canvas.style.cursor = settings.mode !== 'look' ? 'crosshair' : found.loop || found.thing ? 'pointer' : '';
    box.replaceChildren(...content.map(line => make('div', {}, line)));
    const host = viewer.stage.host.getBoundingClientRect();
    const x = at.x - host.left + 14, y = at.y - host.top + 14;
    box.style.left = `${Math.max(4, Math.min(x, host.width - box.offsetWidth - 8))}px`;
    box.style.top = `${y + box.offsetHeight > host.height - 8 ? Math.max(4, y - box.offsetHeight - 24) : y}px`;
    clearTimeout(rest);
    const { thing, view } = found;
    if (thing && !histories.get(view.data.id, thing)) {
      rest = window.setTimeout(() => void histories.read(view.data.id, thing).then(draw).catch(() => undefined), 250);
    }
  }
  canvas.addEventListener('pointermove', e => {
    at = e.buttons ? null : { x: e.clientX, y: e.clientY };
    if (!waiting) { waiting = true; requestAnimationFrame(draw); }
  });
  canvas.addEventListener('pointerleave', () => { at = null; clearTimeout(rest); box.hidden = true; });
  return box;
}
