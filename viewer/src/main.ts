/** Puts the parts together. */
import { button, make } from './dom';
import { emptiness } from './panels/empty';
import { filesPanel } from './panels/files';
import { graphPanel } from './panels/graph';
import { layersPanel } from './panels/layers';
import { legend } from './panels/legend';
import { logPanel } from './panels/log';
import { loopsPanel } from './panels/loops';
import { keyForm, Notices } from './panels/notice';
import { planPanel } from './panels/plan';
import { sessionsPanel } from './panels/sessions';
import { section, shell, Tabs } from './panels/shell';
import { statePanel } from './panels/state';
import { thingsPanel } from './panels/things';
import { timeline } from './panels/timeline';
import { tip } from './panels/tip';
import { zonesPanel } from './panels/zones';
import { pick } from './pick';
import { Settings } from './settings';
import { Stage } from './stage';
import { Fleet } from './state/fleet';
import { Viewer } from './viewer';

/** A press that moves farther than this turns the view, and is no click, pixels. */
const STILL_PX = 5;

function begin(): void {
  const host = make('main', { className: 'stage' });
  const notices = new Notices(), settings = new Settings(), fleet = new Fleet();
  let stage: Stage;
  try { stage = new Stage(host); } catch {
    document.body.append(make('p', { className: 'nowebgl' }, 'This browser shows no WebGL, which the 3D view needs. The API is at ', make('a', { href: '/docs' }, '/docs'), '.'));
    return;
  }
  const viewer = new Viewer(stage, settings, fleet);
  const problem = (text: string): void => notices.problem(text);
  fleet.on('problem', problem);
  viewer.on('problem', problem);

  const things = thingsPanel(viewer), loops = loopsPanel(viewer, notices), plan = planPanel(viewer, settings), zones = zonesPanel(viewer, settings, notices);
  const graph = graphPanel(viewer, () => tabs.isOpen('Graph'), problem);
  const tabs: Tabs = new Tabs([
    { name: 'State', element: statePanel(viewer) }, { name: 'Things', element: things.element }, { name: 'Graph', element: graph },
    { name: 'Plan', element: plan.element }, { name: 'Loops', element: loops.element }, { name: 'Zones', element: zones.element }, { name: 'Events', element: logPanel(viewer) },
  ]);

  const follow = button('Follow', 'keep the robot in the middle', () => settings.set({ follow: !settings.follow }));
  settings.on('changed', () => { follow.dataset.chosen = String(settings.follow); stage.draw(); });
  const planning = button('Plan', 'click on the floor for a path', () => { settings.setMode(settings.mode === 'plan' ? 'look' : 'plan'); tabs.show('Plan'); });
  settings.on('mode', mode => { planning.dataset.chosen = String(mode === 'plan'); host.dataset.mode = mode; });
  const bar = [make('h1', {}, 'percept'),
    make('div', { className: 'tools' }, button('Fit', 'show everything', () => viewer.frame()), button('Top', 'look from above', () => viewer.frame(true)), follow, planning),
    keyForm(), make('nav', {}, make('a', { href: '/docs' }, 'API'), make('a', { href: '/openapi.json' }, 'openapi.json'))];
  host.append(emptiness(fleet, viewer), legend(settings, viewer), tip(viewer, settings), timeline(viewer, settings), notices.element);
  const unfold = shell(bar, [section('Sessions', sessionsPanel(fleet, viewer)), section('Layers', layersPanel(settings, viewer)), section('Files', filesPanel(viewer, problem), false)], host, tabs.element);

  let pressed: { x: number; y: number } | null = null;
  const canvas = stage.renderer.domElement;
  canvas.addEventListener('pointerdown', e => { pressed = e.isPrimary && e.button === 0 ? { x: e.clientX, y: e.clientY } : null; });
  canvas.addEventListener('pointerup', e => {
    if (!pressed || !viewer.chosen || Math.hypot(e.clientX - pressed.x, e.clientY - pressed.y) > STILL_PX) return;
    const found = pick(stage, viewer.views, viewer.chosen, e.clientX, e.clientY, settings.mode !== 'look');
    if (found.view !== viewer.chosen) viewer.choose(found.view);
    if (settings.mode === 'plan' && found.ground) { tabs.show('Plan'); void plan.to(found.view, found.ground); }
    else if (settings.mode === 'zone' && found.ground) zones.click(found.view, found.ground);
    else if (found.loop) { unfold(); tabs.show('Loops'); loops.choose(found.loop); }
    else if (found.thing) { unfold(); tabs.show('Things'); things.choose(found.view, found.thing, false); }
  });
  addEventListener('keydown', e => { if (e.key === 'Escape') settings.setMode('look'); });
  // Figures for tests: what is drawn, and when the first picture was.
  Object.assign(window, { perceptViewer: { frame: stage.frame, viewer, settings } });
  fleet.begin();
}
begin();
