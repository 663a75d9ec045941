// report.html in a real browser. Run by scripts/test-report.sh, which makes the reports:
// REPORTS/plain has five scans of a room and one of elsewhere, REPORTS/hostile hostile names,
// REPORTS/two four scans of one room and three of another, REPORTS/gone the scans of plain no more.
import assert from 'node:assert/strict';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { covered, difference, drawn, groundOf, launch, open, pixels } from './browser.mjs';

const reports = process.env.REPORTS;
const plain = join(reports, 'plain/report.html');
const hostile = join(reports, 'hostile/report.html');
const points = async (page) => Number(await page.locator('#shown').getAttribute('data-points'));

let browser;
before(async () => { browser = await launch(); });
after(() => browser.close());

test('it loads without an error or a request, and says at once what came out', async () => {
  const { page, problems } = await open(browser, plain);
  assert.equal(await page.locator('h1').textContent(), '5 of 6 scans placed in one model; one was left out.');
  const lost = page.locator('#left-out li');
  assert.equal(await lost.count(), 1);
  assert.match(await lost.first().textContent(), /needed/);
  // The headline and the reason are on the first screen.
  assert.ok((await lost.first().boundingBox()).y < 500);
  assert.equal(await page.locator('#scans li').count(), 6);
  assert.equal(await page.locator('#evidence tbody tr').count(), 6);
  assert.equal(await page.locator('#tree li').count(), 5);
  assert.deepEqual(problems, []);
  await page.close();
});

test('the canvas shows the scans, and hiding one takes its pixels away', async () => {
  const { page, problems } = await open(browser, plain);
  const [all, count] = [await pixels(page), await points(page)];
  const [ground, share] = [groundOf(all), covered(all)];
  assert.ok(share > 0.05 && share < 0.95, `${share} of the canvas is covered`);
  const box = page.locator('#scans li input').first();
  await box.uncheck();
  const hidden = await pixels(page);
  assert.ok(difference(all, hidden) > 0.005, 'no pixel changed');
  assert.ok((await points(page)) < count);
  await box.check();
  assert.ok(difference(all, await pixels(page)) < 0.001, 'the scan did not come back');
  assert.equal(await points(page), count);
  await page.getByRole('button', { name: 'None' }).click();
  assert.equal(await points(page), 0);
  // All but the rounded corners.
  assert.ok(covered(await pixels(page), ground) < 0.002);
  assert.deepEqual(problems, []);
  await page.close();
});

test('a scan can be shown alone, also one that was left out', async () => {
  const { page } = await open(browser, plain);
  const all = await points(page);
  const alone = page.locator('#left-out').getByRole('button', { name: /Show alone/ });
  await alone.click();
  assert.equal(await alone.getAttribute('aria-pressed'), 'true');
  const lone = await points(page);
  assert.ok(lone > 0 && lone < all);
  assert.ok(covered(await pixels(page)) > 0.02);
  assert.match(await page.locator('#details').textContent(), /Left out/);
  await alone.click();
  assert.equal(await points(page), all);
  await page.close();
});

test('a click on a scan chooses it, a drag and a click on nothing do not', async () => {
  const { page, problems } = await open(browser, plain);
  for (const mark of ['Shading', 'Scanner positions and joins']) await page.getByLabel(mark).uncheck();
  const canvas = page.locator('#canvas');
  await canvas.scrollIntoViewIfNeeded();
  const box = await canvas.boundingBox();
  let [picture, width] = [await pixels(page), Math.round(box.width)];
  const rows = await page.locator('#scans li').evaluateAll((all) => all.filter((row) => row.querySelector('input:checked'))
    .map((row) => [row.querySelector('.name').firstChild.textContent, row.querySelector('.swatch').style.background.match(/\d+/g).map(Number)]));
  assert.equal(rows.length, 5);
  const chosen = () => page.locator('#scans li.chosen .name').evaluateAll((all) => all.map((e) => e.firstChild.textContent));
  // Where a patch of 9 by 9 pixels has the colour of one scan, the middle of it is that scan.
  const patch = (colour) => {
    const value = (colour[0] << 16) | (colour[1] << 8) | colour[2];
    for (let y = 20; y < picture.length / width - 20; y++) for (let x = 220; x < width - 20; x++) {
      let same = true;
      for (let k = 0; same && k < 81; k++) same = picture[(y + (k % 9) - 4) * width + x + Math.floor(k / 9) - 4] === value;
      if (same) return { x: box.x + x + 0.5, y: box.y + y + 0.5 };
    }
    return null;
  };
  let found = 0;
  // From several sides: what lies behind must not be chosen.
  for (let side = 0; side < 4; side++) {
    for (const [name, colour] of rows) {
      const at = patch(colour);
      if (!at) continue;
      found += 1;
      await page.mouse.click(at.x, at.y);
      assert.deepEqual(await chosen(), [name]);
      assert.equal(await page.locator('#details h2').textContent(), name);
    }
    for (let turn = 0; turn < 13; turn++) await page.keyboard.press('ArrowLeft');
    picture = await pixels(page);
  }
  assert.ok(found >= 12, `${found} patches of one scan`);
  const before = await chosen();
  const other = patch(rows.find(([name]) => name !== before[0])[1]) ?? { x: box.x + 300, y: box.y + 200 };
  await page.mouse.click(other.x, other.y, { button: 'right' });
  assert.deepEqual(await chosen(), before);
  await page.mouse.move(other.x, other.y);
  await page.mouse.down();
  await page.mouse.move(other.x + 40, other.y + 10, { steps: 4 });
  await page.mouse.up();
  assert.deepEqual(await chosen(), before);
  await page.keyboard.press('Home');
  await drawn(page);
  await page.mouse.click(box.x + box.width - 6, box.y + 12);
  assert.deepEqual(await chosen(), []);
  assert.equal(await page.locator('#details').isVisible(), false);
  assert.deepEqual(problems, []);
  await page.close();
});

