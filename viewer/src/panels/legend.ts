/** In the picture's corners: what colours mean, how long a metre is, and what is drawn. */
import { classColour, LOOP_COLOURS, RAMP_CSS } from '../colours';
import { make, seldom, show, swatch } from '../dom';
import type { Settings } from '../settings';
import type { Viewer } from '../viewer';
import { count, seconds, word } from '../words';
import { COLOUR_NAMES } from './layers';

const STEPS = [0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];

export function legend(settings: Settings, viewer: Viewer): HTMLElement {
  const box = make('div', { className: 'legend' });
  const bar = make('div', { className: 'scale' });
  const text = make('span'), stats = make('div', { className: 'stats' });
  bar.append(text);

  function scaled(from: string, to: string, title: string): HTMLElement {
    const strip = make('div', { className: 'ramp' });
    strip.style.background = RAMP_CSS;
    return make('div', {}, make('b', {}, title), strip, make('div', { className: 'ends' }, make('span', {}, from), make('span', {}, to)));
  }
  const items = (title: string, list: [string, string][]): HTMLElement =>
    make('div', {}, make('b', {}, title), make('div', { className: 'keys' }, ...list.map(([name, colour]) => make('span', {}, swatch(colour), name))));

  function draw(): void {
    const view = viewer.chosen;
    if (!view) { show(box, '', () => []); return; }
    const by = view.colouredBy();
    const classes = [...new Set(view.things.shown.map(t => t.label))].sort();
    const states = [...new Set(view.loops.arcs.map(a => a.loop.state))];
    const way = view.data.trajectory;
    const key = JSON.stringify([view.data.id, by, classes, states, settings.layers, view.height, view.brightness, by === 'time' && way.length]);
    show(box, key, () => {
      const parts: HTMLElement[] = [];
      if (settings.layers.points && by === 'height') parts.push(scaled(`${view.height.min.toFixed(1).replace('-0.0', '0.0')} m`, `${view.height.max.toFixed(1)} m`, 'height'));
      else if (settings.layers.points && by === 'reflectance') parts.push(scaled(view.brightness.min.toFixed(1), view.brightness.max.toFixed(1), 'reflectance'));
      else if (settings.layers.points && by === 'time') {
        const span = seconds(way.at(-1)?.stamp_ns) - seconds(way[0]?.stamp_ns);
        parts.push(scaled('0 s', `${span.toFixed(0)} s`, 'time when the robot was near'));
      } else if (settings.layers.points) parts.push(make('div', {}, make('b', {}, `points: ${COLOUR_NAMES[by]}`)));
      if (settings.layers.things && classes.length) parts.push(items('things', classes.map(name => [name, classColour(name)])));
      if (settings.layers.loops && states.length) parts.push(items('loops', states.map(state => [word(state), LOOP_COLOURS[state] ?? '#8a94a3'])));
      return parts;
    });
  }

  viewer.stage.afterFrame.add(seldom(draw));
  viewer.stage.afterFrame.add(seldom(() => {
    const px = viewer.stage.metresPerPixel(viewer.stage.controls.target);
    const metres = STEPS.find(step => step / px >= 70) ?? STEPS.at(-1)!;
    bar.style.width = `${(metres / px).toFixed(0)}px`;
    text.textContent = metres < 1 ? `${metres * 100} cm` : `${metres} m`;
    const { draws, points, fps, share } = viewer.stage.frame;
    const held = viewer.views.reduce((sum, view) => sum + view.cloud.count, 0);
    // Keyframes are drawn as points, too.
    const marks = settings.layers.keyframes ? viewer.views.reduce((sum, view) => sum + view.keyframes.shown.length, 0) : 0;
    stats.textContent = `${count(Math.max(0, points - marks))} of ${count(held)} points · ${draws} draws${fps ? ` · ${fps.toFixed(0)} frames/s` : ''}${share < 1 ? ' · thinned' : ''}`;
  }, 100));
  settings.on('changed', draw);
  viewer.on('views', draw);
  return make('div', { className: 'corner' }, box, bar, stats);
}
