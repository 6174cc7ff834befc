/** The map as files. */
import { ask, hasKey, of, wordsOf } from '../api';
import { make, show } from '../dom';
import type { Viewer } from '../viewer';

const FILES = ['overview.png', 'occupancy.png', 'cloud.png', 'map.yaml', 'map.pgm', 'cloud.ply', 'cloud.pcd', 'cloud.laz', 'trajectory.tum'];

export function filesPanel(viewer: Viewer, problem: (text: string) => void): HTMLElement {
  const list = make('div', { className: 'files' });

  // Links carry no key: what they lead to is fetched, and then kept.
  async function fetched(path: string): Promise<void> {
    try {
      const url = URL.createObjectURL(await (await ask(path)).blob());
      make('a', { href: url, download: path.split('/').pop()!.split('?')[0]! }).click();
      setTimeout(() => URL.revokeObjectURL(url), 60_000);
    } catch (e) { problem(wordsOf(e)); }
  }
  const link = (path: string, name: string): HTMLElement => make('a', {
    href: path, target: '_blank', rel: 'noopener', onclick: e => { if (hasKey()) { e.preventDefault(); void fetched(path); } },
  }, name);

  viewer.on('views', () => {
    const id = viewer.chosen?.data.id;
    show(list, id ?? '', () => id === undefined ? [] : [
      ...FILES.map(name => link(of(id, `/map/files/${name}`), name)), link(of(id, '/scene-graph'), 'scene graph'),
      link(of(id, '/scene-graph?format=dot'), 'graph.dot'), link(of(id, '/trajectory'), 'trajectory'), link(of(id), 'session')]);
  });
  return list;
}
