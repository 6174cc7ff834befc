/** The list of sessions, which of them are shown, and the two streams that tell what changes. */
import { connection, query, readAll, wordsOf } from '../api';
import { Emitter } from '../emitter';
import { watch } from '../events';
import type { FleetEvent, Session } from '../types';
import { SessionData } from './session';

/** The longest pattern that all ids fit. */
export function pattern(ids: string[]): string {
  if (ids.length < 2) return ids[0] ?? '';
  let common = ids[0]!;
  for (const id of ids) while (!id.startsWith(common)) common = common.slice(0, -1);
  return common + '*';
}

/** So long is waited for a stream to begin. */
const LATE_MS = 700;

type Changes = { list: void; chosen: void; problem: string };

export class Fleet extends Emitter<Changes> {
  list: Session[] = [];
  chosen: SessionData[] = [];
  private lives: AbortController | null = null;
  private events: AbortController | null = null;
  private listing = false;
  private again = 0;

  constructor() {
    super();
    let was = connection.link;
    connection.on('link', link => {
      if (link === 'up' && was === 'key') this.begin();
      was = link;
    });
    addEventListener('hashchange', () => this.choose(this.wanted()));
  }

  /** Ids in the address. */
  wanted(): string[] {
    try {
      return location.hash.slice(1).split(',').map(decodeURIComponent).filter(id => id);
    } catch { return []; }
  }

  begin(): void {
    this.lives?.abort();
    this.lives = new AbortController();
    void watch<FleetEvent>('/v1/events' + query({ kinds: 'life' }), this.lives.signal, () => this.refreshSoon(), () => this.refreshSoon(0));
    this.refreshSoon(0);
    // What the address names is shown at once; what of it is not there goes with the list.
    if (this.chosen.length) this.follow(); else this.choose(this.wanted());
  }

  /** Many sessions come and go at once: the list is read when that is over. */
  private refreshSoon(ms = 300): void {
    clearTimeout(this.again);
    this.again = window.setTimeout(() => void this.refresh(), ms);
  }

  async refresh(): Promise<void> {
    if (this.listing) return;
    this.listing = true;
    try {
      this.list = await readAll<Session>('/v1/sessions', 'sessions');
      this.tell('list', undefined);
      const there = new Set(this.list.map(s => s.session_id));
      const kept = this.chosen.filter(s => there.has(s.id)).map(s => s.id);
      const wanted = this.wanted().filter(id => there.has(id));
      const last = this.list.reduce<Session | null>((a, b) => a && BigInt(a.last_used_ns) > BigInt(b.last_used_ns) ? a : b, null)?.session_id;
      const next = kept.length ? kept : wanted.length ? wanted : last ? [last] : [];
      if (next.join() !== this.chosen.map(s => s.id).join()) this.choose(next);
    } catch (e) { this.tell('problem', wordsOf(e)); }
    this.listing = false;
  }

  /** Shows exactly these. */
  choose(ids: string[]): void {
    if (ids.join() === this.chosen.map(s => s.id).join()) return;
    const known = new Map(this.chosen.map(s => [s.id, s]));
    for (const [id, data] of known) if (!ids.includes(id)) data.dispose();
    this.chosen = ids.map(id => {
      const old = known.get(id);
      if (old) return old;
      const data = new SessionData(id);
      data.on('problem', text => this.tell('problem', text));
      return data;
    });
    history.replaceState(null, '', '#' + ids.map(encodeURIComponent).join(','));
    this.tell('chosen', undefined);
    this.follow();
  }

  toggle(id: string): void {
    const ids = this.chosen.map(s => s.id);
    this.choose(ids.includes(id) ? ids.filter(other => other !== id) : [...ids, id]);
  }

  /** One stream for all that are shown: a browser opens six connections to a server, and no more. */
  private follow(): void {
    this.events?.abort();
    if (!this.chosen.length) return;
    this.events = new AbortController();
    const path = '/v1/events' + query({ session_pattern: pattern(this.chosen.map(s => s.id)) });
    const each = (event: FleetEvent): void => {
      for (const data of this.chosen) if (!event.session_id || data.id === event.session_id) data.take(event);
    };
    // Read once the stream has begun: what happens between reading and watching would be missed. A proxy may hold the stream back.
    const load = (): void => {
      clearTimeout(late);
      for (const data of this.chosen) { void data.load(); data.tell('map', ''); }
    };
    const late = window.setTimeout(load, LATE_MS);
    this.events.signal.addEventListener('abort', () => clearTimeout(late));
    void watch<FleetEvent>(path, this.events.signal, each, load);
  }
}
