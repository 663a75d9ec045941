// Builds the pages of src/report from src/: everything inline, with the hashes that the policy needs.
import { createHash } from 'node:crypto';
import { readFileSync, writeFileSync } from 'node:fs';
import { dirname, join } from 'node:path';
import { fileURLToPath } from 'node:url';
import { build } from 'esbuild';

const here = dirname(fileURLToPath(import.meta.url));
const folder = process.argv[2] ?? join(here, '../../src/report');
const read = (path) => readFileSync(join(here, path), 'utf8');

const styled = await build({ entryPoints: [join(here, 'src/style.css')], minify: true, write: false });
const style = styled.outputFiles[0].text.trim();

async function page(template, entry, more, output) {
  const bundled = await build({
    entryPoints: [join(here, 'src', entry)], bundle: true, minify: true, write: false, format: 'iife',
    target: 'es2022', legalComments: 'none', charset: 'ascii',
  });
  const script = bundled.outputFiles[0].text.trim();
  // Inside an element of a page these would end it or change how it is read.
  for (const text of [script, style]) {
    if (/<\/(script|style)|<!--/i.test(text)) throw new Error('the bundle holds text that a page cannot');
  }
  const hash = (text) => createHash('sha256').update(text).digest('base64');
  const values = {
    'sha256-SCRIPT': `sha256-${hash(script)}`,
    'sha256-STYLE': `sha256-${hash(style)}`,
    '<style>STYLE</style>': `<style>${style}</style>`,
    '<script>SCRIPT</script>': `<script>${script}</script>`,
    ...more,
  };
  let text = read(join('src', template));
  for (const [mark, value] of Object.entries(values)) {
    if (text.split(mark).length !== 2) throw new Error(`${mark} must stand once in ${template}`);
    text = text.replace(mark, () => value);
  }
  writeFileSync(join(folder, output), text);
  console.log(`${join(folder, output)}: ${(text.length / 1000).toFixed(0)} kB`);
}

const three = read('node_modules/three/LICENSE').trim();
await page('page.html', 'main.js', { 'THREE-LICENCE': three }, 'html/page.html');
await page('sheet.html', 'sheet.js', {}, 'sheet/page.html');
