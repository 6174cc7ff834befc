// Bundles the viewer into one page that loads nothing: dist/index.html.
import { build } from 'esbuild';
import { mkdir, readFile, writeFile } from 'node:fs/promises';
import { fileURLToPath, pathToFileURL } from 'node:url';

const here = name => fileURLToPath(new URL(name, import.meta.url));

const bundled = (entry, loader) => build({
  entryPoints: [here(entry)],
  bundle: true,
  minify: true,
  write: false,
  format: 'iife',
  target: 'es2022',
  charset: 'utf8',
  legalComments: 'inline',
  logLevel: 'warning',
  loader,
}).then(result => result.outputFiles[0].text);

/** The page as text. */
export async function page() {
  const [html, script, style] = await Promise.all([
    readFile(here('index.html'), 'utf8'), bundled('src/main.ts', {}), bundled('src/style.css', {}),
  ]);
  // The browser's parser ends a script at these letters, wherever they stand.
  const inline = script.replace(/<\/(script)/gi, '<\\/$1').replace(/<!--/g, '<\\!--');
  // By functions: `$&` in a bundle would mean something in a replacement.
  return html
    .replace('<!-- style -->', () => `<style>${style}</style>`)
    .replace('<!-- script -->', () => `<script>${inline}</script>`);
}

if (import.meta.url === pathToFileURL(process.argv[1]).href) {
  const text = await page();
  await mkdir(here('dist'), { recursive: true });
  await writeFile(here('dist/index.html'), text);
  console.log(`dist/index.html: ${(text.length / 1024).toFixed(0)} KiB`);
}
