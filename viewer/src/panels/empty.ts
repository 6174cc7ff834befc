/** What is said while there is nothing to see. */
import { make, seldom } from '../dom';
import type { Fleet } from '../state/fleet';
import type { Viewer } from '../viewer';

export function emptiness(fleet: Fleet, viewer: Viewer): HTMLElement {
  const box = make('div', { className: 'empty' });
  function draw(): void {
    const blank = viewer.views.filter(view => !view.cloud.count && !view.grid.geometry);
    box.hidden = viewer.views.length > 0 && blank.length < viewer.views.length;
    if (box.hidden) return;
    const data = viewer.chosen?.data;
    box.textContent = !viewer.views.length ? (fleet.list.length ? 'Choose a session at the left.' : 'No session yet.')
      : !data?.session ? `Reading ${data?.id}. One that slept is woken first, which may take some seconds.`
      : data.session.fault ? `${data.id} is set apart: ${data.session.fault.message}` : 'Nothing was mapped yet.';
  }
  fleet.on('list', draw);
  fleet.on('chosen', draw);
  viewer.on('views', () => { for (const view of viewer.views) view.data.on('session', draw); draw(); });
  viewer.stage.afterFrame.add(seldom(draw));
  draw();
  return box;
}
