/** Pose and sensors of the chosen session. */
import { facts, make, show } from '../dom';
import { translation, yaw } from '../geometry';
import type { SensorStatus } from '../types';
import type { Viewer } from '../viewer';
import { degrees, percent, seconds, word } from '../words';

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
      make('div', { className: s.verdict === 'STREAM_VERDICT_TROUBLED' ? 'bad' : 'soft' }, s.verdict_message || word(s.verdict)));
  }

  function drawSensors(): void {
    const session = viewer.chosen?.data.session;
    show(sensors, JSON.stringify(session?.sensors ?? []), () => session?.sensors.length ? session.sensors.map(row) : [make('p', { className: 'soft' }, 'no sensors declared')]);
  }
  viewer.on('views', () => {
    for (const view of viewer.views) { view.data.on('pose', drawPose); view.data.on('session', drawSensors); }
    drawPose();
    drawSensors();
  });
  return make('div', {}, pose, make('h3', {}, 'Sensors'), sensors);
}
