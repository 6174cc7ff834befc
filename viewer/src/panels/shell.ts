/** The page's frame: a bar, two sides that fold, the picture between them. */
import { button, make } from '../dom';

export interface Tab { name: string; element: HTMLElement }

export function section(title: string, content: HTMLElement, open = true): HTMLElement {
  return make('details', { open }, make('summary', {}, title), content);
}

/** One of several panels at a time. */
export class Tabs {
  readonly element: HTMLElement;
  private buttons: HTMLButtonElement[];
  open = 0;

  constructor(private tabs: Tab[]) {
    this.buttons = tabs.map((tab, i) => make('button', { type: 'button', role: 'tab', onclick: () => this.show(tab.name), data: { tab: tab.name } }, tabs[i]!.name));
    this.element = make('div', { className: 'tabs' }, make('div', { className: 'names', role: 'tablist' }, ...this.buttons), ...tabs.map(tab => tab.element));
    for (const tab of tabs) tab.element.classList.add('tab');
    this.show(tabs[0]!.name);
  }

  show(name: string): void {
    this.open = Math.max(0, this.tabs.findIndex(tab => tab.name === name));
    this.tabs.forEach((tab, i) => { tab.element.hidden = i !== this.open; });
    this.buttons.forEach((each, i) => each.setAttribute('aria-selected', String(i === this.open)));
  }

  isOpen(name: string): boolean { return this.tabs[this.open]?.name === name; }
}

/** Puts the page together; what it returns unfolds the right side. */
export function shell(bar: Node[], left: Node[], stage: HTMLElement, right: Node): () => void {
  const sides = { left: make('aside', { className: 'left' }, ...left), right: make('aside', { className: 'right' }, right) };
  const setters = { left: (_: boolean): void => undefined, right: (_: boolean): void => undefined };
  const fold = (side: 'left' | 'right', text: string): HTMLButtonElement => {
    const toggle = button(text, `show or hide the ${side} side`, () => set(!sides[side].hidden), 'fold');
    const set = (hidden: boolean): void => {
      sides[side].hidden = hidden;
      toggle.setAttribute('aria-expanded', String(!hidden));
      // On a narrow screen both would hide the picture.
      if (!hidden && matchMedia('(max-width: 44rem)').matches) setters[side === 'left' ? 'right' : 'left'](true);
    };
    // There a side lies over the picture.
    set(matchMedia('(max-width: 60rem)').matches);
    setters[side] = set;
    return toggle;
  };
  document.body.append(make('header', {}, fold('left', '☰'), ...bar, fold('right', '☷')), make('div', { className: 'main' }, sides.left, stage, sides.right));
  return () => { if (sides.right.hidden) setters.right(false); };
}
