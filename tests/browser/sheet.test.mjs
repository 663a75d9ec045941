// The pages of `evaluate` and `benchmark` in a real browser. Run by scripts/test-report.sh, which makes
// them: REPORTS/evaluation.html of one scene, four scans of which one was moved away, and
// REPORTS/suite/report.html of a suite that is half computed; both with hostile names.
import assert from 'node:assert/strict';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { launch, open } from './browser.mjs';

const evaluation = join(process.env.REPORTS, 'evaluation.html');
const suite = join(process.env.REPORTS, 'suite/report.html');

let browser;
before(async () => { browser = await launch(); });
after(() => browser.close());

test('an evaluation loads without an error or a request, and tells what went wrong first', async () => {
  const { page, problems } = await open(browser, evaluation);
  assert.match(await page.locator('h1').textContent(), /^Registration recall [\d.]+ % on 3dmatch; 4 of 4 scans placed\.$/);
  const titles = await page.locator('h2').allTextContents();
  assert.deepEqual(titles, ['Figures', 'Scenes', 'Errors of the poses', '<img src=x onerror=window.hacked=3>']);
  assert.equal(await page.locator('figure svg').count(), 2);
  const first = page.locator('section').last().locator('table').first();
  assert.match(await first.locator('tbody tr').first().textContent(), /^cloud_bin_\dmoved by refinement.*joined to cloud_bin_\d by \d+ of \d+ matches/);
  await page.locator('summary', { hasText: 'Every scan' }).click();
  const verdicts = page.locator('details table').last().locator('tbody td:nth-child(3)');
  assert.deepEqual((await verdicts.allTextContents()).sort(), ['moved by refinement', 'right', 'right', 'right']);
  assert.deepEqual(problems, []);
  await page.close();
});

test('a suite shows tables, plots, quoted rows as quoted, and what is missing', async () => {
  const { page, problems } = await open(browser, suite);
  assert.equal(await page.locator('h1').textContent(), '</title><script>window.hacked=4</script>');
  assert.match(await page.locator('#note').textContent(), /^Not finished: 2 of 4 cells/);
  const quoted = page.locator('tr.quoted');
  assert.equal(await quoted.count(), 2);
  assert.match(await quoted.first().textContent(), /theirs: quoted, Somebody 1999 <!--body-->/);
  assert.equal(await quoted.first().locator('td').first().evaluate((e) => getComputedStyle(e).fontStyle), 'italic');
  const captions = await page.locator('figcaption').allTextContents();
  for (const plot of ['recall_by_keypoints.svg', 'cost.svg', 'reliability_']) {
    assert.ok(captions.some((c) => c.includes(plot)), `${plot} is missing in ${captions}`);
  }
  assert.equal(await page.locator('figure svg').count(), captions.length);
  const fold = page.locator('details', { hasText: '2 missing or out-of-date cells' });
  await fold.locator('summary').click();
  assert.equal(await fold.locator('tbody tr').count(), 2);
  assert.deepEqual(problems, []);
  await page.close();
});

test('a click or a key on a head sorts its table', async () => {
  const { page } = await open(browser, suite);
  const table = page.locator('table').first();
  const head = table.getByRole('columnheader', { name: 'recall', exact: true });
  const column = await head.evaluate((th) => th.cellIndex);
  const values = () => table.locator('tbody tr').evaluateAll((rows, c) => rows.map((r) => r.cells[c].textContent), column);
  assert.ok((await values()).includes('99.5'));
  const numbers = async () => (await values()).map(Number.parseFloat).filter((v) => !Number.isNaN(v));
  await head.getByRole('button').click();
  assert.equal(await head.getAttribute('aria-sort'), 'ascending');
  const up = await numbers();
  assert.deepEqual(up, [...up].sort((a, b) => a - b));
  assert.ok(up.length >= 3 && up[0] <= 12.5);
  await head.getByRole('button').focus();
  await page.keyboard.press('Enter');
  assert.equal(await head.getAttribute('aria-sort'), 'descending');
  assert.deepEqual(await numbers(), [...up].reverse());
  await page.close();
});

test('dark and light follow the system and the button, and every control has a name', async () => {
  const ground = (page) => page.evaluate(() => getComputedStyle(document.body).backgroundColor);
  const { page } = await open(browser, evaluation, { colorScheme: 'dark' });
  const dark = await ground(page);
  await page.locator('#theme').click();
  assert.notEqual(await ground(page), dark);
  await page.keyboard.press('Shift+Tab');
  assert.equal(await page.evaluate(() => document.activeElement.textContent), 'Skip to the figures');
  const nameless = await page.locator('button, summary, [tabindex="0"]').evaluateAll((all) => all
    .filter((e) => !(e.getAttribute('aria-label') || e.textContent.trim())).map((e) => e.outerHTML.slice(0, 120)));
  assert.deepEqual(nameless, []);
  await page.close();
});

test('on a phone nothing sticks out', async () => {
  for (const file of [evaluation, suite]) {
    const { page, problems } = await open(browser, file, { width: 390, height: 844, hasTouch: true, isMobile: true });
    for (const fold of await page.locator('summary').all()) await fold.tap();
    assert.equal(await page.evaluate(() => document.documentElement.scrollWidth), 390);
    // Wide tables and plots scroll by themselves.
    assert.ok((await page.locator('.scroll').evaluateAll((all) => all.filter((e) => e.scrollWidth > e.clientWidth).length)) > 0);
    assert.deepEqual(problems, []);
    await page.close();
  }
});

test('hostile names are shown as text and never run, and nothing is lost without JavaScript', async () => {
  for (const file of [evaluation, suite]) {
    const { page, problems } = await open(browser, file);
    assert.equal(await page.evaluate(() => window.hacked), undefined);
    assert.equal(await page.locator('img, iframe, b').count(), 0);
    assert.equal(await page.locator('script').count(), 1);
    const rows = await page.locator('tbody tr').count();
    assert.deepEqual(problems, []);
    await page.close();
    const context = await browser.newContext({ javaScriptEnabled: false });
    const plain = await context.newPage();
    await plain.goto(`file://${file}`);
    assert.equal(await plain.locator('tbody tr').count(), rows);
    await context.close();
  }
});
