/** Questions to the server: the key, answers, and what is wrong in the server's own words. */
import { Emitter } from './emitter';

const KEY = 'percept-key';

/** What the server says is wrong. */
export class Problem extends Error {
  constructor(readonly status: number, readonly reason: string, detail: string) { super(detail); }
}

/** `key`: one is asked for. `down`: nobody answers. */
export type Link = 'up' | 'down' | 'key';

class Connection extends Emitter<{ link: Link }> {
  link: Link = 'up';
  become(link: Link): void {
    if (link === this.link) return;
    this.link = link;
    this.tell('link', link);
  }
}
export const connection = new Connection();

export const hasKey = (): boolean => sessionStorage.getItem(KEY) !== null;

/** Takes a key, which stays in this tab; says what is wrong with it, if anything. */
export function useKey(key: string): string | null {
  // No header can hold another, and no request would be made that could ask again.
  if (!/^[!-~]+$/.test(key)) return 'a key is one word of plain letters; copy it whole';
  sessionStorage.setItem(KEY, key);
  connection.become('up');
  return null;
}

/** One request with the key. */
export async function ask(path: string, options: RequestInit = {}): Promise<Response> {
  const headers = new Headers(options.headers);
  const key = sessionStorage.getItem(KEY);
  if (key) headers.set('authorization', `Bearer ${key}`);
  let answer: Response;
  try {
    answer = await fetch(path, { ...options, headers });
  } catch (e) {
    if (!options.signal?.aborted) connection.become('down');
    throw e;
  }
  if (answer.status === 401) connection.become('key');
  else if (answer.status !== 502 && answer.status !== 504) connection.become('up');
  if (!answer.ok) throw await problem(path, answer);
  return answer;
}

async function problem(path: string, answer: Response): Promise<Problem> {
  const body: unknown = await answer.json().catch(() => null);
  const text = (name: string): string =>
    typeof body === 'object' && body !== null && name in body ? String((body as Record<string, unknown>)[name]) : '';
  return new Problem(answer.status, text('reason'), text('detail') || `${path}: ${answer.status}`);
}

/** A message in JSON. */
export async function read<T>(path: string, signal?: AbortSignal): Promise<T> {
  return await (await ask(path, { signal, headers: { accept: 'application/json' } })).json() as T;
}

/** A large message as protobuf: half the bytes of JSON, and no text to take apart. */
export async function readBytes(path: string, signal?: AbortSignal): Promise<Uint8Array> {
  const answer = await ask(path, { signal, headers: { accept: 'application/x-protobuf' } });
  return new Uint8Array(await answer.arrayBuffer());
}

/** Sends a message and reads the answer. */
export async function send<T>(method: 'POST' | 'PATCH', path: string, body: unknown): Promise<T> {
  const headers = { 'content-type': 'application/json', accept: 'application/json' };
  return await (await ask(path, { method, headers, body: JSON.stringify(body) })).json() as T;
}

export const of = (session: string, what = ''): string => `/v1/sessions/${encodeURIComponent(session)}${what}`;

/** A query of what is set. */
export function query(values: Record<string, string | number | boolean | undefined>): string {
  const pairs = Object.entries(values).filter(([, value]) => value !== undefined);
  return pairs.length ? '?' + pairs.map(([name, value]) => `${name}=${encodeURIComponent(String(value))}`).join('&') : '';
}

/** All pages of a list. */
export async function readAll<T>(path: string, field: string, signal?: AbortSignal): Promise<T[]> {
  const all: T[] = [];
  for (let token = ''; ;) {
    const sign = path.includes('?') ? '&' : '?';
    const page = await read<Record<string, T[] | string>>(
      `${path}${sign}page_size=1000${token && `&page_token=${encodeURIComponent(token)}`}`, signal);
    all.push(...(page[field] as T[] | undefined ?? []));
    token = page.next_page_token as string;
    if (!token) return all;
  }
}

export const wordsOf = (e: unknown): string => {
  if (e instanceof Problem) return e.message;
  return e instanceof TypeError ? 'the server does not answer' : e instanceof Error ? e.message : String(e);
};
