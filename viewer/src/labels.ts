/** Names over the picture: text of the page, which stays sharp; of two that would overlap, the more important one is shown. */
import type { Vector3 } from 'three';
import { make } from './dom';
import type { Stage } from './stage';

export interface Label { key: string; text: string; place: Vector3; colour: string; importance: number; kind: 'thing' | 'room' | 'robot' | 'path' | 'zone' }

const MOST = 120;

export class Labels {
  private host = make('div', { className: 'labels' });
  private shown = new Map<string, { element: HTMLDivElement; width: number; height: number; text: string }>();
  /** Asked before each frame. */
  source: () => Label[] = () => [];

  constructor(private stage: Stage) {
    stage.host.append(this.host);
    stage.afterFrame.add(() => this.place());
  }

  private place(): void {
    const { clientWidth: width, clientHeight: height } = this.stage.host;
    const taken: [number, number, number, number][] = [];
    const kept = new Set<string>();
    const labels = this.source().sort((a, b) => b.importance - a.importance);
    for (const label of labels) {
      if (kept.size >= MOST) break;
      const at = this.stage.screen(label.place);
      if (!at || at.x < 0 || at.y < 0 || at.x > width || at.y > height) continue;
      const held = this.element(label);
      const box: [number, number, number, number] =
        [at.x - held.width / 2, at.y - held.height - 4, at.x + held.width / 2, at.y - 4];
      if (taken.some(t => t[0] < box[2] && t[2] > box[0] && t[1] < box[3] && t[3] > box[1])) continue;
      taken.push(box);
      kept.add(label.key);
      held.element.style.transform = `translate(${box[0].toFixed(1)}px, ${box[1].toFixed(1)}px)`;
      held.element.hidden = false;
    }
    for (const [key, held] of this.shown) {
      if (kept.has(key)) continue;
      held.element.hidden = true;
      if (this.shown.size > 4 * MOST) { held.element.remove(); this.shown.delete(key); }
    }
  }

  private element(label: Label): { element: HTMLDivElement; width: number; height: number; text: string } {
    let held = this.shown.get(label.key);
    if (!held) {
      held = { element: make('div', { className: `label ${label.kind}` }), width: 0, height: 0, text: '' };
      this.host.append(held.element);
      this.shown.set(label.key, held);
    }
    if (held.text !== label.text) {
      held.element.hidden = false;
      held.element.textContent = held.text = label.text;
      held.width = held.element.offsetWidth;
      held.height = held.element.offsetHeight;
    }
    held.element.style.setProperty('--tint', label.colour);
    return held;
  }
}
