/** Things of the chosen session: filtered by class, one of them in full. */
import { of, read } from '../api';
import { classColour } from '../colours';
import { button, facts, make, seldom, show, swatch } from '../dom';
import { translation } from '../geometry';
import type { Thing } from '../types';
import { roomName, type Viewer } from '../viewer';
import type { View } from '../view';
import { duration, metres, percent, seconds, word } from '../words';

export interface ThingsPanel { element: HTMLElement; choose: (view: View, thing: Thing, fly: boolean) => void }

export function thingsPanel(viewer: Viewer): ThingsPanel {
  const filter = make('select', { ariaLabel: 'class', onchange: () => draw() });
  const detail = make('div', { className: 'detail' }), list = make('div', { className: 'list' });
  let full: Thing | null = null;

  function choose(view: View, thing: Thing, fly: boolean): void {
    view.chosenThing = thing.object_id;
    view.refresh('things');
    if (fly) viewer.flyTo(view, translation(thing.box?.t_frame_box), Math.max(thing.box?.size_m?.x ?? 0, thing.box?.size_m?.y ?? 0, thing.box?.size_m?.z ?? 0));
    full = thing;
    draw();
    void read<{ object: Thing }>(of(view.data.id, `/objects/${thing.object_id}`)).then(({ object }) => {
      if (view.chosenThing === object.object_id) { full = object; draw(); }
    }).catch(() => undefined);
  }

  function clear(): void {
    if (viewer.chosen) { viewer.chosen.chosenThing = null; viewer.chosen.refresh('things'); }
    full = null;
    draw();
  }

  function about(view: View, thing: Thing): Node[] {
    const s = thing.box?.size_m, c = translation(thing.box?.t_frame_box), v = thing.velocity_mps;
    const room = viewer.roomAt(view, c.x, c.y);
    const others = thing.class_probabilities.slice(1, 4).map(p => `${p.label} ${percent(p.probability)}`).join(', ');
    const rows: [string, string][] = [
      ['class', `${thing.label}, ${percent(thing.confidence)}${others ? `; or ${others}` : ''}`], ['size', `${metres(s?.x)} × ${metres(s?.y)} × ${metres(s?.z)}`],
      ['centre', `${c.x.toFixed(2)}, ${c.y.toFixed(2)}, ${c.z.toFixed(2)} m`], ...(room ? [['room', roomName(room)] as [string, string]] : []),
      ['state', word(thing.state) + (thing.state === 'OBJECT_STATE_MOVING' ? `, ${Math.hypot(v?.x ?? 0, v?.y ?? 0).toFixed(2)} m/s` : '')],
      ['seen', `${thing.num_observations} times over ${duration(seconds(thing.last_seen_ns) - seconds(thing.first_seen_ns))}`],
      ...(full?.history ?? []).map(past => ['was', `${word(past.state)} ${past.label} from ${seconds(past.stamp_ns).toFixed(1)} s`] as [string, string]),
    ];
    return [make('div', { className: 'head' }, swatch(classColour(thing.label)), make('b', {}, `${thing.label} ${thing.object_id}`), button('×', 'choose none', clear, 'close')), facts(rows)];
  }

  function draw(): void {
    const view = viewer.chosen;
    const all = view ? view.things.shown : [];
    const classes = [...new Set(all.map(t => t.label))].sort();
    show(filter, classes.join(), () => [make('option', { value: '' }, 'all classes'), ...classes.map(c => make('option', { value: c }, c))]);
    const fitting = all.filter(t => !filter.value || t.label === filter.value).sort((a, b) => a.label.localeCompare(b.label) || Number(a.object_id) - Number(b.object_id));
    const chosen = view ? all.find(t => t.object_id === view.chosenThing) : undefined;
    show(detail, JSON.stringify([chosen?.object_id, chosen?.num_observations, full?.history?.length]), () => view && chosen ? about(view, chosen) : []);
    show(list, JSON.stringify([view?.data.id, filter.value, view?.chosenThing, fitting.map(t => [t.object_id, t.label, t.confidence.toFixed(2), t.state])]), () => fitting.length
      ? fitting.slice(0, 500).map(thing => make('button', {
        type: 'button', className: 'row', data: { chosen: String(thing.object_id === view?.chosenThing) }, title: 'fly there', onclick: () => choose(view!, thing, true),
      }, swatch(classColour(thing.label)), make('span', { className: 'grow' }, `${thing.label} ${thing.object_id}`), make('small', {}, thing.state === 'OBJECT_STATE_MOVING' ? 'moving ' : '', percent(thing.confidence))))
      : [make('p', { className: 'soft' }, 'no things found yet')]);
  }
  viewer.stage.afterFrame.add(seldom(draw));
  viewer.on('views', () => { full = null; draw(); });
  return { element: make('div', {}, filter, detail, list), choose };
}
