/** Elements by code. All text goes in as text. */

type Child = Node | string;
type Attributes<K extends keyof HTMLElementTagNameMap> =
  Partial<Omit<HTMLElementTagNameMap[K], 'style' | 'dataset'>> & { data?: Record<string, string>; aria?: Record<string, string> };

export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K, attributes: Attributes<K> = {}, ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  const { data, aria, ...properties } = attributes;
  Object.assign(element, properties);
  for (const [name, value] of Object.entries(data ?? {})) element.dataset[name] = value;
  for (const [name, value] of Object.entries(aria ?? {})) element.setAttribute(`aria-${name}`, value);
  element.append(...children);
  return element;
}

/** Rows of a name and a value. */
export const facts = (rows: [string, Child][]): HTMLTableElement => make('table', { className: 'facts' },
  ...rows.map(([name, value]) => make('tr', {}, make('th', {}, name), make('td', {}, value))));

/** A button that says what it does. */
export const button = (text: string, title: string, onclick: () => void, className = ''): HTMLButtonElement =>
  make('button', { type: 'button', title, onclick, className }, text);

/** A small square of a colour. */
export function swatch(colour: string): HTMLSpanElement {
  const element = make('span', { className: 'swatch' });
  element.style.background = colour;
  return element;
}

/** Puts new children in only if what is shown differs: a list that is rebuilt under the pointer cannot be clicked. */
export function show(parent: HTMLElement, key: string, children: () => Child[]): void {
  if (parent.dataset.shown === key) return;
  parent.dataset.shown = key;
  parent.replaceChildren(...children());
}

/** Does something that is asked for with every frame, a few times a second. */
export function seldom(what: () => void, ms = 250): () => void {
  let timer = 0;
  return () => { timer ||= window.setTimeout(() => { timer = 0; what(); }, ms); };
}
