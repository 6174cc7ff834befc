/** The scene graph: rooms with what is in them, and how things stand to each other. */
import { of, read, wordsOf } from '../api';
import { button, make, show } from '../dom';
import { translation } from '../geometry';
import type { SceneGraph, SceneNode } from '../types';
import type { Viewer } from '../viewer';
import { metres, word } from '../words';

const PERIOD_MS = 4000;
const MOST = 300;

export function graphPanel(viewer: Viewer, isOpen: () => boolean, problem: (text: string) => void): HTMLElement {
  const kind = make('select', { ariaLabel: 'relation', onchange: () => draw() });
  const list = make('div', { className: 'list' });
  let graph: SceneGraph | null = null, of_ = '', at = 0, asked = '', busy = false;

  function fly(node: SceneNode | undefined): void {
    const view = viewer.chosen;
    if (!view || !node) return;
    const id = /^object\/(.+)$/.exec(node.node_id)?.[1];
    if (id) { view.chosenThing = id; view.refresh('things'); }
    viewer.flyTo(view, translation(node.t_map_node), node.kind === 'SCENE_NODE_KIND_ROOM' ? 3 : 1);
  }

  function draw(): void {
    const nodes = new Map((graph?.nodes ?? []).map(n => [n.node_id, n]));
    const kinds = [...new Set((graph?.relations ?? []).map(r => r.kind))].sort();
    show(kind, kinds.join(), () => [make('option', { value: '' }, 'all relations'), ...kinds.map(k => make('option', { value: k }, word(k)))]);
    const relations = (graph?.relations ?? []).filter(r => !kind.value || r.kind === kind.value);
    const name = (id: string): string => { const node = nodes.get(id); return !node ? id : node.kind === 'SCENE_NODE_KIND_OBJECT' ? `${node.label.split(/[\s(]/)[0]} ${id.split('/')[1]}` : node.label; };
    show(list, JSON.stringify([of_, kind.value, relations.map(r => [r.subject_id, r.kind, r.object_id, name(r.subject_id), name(r.object_id)])]), () => [
      ...relations.slice(0, MOST).map(r => make('div', { className: 'row', title: `strength ${r.strength.toFixed(2)}` },
        button(name(r.subject_id), 'fly there', () => fly(nodes.get(r.subject_id)), 'link'), make('i', {}, word(r.kind)),
        button(name(r.object_id), 'fly there', () => fly(nodes.get(r.object_id)), 'link'),
        make('small', {}, r.distance_m > 0.005 ? metres(r.distance_m) : ''))),
      ...(relations.length > MOST ? [make('p', { className: 'soft' }, `and ${relations.length - MOST} more`)] : []),
      ...(relations.length ? [] : [make('p', { className: 'soft' }, 'no relations yet')]),
    ]);
  }

  async function tick(): Promise<void> {
    const view = viewer.chosen;
    if (!view || busy || !isOpen() || document.hidden) return;
    const version = `${view.data.id}/${view.data.session?.map_version}/${view.data.session?.num_objects}`;
    if (of_ === view.data.id && (asked === version || performance.now() - at < PERIOD_MS)) return;
    busy = true;
    try {
      const { graph: found } = await read<{ graph?: SceneGraph }>(of(view.data.id, '/scene-graph'), view.data.signal);
      graph = found ?? null;
      of_ = view.data.id;
      asked = version;
      draw();
    } catch (e) { if (!view.data.signal.aborted && !(e instanceof TypeError)) problem(wordsOf(e)); }
    at = performance.now();
    busy = false;
  }
  setInterval(() => void tick(), 400);
  return make('div', {}, kind, list);
}
