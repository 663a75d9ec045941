// A browser with a page in it, and what its pictures hold.
import { pathToFileURL } from 'node:url';
import { inflateSync } from 'node:zlib';
import { chromium } from 'playwright-core';

// Drawing without a graphics chip, so that the tests run anywhere.
const SOFTWARE = ['--no-sandbox', '--use-angle=swiftshader', '--enable-unsafe-swiftshader'];

export function launch(more = []) {
  return chromium.launch({ executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium', args: [...SOFTWARE, ...more] });
}

/** Opens a report; `problems` collects errors, warnings, dialogs and requests to elsewhere. */
export async function open(browser, file, { width = 1280, height = 900, ...more } = {}) {
  const page = await browser.newPage({ viewport: { width, height }, ...more });
  const problems = [];
  page.on('console', (m) => {
    // Said by the software renderer itself about reading pixels back.
    if (['error', 'warning'].includes(m.type()) && !m.text().includes('GPU stall')) problems.push(m.text());
  });
  page.on('pageerror', (e) => problems.push(e.message));
  page.on('dialog', (d) => { problems.push(`dialog ${d.message()}`); d.dismiss(); });
  const url = pathToFileURL(file).href;
  page.on('request', (r) => r.url() !== url && problems.push(`request ${r.url()}`));
  await page.goto(url);
  await page.waitForFunction(() => window.scanweave?.ready);
  await drawn(page);
  return { page, problems };
}

/** Waits until what was asked for is on the screen. */
export async function drawn(page) {
  await page.waitForFunction(() => window.scanweave.settled());
  await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 100)))));
}

/** The view as the screen shows it: one number, 0xrrggbb, a pixel. */
export async function pixels(page) {
  await drawn(page);
  return decoded(await page.locator('#canvas').screenshot());
}

/** Pixels of a PNG of 8-bit RGB or RGBA (PNG specification, second edition, 9: filtering). */
function decoded(png) {
  const [width, height, channels] = [png.readUInt32BE(16), png.readUInt32BE(20), png[25] === 6 ? 4 : 3];
  const parts = [];
  for (let at = 8; at < png.length; at += 12 + png.readUInt32BE(at)) {
    if (png.toString('latin1', at + 4, at + 8) === 'IDAT') parts.push(png.subarray(at + 8, at + 8 + png.readUInt32BE(at)));
  }
  const data = inflateSync(Buffer.concat(parts));
  const row = width * channels;
  const [line, out] = [new Uint8Array(row), new Uint32Array(width * height)];
  const above = new Uint8Array(row);
  for (let y = 0; y < height; y++) {
    const filter = data[y * (row + 1)];
    for (let x = 0; x < row; x++) {
      const [left, corner] = x < channels ? [0, 0] : [line[x - channels], above[x - channels]];
      line[x] = data[y * (row + 1) + 1 + x] + [0, left, above[x], (left + above[x]) >> 1, paeth(left, above[x], corner)][filter];
    }
    for (let x = 0; x < width; x++) out[y * width + x] = (line[x * channels] << 16) | (line[x * channels + 1] << 8) | line[x * channels + 2];
    above.set(line);
  }
  return out;
}

function paeth(a, b, c) {
  const [pa, pb, pc] = [Math.abs(b - c), Math.abs(a - c), Math.abs(a + b - 2 * c)];
  return pa <= pb && pa <= pc ? a : pb <= pc ? b : c;
}

/** Colour of most pixels along the edges of the view: its ground. */
export function groundOf(picture) {
  const count = new Map();
  for (const p of picture.subarray(0, picture.length / 20)) count.set(p, (count.get(p) ?? 0) + 1);
  return [...count].sort((a, b) => b[1] - a[1])[0][0];
}

/** Share of pixels that are not the ground. */
export function covered(picture, ground = groundOf(picture)) {
  return picture.filter((p) => p !== ground).length / picture.length;
}

/** Share of pixels that differ by more than rounding would. */
export function difference(a, b) {
  const far = (p, q) => [16, 8, 0].some((s) => Math.abs(((p >> s) & 255) - ((q >> s) & 255)) > 12);
  return a.length === b.length ? a.filter((p, i) => far(p, b[i])).length / a.length : 1;
}
