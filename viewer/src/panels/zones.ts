/** Zones: what there is, taken away, and drawn anew by clicks. */
import { ask, of, wordsOf } from '../api';
import { button, make, show, swatch } from '../dom';
import { middle } from '../geometry';
import { MASK, zoneColour } from '../layers/areas';
import type { Settings } from '../settings';
import type { Session, Vector2, Zone } from '../types';
import type { View } from '../view';
import type { Viewer } from '../viewer';
import type { Notices } from './notice';
import { Vector3 } from 'three';

export interface ZonesPanel { element: HTMLElement; click: (view: View, place: Vector2) => void }

export function zonesPanel(viewer: Viewer, settings: Settings, notices: Notices): ZonesPanel {
  const list = make('div', { className: 'list' });
  const name = make('input', { placeholder: 'name', maxLength: 64, ariaLabel: 'name of the zone' });
  const kind = make('select', { ariaLabel: 'kind' }, make('option', { value: '0' }, 'keep out'),
    ...[75, 50, 25, 10].map(p => make('option', { value: String(p / 100) }, `at most ${p} % speed`)));
  const draft = button('Draw a zone', 'then click its corners on the floor', () => settings.setMode(settings.mode === 'zone' ? 'look' : 'zone'), 'mode');
  const done = button('Keep it', 'send the zone to the server', () => void keep(), 'good');
  const hint = make('p', { className: 'soft' });
  let drawing: View | null = null;

  /** Writes all zones; refused if somebody else changed the session meanwhile. */
  async function write(view: View, zones: Zone[], text: string, undo: Zone[] | null): Promise<void> {
    const session = view.data.session;
    if (!session) return;
    try {
      const answer = await ask(of(view.data.id, '?update_mask=zones'), {
        method: 'PATCH', headers: { 'content-type': 'application/json', accept: 'application/json', 'if-match': `"${session.etag}"` }, body: JSON.stringify({ zones }),
      });
      view.data.setSession((await answer.json() as { session: Session }).session);
      if (undo) notices.done(text, () => void write(view, undo, 'Taken back.', null)); else notices.tell(text, 5000, 'good');
    } catch (e) { notices.problem(wordsOf(e)); void view.data.readSession(); }
  }

  async function keep(): Promise<void> {
    const view = drawing;
    if (!view || view.draft.length < 3) return;
    const share = Number(kind.value), old = view.data.session?.zones ?? [];
    const zone: Zone = { polygon: view.draft, name: name.value.trim(), ...(share ? { speed_share: share } : { keep_out: true }) };
    settings.setMode('look');
    name.value = '';
    await write(view, [...old, zone], 'The zone is kept.', old);
  }

  function click(view: View, place: Vector2): void {
    if (drawing !== view) { drop(); drawing = view; }
    view.draft = [...view.draft, { x: place.x, y: place.y }];
    view.refresh('zones');
    drawForm();
  }

  function drop(): void {
    if (drawing) { drawing.draft = []; drawing.refresh('zones'); }
    drawing = null;
  }

  function drawForm(): void {
    const on = settings.mode === 'zone', corners = drawing?.draft.length ?? 0;
    draft.textContent = on ? 'Stop drawing' : 'Draw a zone';
    draft.dataset.chosen = String(on);
    for (const each of [name, kind, done]) each.hidden = !on;
    done.disabled = corners < 3;
    hint.textContent = on ? `${corners} corners; three or more make a zone` : '';
  }

  function row(view: View, zones: Zone[], zone: Zone, i: number): HTMLElement {
    const what = zone.keep_out ? 'keep out' : `at most ${Math.round(100 * (zone.speed_share ?? 1))} % speed`;
    return make('div', { className: 'row' }, swatch(zoneColour(zone)),
      make('button', { type: 'button', className: 'link grow', title: 'fly there', onclick: () => { const c = middle(zone.polygon); viewer.flyTo(view, new Vector3(c.x, c.y, view.floor), 3); } }, zone.name || `zone ${i + 1}`, make('small', {}, ` ${what}`)),
      button('remove', 'take the zone away', () => void write(view, zones.filter(z => z !== zone), `${zone.name || 'The zone'} is taken away.`, zones)));
  }

  function drawList(): void {
    const view = viewer.chosen, zones = view?.data.session?.zones ?? [], masks = view?.data.session?.zone_masks ?? [];
    show(list, JSON.stringify([view?.data.id, zones, masks]), () => [
      ...zones.map((zone, i) => row(view!, zones, zone, i)),
      ...masks.map(mask => make('div', { className: 'row' }, swatch(MASK), `${mask.name}: mask, ${mask.keep_out ? 'keep out' : 'speed'}`)),
      ...(zones.length + masks.length ? [] : [make('p', { className: 'soft' }, 'no zones')]),
    ]);
  }
  settings.on('mode', mode => { if (mode !== 'zone') drop(); drawForm(); });
  viewer.on('views', () => {
    for (const view of viewer.views) view.data.on('session', drawList);
    drawList();
  });
  drawForm();
  return { element: make('div', {}, draft, make('div', { className: 'tools' }, kind, name, done), hint, list), click };
}
