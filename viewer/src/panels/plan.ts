/** A path from the robot to where was clicked, or the reason for none. */
import { of, send, wordsOf } from '../api';
import { button, facts, make } from '../dom';
import type { Settings } from '../settings';
import type { PlanAnswer, Vector2 } from '../types';
import type { View } from '../view';
import type { Viewer } from '../viewer';
import { duration, metres, word } from '../words';

/** What can be done where the server says that there is no path. */
const REMEDIES: Record<string, string> = {
  START_OUTSIDE_MAP: 'Drive the robot into what was mapped.',
  START_OCCUPIED: 'Move the robot away from the obstacle, or let it see that the place is free.',
  START_UNKNOWN: 'Let the robot look around, or allow unknown cells.',
  START_DOES_NOT_FIT: 'Move the robot away from the obstacle, or plan with a smaller radius.',
  START_IN_KEEP_OUT: 'Move the robot out of the zone, or change the zone.',
  GOAL_OUTSIDE_MAP: 'Click where the map has floor, or map farther.',
  GOAL_OCCUPIED: 'Click beside the obstacle.',
  GOAL_UNKNOWN: 'Let the robot look there first.',
  GOAL_DOES_NOT_FIT: 'Click farther from the obstacle, or plan with a smaller radius.',
  GOAL_IN_KEEP_OUT: 'Click outside of the zone, or change the zone.',
  UNREACHABLE: 'Clear the place that is marked, map a way around it, or plan with a smaller radius.',
  NOT_STEERABLE: 'Allow reverse, or a smaller turning radius.',
  SEARCH_LIMIT: 'Plan to a nearer place, or raise planning.max_expansions.',
  DEADLINE: 'Give it more time.',
  LOST: 'Bring the robot back to where it was tracked.',
};

export interface PlanPanel { element: HTMLElement; to: (view: View, goal: Vector2) => Promise<void> }

export function planPanel(viewer: Viewer, settings: Settings): PlanPanel {
  const mode = button('Click to plan', 'then click on the floor', () => settings.setMode(settings.mode === 'plan' ? 'look' : 'plan'), 'mode');
  const out = make('div', { className: 'plan', ariaLive: 'polite' });
  let last: { view: View; goal: Vector2 } | null = null;
  settings.on('mode', now => {
    mode.textContent = now === 'plan' ? 'Stop planning' : 'Click to plan';
    mode.dataset.chosen = String(now === 'plan');
  });

  function clear(): void {
    last?.view.plan.clear();
    last = null;
    out.replaceChildren();
  }

  function tell(view: View, goal: Vector2, answer: PlanAnswer): Node[] {
    const tools = make('div', { className: 'tools' }, button('Plan again', 'with the map as it is now', () => void to(view, goal)), button('Clear', 'take the path away', clear));
    const where: [string, string] = ['goal', `${goal.x.toFixed(2)}, ${goal.y.toFixed(2)} m`];
    if (answer.path) {
      const { length_m, duration_s, min_clearance_m, waypoints } = answer.path;
      return [make('p', { className: 'good' }, `${metres(length_m)} in ${duration(duration_s)}`), facts([where, ['waypoints', String(waypoints.length)],
        ...(min_clearance_m !== undefined ? [['least clearance', metres(min_clearance_m)] as [string, string]] : [])]), tools];
    }
    const reason = (answer.no_path?.reason ?? '').replace('NO_PATH_REASON_', ''), blocking = answer.no_path?.blocking;
    const thing = blocking?.object_id !== undefined ? view.data.things.get(blocking.object_id) : undefined;
    const rows: [string, string][] = [where, ['reason', reason.toLowerCase().replaceAll('_', ' ')]];
    if (blocking) rows.push(['in the way', `${word(blocking.state)}${thing ? `: ${thing.label} ${thing.object_id}` : ''} at ${blocking.obstacle?.x.toFixed(2)}, ${blocking.obstacle?.y.toFixed(2)} m`]);
    return [make('p', { className: 'bad' }, `No path: ${answer.no_path?.detail ?? reason}`), facts(rows), ...(REMEDIES[reason] ? [make('p', {}, REMEDIES[reason])] : []), tools];
  }

  async function to(view: View, goal: Vector2): Promise<void> {
    if (last && last.view !== view) last.view.plan.clear();
    last = { view, goal };
    try {
      const answer = await send<PlanAnswer>('POST', of(view.data.id, '/plan'), { goal: { x: goal.x, y: goal.y } });
      view.plan.show(goal, answer);
      out.replaceChildren(...tell(view, goal, answer));
      out.dataset.outcome = answer.path ? 'path' : 'none';
    } catch (e) { out.replaceChildren(make('p', { className: 'bad' }, wordsOf(e))); }
  }
  viewer.on('views', () => { if (last && !viewer.views.includes(last.view)) clear(); });
  return { element: make('div', {}, mode, make('p', { className: 'soft' }, 'A click on the floor asks for a path from where the robot is.'), out), to };
}
