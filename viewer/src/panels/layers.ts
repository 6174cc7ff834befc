/** Switches: what is shown, by what points are coloured, how many, and what is cut away. */
import { make } from '../dom';
import type { ColourBy } from '../layers/shading';
import type { LayerName, Settings } from '../settings';
import type { Viewer } from '../viewer';
import { count } from '../words';

const NAMES: [LayerName, string][] = [
  ['points', 'points'], ['grid', 'occupancy'], ['robot', 'robot'], ['trajectory', 'trajectory'], ['keyframes', 'keyframes'], ['loops', 'loops'],
  ['things', 'things'], ['rooms', 'rooms'], ['zones', 'zones'], ['labels', 'labels'], ['surface', 'surface'], ['voxels', 'voxels'], ['heights', 'heights'],
];
export const COLOUR_NAMES: Record<ColourBy, string> = {
  own: 'own colour', height: 'height', class: 'class of things', time: 'time', reflectance: 'reflectance', robot: 'robot',
};
const BUDGETS = [200_000, 500_000, 1_000_000, 2_000_000, 4_000_000, 8_000_000];

export function layersPanel(settings: Settings, viewer: Viewer): HTMLElement {
  const switches = new Map(NAMES.map(([name, text]) => {
    const box = make('input', { type: 'checkbox', name, onchange: () => settings.toggle(name) });
    return [name, { box, row: make('label', { className: 'switch' }, box, text) }] as const;
  }));
  const colour = make('select', { ariaLabel: 'colour by', onchange: () => {
    settings.set({ colourBy: colour.value as ColourBy });
    for (const view of viewer.views) view.recolour();
  } });
  const budget = make('select', { ariaLabel: 'points at most', onchange: () => settings.set({ budget: Number(budget.value) }) },
    ...BUDGETS.map(n => make('option', { value: String(n) }, count(n))));
  const cut = make('input', { type: 'range', min: '0.2', max: '10', step: '0.1', ariaLabel: 'cut above', oninput: () => settings.set({ cut_m: Number(cut.value) >= 10 ? 1e9 : Number(cut.value) }) });
  const height = make('output');
  const apart = make('input', { type: 'checkbox', onchange: () => { settings.set({ apart: apart.checked }); viewer.frame(); } });
  const apartRow = make('label', { className: 'switch' }, apart, 'sessions side by side');

  let channels = '';
  function draw(): void {
    for (const [name, { box, row }] of switches) {
      box.checked = settings.layers[name];
      // What no session keeps cannot be shown.
      row.hidden = (name === 'surface' || name === 'voxels' || name === 'heights') && !viewer.views.some(view => view.has(name));
    }
    const there = [...new Set(viewer.views.flatMap(view => view.channels()))];
    if (there.join() !== channels) {
      channels = there.join();
      colour.replaceChildren(...there.map(by => make('option', { value: by }, COLOUR_NAMES[by])));
    }
    colour.value = settings.colourBy ?? viewer.chosen?.colouredBy() ?? '';
    budget.value = String(settings.budget);
    const top = viewer.chosen ? viewer.chosen.cloud.style.top.value - viewer.chosen.floor : 1e9;
    cut.value = String(Math.min(10, top));
    height.textContent = top > 100 ? 'nothing' : `${top.toFixed(1)} m`;
    apart.checked = settings.apart;
    apartRow.hidden = viewer.views.length < 2;
  }
  settings.on('changed', draw);
  viewer.on('views', () => {
    for (const view of viewer.views) for (const what of ['session', 'things', 'rooms'] as const) view.data.on(what, draw);
    draw();
  });
  draw();
  return make('div', {}, make('div', { className: 'switches' }, ...[...switches.values()].map(s => s.row)),
    make('label', { className: 'field' }, 'colour by', colour), make('label', { className: 'field' }, 'points at most', budget),
    make('label', { className: 'field' }, 'cut above floor', cut, height), apartRow);
}
