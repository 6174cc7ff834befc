/** Loops: what holds the map together, and what was taken out of it. */
import { of, send, wordsOf } from '../api';
import { LOOP_COLOURS } from '../colours';
import { button, make, show, swatch } from '../dom';
import { translation } from '../geometry';
import type { Loop } from '../types';
import type { View } from '../view';
import type { Viewer } from '../viewer';
import { percent, word } from '../words';
import type { Notices } from './notice';

export interface LoopsPanel { element: HTMLElement; choose: (loop: Loop) => void }

export function loopsPanel(viewer: Viewer, notices: Notices): LoopsPanel {
  const list = make('div', { className: 'list' });
  let chosen: string | null = null;

  async function veto(view: View, loop: Loop, vetoed: boolean, isUndo: boolean): Promise<void> {
    try {
      const answer = await send<{ loop: Loop; num_keyframes_moved: string }>('POST', of(view.data.id, `/map/loops/${loop.loop_id}/veto`), { vetoed });
      view.data.setLoop(answer.loop);
      const text = `Loop ${loop.loop_id} ${vetoed ? 'was taken out of the map' : 'is let in again'}; ${answer.num_keyframes_moved} keyframes moved.`;
      if (isUndo) notices.tell(text, 6000, 'good'); else notices.done(text, () => void veto(view, loop, !vetoed, true));
    } catch (e) { notices.problem(wordsOf(e)); }
  }

  function fly(view: View, loop: Loop): void {
    const to = view.data.keyframes.get(loop.to_keyframe_id);
    if (to) viewer.flyTo(view, translation(to.t_map_base), 2);
  }

  function row(view: View, loop: Loop): HTMLElement {
    const vetoed = loop.state === 'LOOP_STATE_VETOED';
    return make('div', { className: 'row', data: { chosen: String(loop.loop_id === chosen), loop: loop.loop_id } }, swatch(LOOP_COLOURS[loop.state] ?? '#8a94a3'),
      make('button', { type: 'button', className: 'link grow', title: 'fly there', onclick: () => { chosen = loop.loop_id; fly(view, loop); draw(); } },
        `${loop.loop_id}: keyframes ${loop.from_keyframe_id} and ${loop.to_keyframe_id}`, make('small', {}, ` ${word(loop.state)}, ${percent(loop.inlier_ratio)} fit`)),
      button(vetoed ? 'take back' : 'veto', vetoed ? 'let it in again' : 'take it out of the map', () => void veto(view, loop, !vetoed, false)));
  }

  function draw(): void {
    const view = viewer.chosen;
    const loops = view ? [...view.data.loops.values()].sort((a, b) => Number(b.loop_id) - Number(a.loop_id)) : [];
    // What was clicked comes first.
    loops.sort((a, b) => Number(b.loop_id === chosen) - Number(a.loop_id === chosen));
    show(list, JSON.stringify([view?.data.id, chosen, loops.map(l => [l.loop_id, l.state])]), () => loops.length
      ? loops.slice(0, 300).map(loop => row(view!, loop)) : [make('p', { className: 'soft' }, 'no place was seen again yet')]);
  }
  viewer.on('views', () => {
    for (const view of viewer.views) view.data.on('loops', draw);
    draw();
  });
  draw();
  return { element: list, choose: loop => { chosen = loop.loop_id; draw(); } };
}
