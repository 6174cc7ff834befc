/** What has to be told: no connection, a key that is needed, what went wrong, and what can be undone. */
import { connection, useKey } from '../api';
import { button, make } from '../dom';

const STAYS_MS = 9000;

export class Notices {
  readonly element = make('div', { className: 'notices', role: 'status' });
  private link = make('div', { className: 'notice bad', hidden: true });
  private last = '';

  constructor() {
    this.element.append(this.link);
    connection.on('link', link => {
      this.link.hidden = link !== 'down';
      this.link.textContent = 'No connection to the server. What is shown is as it was; it is asked again every 2 seconds.';
      if (link === 'up') this.tell('The server answers again.', 4000, 'good');
    });
  }

  tell(text: string, stays_ms = STAYS_MS, kind = ''): HTMLElement {
    const note = make('div', { className: `notice ${kind}` }, make('span', {}, text));
    note.append(button('×', 'close', () => note.remove(), 'close'));
    this.element.append(note);
    setTimeout(() => note.remove(), stays_ms);
    return note;
  }

  /** The same trouble is told once, not with every question that meets it. */
  problem(text: string): void {
    if (this.last === text || connection.link !== 'up') return;
    this.last = text;
    setTimeout(() => { this.last = ''; }, STAYS_MS);
    this.tell(text, STAYS_MS, 'bad');
  }

  /** Something was done; a button takes it back. */
  done(text: string, undo: () => void): void {
    const note = this.tell(text, 20_000, 'good');
    note.insertBefore(button('Undo', 'take it back', () => { note.remove(); undo(); }), note.lastChild);
  }
}

export function keyForm(): HTMLElement {
  const input = make('input', { type: 'password', placeholder: 'key', ariaLabel: 'key', autocomplete: 'off' });
  const wrong = make('span', { className: 'wrong' });
  const form = make('form', { className: 'key', hidden: true, onsubmit: (e: SubmitEvent) => {
    e.preventDefault();
    wrong.textContent = useKey(input.value.trim()) ?? '';
    if (!wrong.textContent) input.value = '';
  } }, make('span', {}, 'This server asks for a key.'), input, make('button', {}, 'use'), wrong);
  connection.on('link', link => { form.hidden = link !== 'key'; if (link === 'key') input.focus(); });
  return form;
}