test('the slider replays the growth', async () => {
  const { page } = await open(browser, plain);
  const slider = page.getByRole('slider', { name: /step of the growth/ });
  const counts = [await points(page)];
  await slider.focus();
  for (let step = 3; step >= 0; step--) {
    await page.keyboard.press('ArrowLeft');
    counts.push(await points(page));
    assert.match(await slider.getAttribute('aria-valuetext'), new RegExp(`^Step ${step} of 4: `));
  }
  for (let i = 1; i < counts.length; i++) assert.ok(counts[i] < counts[i - 1], `${counts}`);
  await page.getByRole('button', { name: 'Play' }).click();
  await page.waitForFunction((n) => Number(document.getElementById('shown').dataset.points) === n, counts[0], { timeout: 15000 });
  await page.close();
});

test('every way to colour gives another picture', async () => {
  const { page } = await open(browser, plain);
  const pick = page.getByLabel('Colour by');
  const modes = await pick.locator('option').evaluateAll((all) => all.map((o) => o.value));
  assert.deepEqual(modes, ['scan', 'step', 'residual', 'probability', 'original']);
  const seen = [];
  for (const mode of modes) {
    await pick.selectOption(mode);
    const picture = await pixels(page);
    for (const other of seen) assert.ok(difference(picture, other) > 0.01, `${mode} looks like another mode`);
    seen.push(picture);
  }
  await page.close();
});

test('keys turn the view, walk the matrix and sort the table', async () => {
  const { page } = await open(browser, plain);
  await page.keyboard.press('Tab');
  assert.equal(await page.evaluate(() => document.activeElement.textContent), 'Skip to the table of evidence');
  const before = await pixels(page);
  await page.locator('#canvas').focus();
  await page.keyboard.press('ArrowLeft');
  await page.keyboard.press('+');
  assert.ok(difference(before, await pixels(page)) > 0.01);
  await page.keyboard.press('Home');
  assert.ok(difference(before, await pixels(page)) < 0.001);
  const matrix = page.locator('#matrix canvas');
  await matrix.focus();
  await page.keyboard.press('ArrowRight');
  assert.match(await page.locator('#matrix p').first().textContent(), /predicted 0\.\d\d, verified 0\.\d\d/);
  await page.keyboard.press('Enter');
  assert.equal(await page.locator('#scans li.chosen').count(), 1);
  const head = page.locator('#evidence th', { hasText: 'Inliers' });
  await head.getByRole('button').click();
  assert.equal(await head.getAttribute('aria-sort'), 'ascending');
  const column = await head.evaluate((th) => th.cellIndex);
  const cells = await page.locator('#evidence tbody tr').evaluateAll((rows, c) => rows.map((r) => r.cells[c].textContent), column);
  const numbers = cells.filter(Boolean).map(Number);
  assert.equal(numbers.length, 4);
  assert.deepEqual(numbers, [...numbers].sort((a, b) => a - b));
  await page.close();
});

test('every control has a name that is read out', async () => {
  const { page } = await open(browser, plain);
  const nameless = await page.locator('button, input, select, canvas, [tabindex="0"]').evaluateAll((all) => all
    .filter((e) => !(e.getAttribute('aria-label') || e.textContent.trim() || e.labels?.[0]?.textContent.trim()))
    .map((e) => e.outerHTML.slice(0, 120)));
  assert.deepEqual(nameless, []);
  assert.ok((await page.locator('[aria-live="polite"]').count()) >= 3);
  await page.close();
});

