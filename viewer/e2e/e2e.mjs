// The viewer in a real browser: npm run e2e. PERCEPT_BIN names the server, E2E_BROWSER the browser, E2E_DATA a data
// directory with a session named demo (else a simulated robot makes one), E2E_PICTURES a folder for pictures.
import { join } from 'node:path';
import { browserPath, PAGE_PORT, Server, serverPath, servePage, until } from './world.mjs';

const skip = why => { console.log(`skipped: ${why}`); process.exit(0); };
const puppeteer = await import('puppeteer-core').then(m => m.default).catch(() => skip('puppeteer-core is absent; npm ci in viewer/e2e'));
const browserAt = browserPath() ?? skip('no Chromium or Chrome is found; E2E_BROWSER names one');
const program = serverPath() ?? skip('no server is built; cargo build --release, or PERCEPT_BIN names one');

const server = new Server(program);
await server.start();
await server.fill();
const dev = await servePage();
const browser = await puppeteer.launch({
  executablePath: browserAt, defaultViewport: { width: 1400, height: 860 },
  args: ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist'],
});
const page = await browser.newPage();
const wrong = [];
page.on('pageerror', e => wrong.push(`thrown: ${e.message}`));
// The browser itself reports each request that meets no server; no page can keep it from that.
page.on('console', m => { if (['error', 'warn'].includes(m.type()) && !/ERR_|502/.test(m.text())) wrong.push(`${m.type()}: ${m.text()}`); });

const count = selector => page.$$eval(selector, all => all.length);
const text = selector => page.$eval(selector, e => e.textContent);
const tab = name => page.click(`[data-tab="${name}"]`);
const press = (selector, words) => page.$$eval(selector, (all, w) => all.find(e => e.textContent === w).click(), words);
const points = () => page.evaluate(() => window.perceptViewer.frame.points);
/** Where a place of the map is on the page. */
const at = (x, y) => page.evaluate((x, y) => {
  const { stage, chosen } = window.perceptViewer.viewer;
  const place = stage.controls.target.clone().set(x, y, chosen.floor);
  const on = stage.screen(chosen.group.localToWorld(place)), canvas = stage.renderer.domElement.getBoundingClientRect();
  return { x: on.x + canvas.left, y: on.y + canvas.top };
}, x, y);
const clickAt = async (x, y) => { const p = await at(x, y); await page.mouse.click(p.x, p.y); };
const rest = () => new Promise(done => setTimeout(done, 1200));

let failed = 0;
async function test(name, body) {
  try {
    await body();
    console.log(`ok      ${name}`);
  } catch (e) {
    failed++;
    console.log(`FAILED  ${name}: ${e.message}`);
  }
  if (process.env.E2E_PICTURES) await page.screenshot({ path: join(process.env.E2E_PICTURES, `${name.replaceAll(' ', '-')}.png`) });
}
const check = (condition, what) => { if (!condition) throw new Error(what); };

await page.goto(`http://127.0.0.1:${PAGE_PORT}/#demo`);

await test('points come', async () => {
  await until('points are drawn', async () => await points() > 5000);
  await until('a room has a name', async () => await count('.label.room') > 0);
  const ms = await page.evaluate(() => window.perceptViewer.viewer.firstPicture_ms);
  console.log(`        first picture after ${ms.toFixed(0)} ms; ${await text('.stats')}`);
  await rest();
});

await test('layers switch', async () => {
  const before = await points();
  await page.click('input[name=points]');
  await until('points are gone', async () => await points() < before / 2);
  await page.click('input[name=points]');
  await until('points are back', async () => await points() >= before / 2);
  for (const by of await page.$$eval('select[aria-label="colour by"] option', all => all.map(o => o.value))) await page.select('select[aria-label="colour by"]', by);
});

