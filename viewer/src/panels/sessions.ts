/** The list of sessions: name, state, sensors' verdicts; one or several are shown. */
import { make, show, swatch } from '../dom';
import type { Fleet } from '../state/fleet';
import type { Session } from '../types';
import type { Viewer } from '../viewer';
import { word } from '../words';

export function sessionsPanel(fleet: Fleet, viewer: Viewer): HTMLElement {
  const list = make('div', { className: 'list' });
  const filter = make('input', { type: 'search', placeholder: 'find a session', ariaLabel: 'find a session', oninput: () => draw() });

  const state = (session: Session): string => {
    const view = viewer.views.find(v => v.data.id === session.session_id);
    const pose = (view?.data.pose ?? session.pose)?.state;
    const asleep = session.state !== 'SESSION_STATE_AWAKE' && !view ? word(session.state) : '';
    return asleep || (pose ? word(pose) : word(session.state));
  };
  const verdicts = (session: Session): string => {
    const sensors = viewer.views.find(v => v.data.id === session.session_id)?.data.session?.sensors ?? [];
    const troubled = sensors.filter(s => s.verdict === 'STREAM_VERDICT_TROUBLED').map(s => s.spec.sensor_id);
    if (troubled.length) return `trouble: ${troubled.join(', ')}`;
    return sensors.length ? `${sensors.length} ${sensors.length === 1 ? 'sensor' : 'sensors'}, ${sensors.some(s => s.verdict === 'STREAM_VERDICT_GOOD') ? 'good' : 'silent'}` : '';
  };

  function row(session: Session): HTMLElement {
    const view = viewer.views.find(v => v.data.id === session.session_id);
    const id = session.session_id;
    const box = make('input', { type: 'checkbox', checked: !!view, title: 'show beside the others', ariaLabel: `show ${id} beside the others`, onchange: () => fleet.toggle(id) });
    const name = make('span', { className: 'name' }, session.display_name || id);
    const current = state(session);
    const badge = make('span', { className: 'badge', data: { state: current } }, current);
    const known = view?.data.session ?? session;
    const about = [session.display_name ? id : '', `${known.num_keyframes} keyframes`, `${known.num_objects} things`, verdicts(session)].filter(t => t).join(' · ');
    return make('div', { className: 'session', data: { id, chosen: String(viewer.chosen === view && !!view) } }, box,
      make('button', { type: 'button', onclick: () => { if (view && viewer.views.length > 1) viewer.choose(view); else fleet.choose([id]); } },
        ...(view ? [swatch(view.colour)] : []), name, badge, make('small', {}, about)));
  }

  function draw(): void {
    const text = filter.value.toLowerCase();
    const fits = (s: Session): boolean => `${s.session_id} ${s.display_name}`.toLowerCase().includes(text);
    // Those that are shown come first; thousands would make the page slow.
    const shown = new Set(viewer.views.map(v => v.data.id));
    const all = [...fleet.list.filter(s => shown.has(s.session_id)), ...fleet.list.filter(s => !shown.has(s.session_id) && fits(s))].slice(0, 200);
    const key = JSON.stringify([all.map(s => [s.session_id, s.display_name, state(s), verdicts(s), s.num_keyframes, s.num_objects,
      viewer.views.find(v => v.data.id === s.session_id)?.data.session?.num_keyframes]), [...shown], viewer.chosen?.data.id]);
    filter.hidden = fleet.list.length < 8;
    show(list, key, () => all.length ? all.map(row) : [make('p', { className: 'soft' }, 'none yet: percept sim, percept replay, or a robot makes one')]);
  }

  fleet.on('list', draw);
  viewer.on('views', () => {
    for (const view of viewer.views) { view.data.on('session', draw); view.data.on('pose', draw); }
    draw();
  });
  draw();
  return make('div', {}, filter, list);
}