test('dark and light follow the system and the button', async () => {
  const ground = (page) => page.evaluate(() => getComputedStyle(document.body).backgroundColor);
  const { page } = await open(browser, plain, { colorScheme: 'dark' });
  const dark = await ground(page);
  const seen = await pixels(page);
  await page.locator('#theme').click();
  assert.notEqual(await ground(page), dark);
  assert.notEqual(groundOf(await pixels(page)), groundOf(seen));
  await page.close();
});

test('on a phone nothing sticks out and every control can be reached', async () => {
  const { page, problems } = await open(browser, plain, { width: 390, height: 844, hasTouch: true, isMobile: true });
  assert.equal(await page.evaluate(() => document.documentElement.scrollWidth), 390);
  const out = await page.locator('#view-bar *, .growth *, #scans button, #scans input, #left-out button, #theme').evaluateAll((all) => all
    .filter((e) => e.checkVisibility()).map((e) => [e.outerHTML.slice(0, 80), e.getBoundingClientRect()])
    .filter(([, b]) => b.left < 0 || b.right > 390).map(([html]) => html));
  assert.deepEqual(out, []);
  const count = await points(page);
  await page.locator('#scans li input').first().tap();
  assert.ok((await points(page)) < count);
  assert.ok(covered(await pixels(page)) > 0.05);
  assert.deepEqual(problems, []);
  await page.close();
});

test('without WebGL the lists and tables remain', async () => {
  const without = await launch(['--disable-gpu', '--disable-3d-apis']);
  const page = await without.newPage();
  await page.goto(`file://${plain}`);
  await page.waitForFunction(() => window.scanweave?.ready);
  assert.match(await page.locator('#no-view').textContent(), /WebGL/);
  assert.equal(await page.locator('#evidence tbody tr').count(), 6);
  await page.locator('#scans li input').first().uncheck();
  assert.match(await page.locator('#shown').textContent(), /^4 scans shown/);
  await without.close();
});

test('models that found no join are shown one at a time', async () => {
  const { page, problems } = await open(browser, join(reports, 'two/report.html'));
  assert.match(await page.locator('h1').textContent(), /^All 7 scans placed, but in 2 separate models .*\(of 4 and 3 scans\)\.$/);
  assert.match(await page.locator('#note').textContent(), /nothing to do with each other/);
  assert.match(await page.locator('#shown').textContent(), /^4 scans shown/);
  const first = await pixels(page);
  const pick = page.getByLabel(/^Model/);
  await pick.selectOption('1');
  assert.match(await page.locator('#shown').textContent(), /^3 scans shown/);
  assert.match(await page.locator('#step-text').textContent(), /^Step 2 of 2: /);
  assert.ok(difference(first, await pixels(page)) > 0.05);
  // A scan of the other model brings that model back.
  await page.locator('#scans .name').first().click();
  assert.equal(await pick.inputValue(), '0');
  assert.match(await page.locator('#shown').textContent(), /^4 scans shown/);
  assert.deepEqual(problems, []);
  await page.close();
});

test('a result without its scans shows its merged cloud and says so', async () => {
  const { page, problems } = await open(browser, join(reports, 'gone/report.html'));
  assert.match(await page.locator('#note').textContent(), /^The points of 5 scans come from the merged cloud .* The points of 1 scan were not at hand/);
  const share = covered(await pixels(page));
  assert.ok(share > 0.05 && share < 0.95, `${share} of the canvas is covered`);
  const modes = await page.getByLabel('Colour by').locator('option').evaluateAll((all) => all.map((o) => o.value));
  assert.deepEqual(modes, ['scan', 'step', 'probability', 'original']);
  assert.deepEqual(problems, []);
  await page.close();
});

test('hostile names are shown as text and never run', async () => {
  const { page, problems } = await open(browser, hostile);
  await drawn(page);
  const names = await page.locator('#scans .name').evaluateAll((all) => all.map((e) => e.firstChild.textContent));
  assert.deepEqual(names.sort(), JSON.parse(process.env.HOSTILE_NAMES).sort());
  // Every place that shows a name is visited once.
  for (const name of await page.locator('#scans .name').all()) await name.click();
  await page.locator('#matrix canvas').focus();
  await page.keyboard.press('ArrowRight');
  assert.equal(await page.evaluate(() => window.hacked), undefined);
  assert.equal(await page.locator('img, iframe, svg').count(), 0);
  assert.equal(await page.locator('script').count(), 2);
  assert.deepEqual(problems, []);
  await page.close();
});
