// What the test stands on: a browser, a server with data, the page before it.
import { spawn, spawnSync } from 'node:child_process';
import { existsSync, mkdtempSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { fileURLToPath } from 'node:url';

const here = name => fileURLToPath(new URL(name, import.meta.url));
const BROWSERS = ['chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable'];
export const GRPC = '127.0.0.1:57051', REST = '127.0.0.1:57080', PAGE_PORT = 57173;

/** A browser of this machine: E2E_BROWSER, or the first of the usual names. */
export function browserPath() {
  if (process.env.E2E_BROWSER) return process.env.E2E_BROWSER;
  const folders = (process.env.PATH ?? '').split(':');
  return BROWSERS.flatMap(name => folders.map(folder => join(folder, name))).find(existsSync);
}

/** The server's program: PERCEPT_BIN, or what cargo built. */
export function serverPath() {
  return [process.env.PERCEPT_BIN, here('../../target/release/percept')].find(path => path && existsSync(path));
}

// The server refuses variables of this prefix that it does not know.
const env = Object.fromEntries(Object.entries(process.env).filter(([name]) => !name.startsWith('PERCEPT_')));

/** The server over one data directory, which can be stopped and started again. */
export class Server {
  constructor(program) {
    this.program = program;
    this.data = process.env.E2E_DATA ?? mkdtempSync(join(tmpdir(), 'percept-e2e-'));
  }

  async start() {
    this.process = spawn(this.program, ['serve', '--data-dir', this.data, '--grpc', GRPC, '--rest', REST, '--zenoh', ''], { stdio: 'ignore', env });
    await until('the server is ready', async () => (await fetch(`http://${REST}/readyz`).catch(() => null))?.ok, 60_000);
  }

  async stop() {
    const ended = new Promise(done => this.process.once('exit', done));
    this.process.kill('SIGTERM');
    await ended;
  }

  /** Two rooms by a simulated robot, once. */
  async fill() {
    const known = await (await fetch(`http://${REST}/v1/sessions`)).json();
    if (known.sessions.some(s => s.session_id === 'demo')) return;
    const sim = spawnSync(this.program, ['sim', '--server', `http://${GRPC}`, '--session', 'demo', '--rooms', '2'], { encoding: 'utf8', env });
    if (sim.status !== 0) throw new Error(`percept sim: ${sim.stderr}`);
  }
}

/** The page as npm run dev serves it, with the server behind. */
export async function servePage() {
  const dev = spawn('node', [here('../dev.mjs'), `http://${REST}`, String(PAGE_PORT)], { stdio: ['ignore', 'pipe', 'inherit'] });
  await new Promise(done => dev.stdout.once('data', done));
  return dev;
}

/** Waits for a condition; the test fails if it does not come. */
export async function until(what, condition, ms = 20_000) {
  for (const end = Date.now() + ms; Date.now() < end;) {
    const value = await condition();
    if (value) return value;
    await new Promise(done => setTimeout(done, 100));
  }
  throw new Error(`not within ${ms / 1000} s: ${what}`);
}
