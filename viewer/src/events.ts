/** Server-sent events by fetch, because an event source sends no key; goes on after the last one when the connection breaks. */
import { ask, connection, Problem } from './api';

const AGAIN_MS = 2000;
/** The server sends a comment each 15 s: what is silent for longer is broken. */
const SILENCE_MS = 40_000;

const pause = (ms: number, signal: AbortSignal): Promise<void> => new Promise(done => {
  setTimeout(done, ms);
  signal.addEventListener('abort', () => done(), { once: true });
});

/** Calls `each` with every event until the signal; `begun` whenever the stream starts, first or again. */
export async function watch<T>(
  path: string, signal: AbortSignal, each: (event: T) => void, begun: (again: boolean) => void,
): Promise<void> {
  let last: string | null = null, again = false;
  while (!signal.aborted) {
    const silence = new AbortController();
    const stop = (): void => silence.abort();
    signal.addEventListener('abort', stop, { once: true });
    let timer = 0;
    try {
      const sign = path.includes('?') ? '&' : '?';
      const answer = await ask(path + (last === null ? '' : `${sign}resume_token=${last}`), { signal: silence.signal });
      begun(again);
      again = true;
      const reader = answer.body!.pipeThrough(new TextDecoderStream()).getReader();
      for (let rest = ''; ;) {
        timer = window.setTimeout(stop, SILENCE_MS);
        const part = await reader.read();
        clearTimeout(timer);
        if (part.done) break;
        const messages = (rest + part.value).split('\n\n');
        rest = messages.pop()!;
        for (const message of messages) {
          const line = (name: string): string | undefined =>
            message.split('\n').find(l => l.startsWith(name + ':'))?.slice(name.length + 1).trim();
          const data = line('data');
          if (!data || line('event')) continue;
          last = line('id') ?? last;
          each(JSON.parse(data) as T);
        }
      }
      // A server that stops ends its streams in good order, and is down nevertheless.
      if (!signal.aborted) connection.become('down');
    } catch (e) {
      if (signal.aborted) return;
      // Begun again with the next key.
      if (e instanceof Problem && e.status === 401) return;
      // A token that the server does not know any more would be refused for ever.
      if (e instanceof Problem && e.status === 400) last = null;
      if (!(e instanceof Problem)) connection.become('down');
    } finally {
      clearTimeout(timer);
      signal.removeEventListener('abort', stop);
    }
    await pause(AGAIN_MS, signal);
  }
}
