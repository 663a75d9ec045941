// Builds src/report/html/page.html: everything inline, with the hashes that the policy needs.
import { createHash } from 'node:crypto';
import { readFileSync, writeFileSync } from 'node:fs';
import { dirname, join } from 'node:path';
import { fileURLToPath } from 'node:url';
import { build } from 'esbuild';

const here = dirname(fileURLToPath(import.meta.url));
const output = process.argv[2] ?? join(here, '../../src/report/html/page.html');
const read = (path) => readFileSync(join(here, path), 'utf8');

const bundled = await build({
  entryPoints: [join(here, 'src/main.js')], bundle: true, minify: true, write: false, format: 'iife',
  target: 'es2022', legalComments: 'none', charset: 'ascii',
});
const styled = await build({ entryPoints: [join(here, 'src/style.css')], minify: true, write: false });
const script = bundled.outputFiles[0].text.trim();
const style = styled.outputFiles[0].text.trim();
// Inside an element of a page these would end it or change how it is read.
for (const text of [script, style]) {
  if (/<\/(script|style)|<!--/i.test(text)) throw new Error('the bundle holds text that a page cannot');
}
const hash = (text) => createHash('sha256').update(text).digest('base64');
const values = {
  'sha256-SCRIPT': `sha256-${hash(script)}`,
  'sha256-STYLE': `sha256-${hash(style)}`,
  'THREE-LICENCE': read('node_modules/three/LICENSE').trim(),
  '<style>STYLE</style>': `<style>${style}</style>`,
  '<script>SCRIPT</script>': `<script>${script}</script>`,
};
let page = read('src/page.html');
for (const [mark, value] of Object.entries(values)) {
  if (page.split(mark).length !== 2) throw new Error(`${mark} must stand once in page.html`);
  page = page.replace(mark, () => value);
}
writeFileSync(output, page);
console.log(`${output}: ${(page.length / 1000).toFixed(0)} kB`);
