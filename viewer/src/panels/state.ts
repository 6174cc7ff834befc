/** Pose and sensors of the chosen session. */
import { facts, make, show } from '../dom';
import { translation, yaw } from '../geometry';
import type { SensorStatus, StreamFigures, StreamNote } from '../types';
import type { Viewer } from '../viewer';
import { degrees, percent, seconds, word } from '../words';

/** A stream's newest frames for a person, most telling first. */
function figures(f: StreamFigures): string {
  const ms = (s: number): string => `${(1000 * s).toFixed(s < 0.01 ? 1 : 0)} ms`;
  const part = (value: number | undefined, text: (v: number) => string): string[] => value === undefined ? [] : [text(value)];
  return [
    ...part(f.latency_p50_s, v => `worked in after ${ms(v)} (p95 ${ms(f.latency_p95_s ?? v)})`), ...part(f.jitter_s, v => `jitter ${ms(v)}`),
    ...part(f.longest_interval_s, v => `longest pause ${ms(v)}`), ...part(f.frame_bytes, v => `${(v / 1000).toFixed(1)} kB each`),
    // What was recorded long ago has no delay.
    ...part(f.delay_s, v => Math.abs(v) < 3600 ? `delay ${ms(v)}` : ''), ...part(f.measured_ratio, v => `${percent(v)} measured`),
    ...part(f.median_range_m, v => `median range ${v.toFixed(2)} m`),
  ].filter(text => text).join(' · ');
}

export function statePanel(viewer: Viewer): HTMLElement {
  const pose = make('div'), sensors = make('div', { className: 'list' });

  function drawPose(): void {
    const p = viewer.chosen?.data.pose;
    const key = p ? `${p.stamp_ns}/${p.state}` : '';
    show(pose, key, () => {
      if (!p) return [make('p', { className: 'soft' }, 'no frame yet')];
      const t = translation(p.t_map_base), state = word(p.state);
      return [facts([
        ['state', make('span', { className: 'badge', data: { state } }, state)], ['position', `${t.x.toFixed(2)}, ${t.y.toFixed(2)}, ${t.z.toFixed(2)} m`],
        ['yaw', degrees(yaw(p.t_map_base))], ['stamp', `${seconds(p.stamp_ns).toFixed(3)} s`], ['inliers', percent(p.inlier_ratio)], ['residual', `${(1000 * p.rmse_m).toFixed(1)} mm`],
        ['map version', p.map_version], ...([['why', p.lost_message], ['waiting for', p.waiting_message], ['led by', p.led_by],
          ['scale', p.scale === 'SCALE_UNKNOWN' ? p.scale_message : '']] as [string, string][]).filter(([, text]) => text),
      ])];
    });
  }

  function row(s: SensorStatus): HTMLElement {
    const lost = [['refused', s.rejected], ['dropped', s.dropped], ['missing', s.gaps]].filter(([, n]) => n !== '0').map(([name, n]) => `${n} ${name}`).join(', ');
    return make('div', { className: 'sensor' }, make('b', {}, s.spec.sensor_id), make('span', { className: 'soft' }, ` ${word(s.spec.kind)}`),
      make('div', {}, `${s.accepted} frames${s.rate_hz === undefined ? '' : ` · ${s.rate_hz.toFixed(1)} Hz`} · ${lost || 'none lost'}`),
      make('div', { className: 'soft' }, figures(s.figures ?? {})),
      ...(s.troubles.length ? s.troubles.map(t => make('div', { className: 'bad', data: { trouble: word(t.kind) } }, t.message))
        : [make('div', { className: 'soft' }, s.verdict_message || word(s.verdict))]));
  }

  function note(n: StreamNote): HTMLElement {
    return make('div', { className: 'sensor' }, make('b', {}, n.stream), make('div', { className: 'bad' }, n.message));
  }

  function drawSensors(): void {
    const session = viewer.chosen?.data.session;
    const notes = session?.stream_notes ?? [];
    show(sensors, JSON.stringify([session?.sensors, notes]), () => [
      ...(session?.sensors.length ? session.sensors.map(row) : [make('p', { className: 'soft' }, 'no sensors declared')]), ...notes.map(note)]);
  }
  viewer.on('views', () => {
    for (const view of viewer.views) { view.data.on('pose', drawPose); view.data.on('session', drawSensors); }
    drawPose();
    drawSensors();
  });
  return make('div', {}, pose, make('h3', {}, 'Sensors'), sensors);
}
