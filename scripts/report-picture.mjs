// Picture of a report for the README: node scripts/report-picture.mjs PAGE PNG.
// scripts/update-demo-picture.sh calls it.
import { resolve } from 'node:path';
import { drawn, launch, open } from '../tests/browser/browser.mjs';

const [report, picture] = process.argv.slice(2);
const browser = await launch();
const { page, problems } = await open(browser, resolve(report), { width: 1200, height: 800, colorScheme: 'light' });
await drawn(page);
await page.screenshot({ path: picture });
await browser.close();
if (problems.length) throw new Error(problems.join('\n'));
