/** What happened, newest first. */
import { make, show } from '../dom';
import type { Viewer } from '../viewer';
import { seconds } from '../words';

export function logPanel(viewer: Viewer): HTMLElement {
  const list = make('ol', { className: 'log' });
  function draw(): void {
    const data = viewer.chosen?.data;
    show(list, `${data?.id}/${data?.log[0]?.token}/${data?.log[0]?.text}`, () => data?.log.length ? data.log.map(line =>
      make('li', { data: { kind: line.kind } }, make('span', { className: 'soft' }, `${seconds(line.stamp_ns).toFixed(1)} s `), line.text))
      : [make('li', { className: 'soft' }, 'nothing has happened since this page began')]);
  }
  viewer.on('views', () => {
    for (const view of viewer.views) view.data.on('log', draw);
    draw();
  });
  draw();
  return list;
}
