/** A slider over the drive: robot, camera, way, keyframes and things as they were then. */
import { of, query, readAll } from '../api';
import { button, make } from '../dom';
import type { Settings } from '../settings';
import type { Thing } from '../types';
import type { Viewer } from '../viewer';
import { duration, seconds } from '../words';

const THINGS_MS = 300;
/** The drive is played so many times as fast. */
const SPEED = 10;

export function timeline(viewer: Viewer, settings: Settings): HTMLElement {
  const slider = make('input', { type: 'range', min: '0', max: '1', step: 'any', value: '1', ariaLabel: 'time', oninput: () => go(Number(slider.value)) });
  const text = make('output');
  const live = button('live', 'as it is now', () => { stop(); back(); }, 'live');
  const play = button('▶', `play ${SPEED} times as fast`, () => playing ? stop() : begin());
  let playing = 0, wanted: number | null = null, busy = false;

  const range = (): [number, number] => {
    const way = viewer.chosen?.data.trajectory;
    return [seconds(way?.[0]?.stamp_ns), seconds(way?.at(-1)?.stamp_ns)];
  };

  function go(share: number): void {
    const [first, last] = range();
    if (share >= 1) { back(); return; }
    settings.setTime(first + share * (last - first));
    wanted = settings.time_s;
    void things();
  }

  function back(): void {
    settings.setTime(null);
    wanted = null;
    slider.value = '1';
    for (const view of viewer.views) { view.pastThings = null; view.refresh('things'); }
  }

  /** Things as they were, of the newest time that was asked for. */
  async function things(): Promise<void> {
    if (busy) return;
    busy = true;
    while (wanted !== null) {
      const time = wanted;
      wanted = null;
      for (const view of viewer.views) {
        try {
          const at_ns = BigInt(Math.round(time * 1e9)).toString();
          const then = await readAll<Thing>(of(view.data.id, '/objects' + query({ at_ns })), 'objects', view.data.signal);
          if (settings.time_s !== null) { view.pastThings = then; view.refresh('things'); }
        } catch { /* The slider goes on without them; what is wrong is told where it is live. */ }
      }
      await new Promise(done => setTimeout(done, THINGS_MS));
    }
    busy = false;
  }

  function begin(): void {
    let at = performance.now();
    if (settings.time_s === null) go(0);
    play.textContent = '❚❚';
    const step = (now: number): void => {
      const [first, last] = range(), time = (settings.time_s ?? last) + SPEED * (now - at) / 1000;
      at = now;
      if (time >= last || settings.time_s === null) { stop(); back(); return; }
      slider.value = String((time - first) / Math.max(1e-9, last - first));
      go(Number(slider.value));
      playing = requestAnimationFrame(step);
    };
    playing = requestAnimationFrame(step);
  }
  function stop(): void { cancelAnimationFrame(playing); playing = 0; play.textContent = '▶'; }

  function draw(): void {
    const [first, last] = range();
    element.hidden = last <= first;
    const time = settings.time_s ?? last;
    if (settings.time_s !== null) slider.value = String((time - first) / Math.max(1e-9, last - first));
    text.textContent = `${duration(time - first)} of ${duration(last - first)}`;
    live.dataset.chosen = String(settings.time_s === null);
  }
  settings.on('time', draw);
  viewer.on('views', () => {
    if (settings.time_s !== null) { stop(); back(); }
    for (const view of viewer.views) view.data.on('trajectory', draw);
    draw();
  });
  const element = make('div', { className: 'timeline', hidden: true }, play, slider, text, live);
  return element;
}