await test('a path is planned', async () => {
  await page.click('header [title="click on the floor for a path"]');
  const goal = await page.evaluate(() => {
    const way = window.perceptViewer.viewer.chosen.data.trajectory;
    return way[Math.floor(way.length * 0.4)].t_map_base.translation;
  });
  await clickAt(goal.x, goal.y);
  await until('there is a path', () => page.$('.plan[data-outcome=path]'));
  check(/ m in /.test(await text('.plan')), `length and time: ${await text('.plan')}`);
});

await test('no path has a reason', async () => {
  // In the middle of a shelf.
  const goal = await page.evaluate(() => [...window.perceptViewer.viewer.chosen.data.things.values()].find(t => t.label === 'shelf').box.t_frame_box.translation);
  await clickAt(goal.x, goal.y);
  await until('there is none', () => page.$('.plan[data-outcome=none]'));
  check(/No path: .+/.test(await text('.plan')), await text('.plan'));
  await page.keyboard.press('Escape');
});

await test('a loop is vetoed and taken back', async () => {
  await tab('Loops');
  const id = await until('there are loops', () => page.$$eval('[data-loop]', rows => rows.find(r => r.textContent.includes('active'))?.dataset.loop));
  const row = `[data-loop="${id}"]`;
  await page.$eval(`${row} > button:last-child`, b => b.click());
  await until('it is vetoed', async () => /vetoed/.test(await text(row)));
  await until('it can be undone', () => page.$$eval('.notice button', all => all.some(b => b.textContent === 'Undo')));
  await press('.notice button', 'Undo');
  await until('it is back', async () => /active|pending/.test(await text(row)));
});

await test('the slider goes back in time', async () => {
  const keyframes = () => page.evaluate(() => window.perceptViewer.viewer.chosen.keyframes.shown.length);
  const all = await keyframes();
  await page.$eval('.timeline input', e => { e.value = '0.3'; e.dispatchEvent(new Event('input')); });
  await until('fewer keyframes', async () => { const n = await keyframes(); return n > 0 && n < all * 0.7; });
  await press('.timeline button', 'live');
  await until('all keyframes', async () => await keyframes() === all);
});

await test('a thing is chosen', async () => {
  await tab('Things');
  await until('there are things', () => page.$('.tab:not([hidden]) .row'));
  await page.$eval('.tab:not([hidden]) .row', e => e.click());
  await until('it is told in full', () => page.$('.detail .facts'));
  await tab('Graph');
  await until('there are relations', () => page.$('.tab:not([hidden]) .row'));
  await press('header button', 'Top');
  await rest();
});

await test('a zone is drawn and taken back', async () => {
  await tab('Zones');
  const zones = () => page.evaluate(() => window.perceptViewer.viewer.chosen.data.session.zones.length);
  const before = await zones();
  await press('.tab:not([hidden]) button', 'Draw a zone');
  for (const [x, y] of [[-0.5, 0.5], [0.5, 0.5], [0.5, 1.5], [-0.5, 1.5]]) await clickAt(x, y);
  await press('.tab:not([hidden]) button', 'Keep it');
  await until('it is kept', async () => await zones() === before + 1);
  await until('it can be undone', () => page.$$eval('.notice button', all => all.some(b => b.textContent === 'Undo')));
  await page.$$eval('.notice button', all => all.findLast(b => b.textContent === 'Undo').click());
  await until('it is taken back', async () => await zones() === before);
});

await test('the server restarts', async () => {
  await server.stop();
  await until('the page says so', async () => /No connection/.test(await text('.notices')));
  await server.start();
  await until('it is found again', () => page.$eval('.notice', e => e.hidden), 30_000);
  check(await points() > 5000, 'points are still there');
  await until('events come again', async () => (await page.evaluate(() => window.perceptViewer.viewer.chosen.data.session !== null)));
});

if (wrong.length) { failed++; console.log(`FAILED  the console is clean:\n  ${[...new Set(wrong)].join('\n  ')}`); }
await browser.close();
dev.kill();
await server.stop();
process.exit(failed ? 1 : 0);
