// Size, load time and frame rate of reports: node scripts/report-figures.mjs PAGE... after
// `npm ci` in tests/browser. Draws without a graphics chip, so frame rates are a lower bound.
import { statSync } from 'node:fs';
import { resolve } from 'node:path';
import { launch, open } from '../tests/browser/browser.mjs';

const FRAMES = 40;
const median = (values) => [...values].sort((a, b) => a - b)[Math.floor(values.length / 2)];

const browser = await launch();
console.log('| report | size | scans | points shown | loaded and drawn | one frame, all points | while turning |');
console.log('| --- | ---: | ---: | ---: | ---: | ---: | ---: |');
for (const file of process.argv.slice(2)) {
  const start = performance.now();
  const { page, problems } = await open(browser, resolve(file));
  const loaded = performance.now() - start;
  const times = await page.evaluate((n) => window.scanweave.turn(n), FRAMES);
  const points = await page.locator('#shown').textContent();
  const scans = await page.locator('#scans li').count();
  // Once to let the view find out how many points it can draw while it is turned, once to count.
  await page.evaluate(() => window.scanweave.spin(2500));
  const turning = await page.evaluate(() => window.scanweave.spin(3000));
  if (problems.length) console.log(problems.join('\n'));
  const size = (statSync(file).size / 1e6).toFixed(1);
  console.log(`| ${file} | ${size} MB | ${scans} | ${points.match(/, ([\d,]+) point/)[1]} | ${(loaded / 1000).toFixed(1)} s | ${median(times).toFixed(0)} ms | ${turning.toFixed(0)} frames/s |`);
  await page.close();
}
await browser.close();
