// Predicted against verified overlap: one cell a pair, in the order of the growth.

import { byId, el } from './dom.js';
import { predicted, share, verified } from './data.js';
import { css, ramp } from './colours.js';

export function matrix(data, state) {
  const place = byId('matrix');
  if (data.similarity === null) {
    place.append(el('p', { textContent: 'The predicted overlap was not at hand when this page was made.' }));
    return;
  }
  const order = sorted(data);
  const n = order.length;
  const cell = Math.max(1, Math.min(24, Math.floor(1040 / n)));
  const canvas = el('canvas', { width: n * cell, height: n * cell, tabIndex: 0, role: 'application',
    'aria-label': 'Matrix of overlaps: above the diagonal predicted, below it verified. Arrow keys go from pair to pair, Enter selects the scan of the row.' });
  const said = el('p', { 'aria-live': 'polite', textContent: 'Point at a cell, or go there with the arrow keys.' });
  const draw = (cursor) => {
    const context = canvas.getContext('2d');
    context.fillStyle = css([0.5, 0.5, 0.5]);
    context.fillRect(0, 0, n * cell, n * cell);
    for (let r = 0; r < n; r++) for (let c = 0; c < n; c++) {
      if (r === c) continue;
      const v = r < c ? predicted(data, order[r], order[c]) : verified(data, order[r], order[c]);
      context.fillStyle = v === null ? '#999' : css(ramp('order', v));
      context.fillRect(c * cell, r * cell, cell, cell);
    }
    if (!cursor) return;
    context.strokeStyle = '#ff3b30';
    context.lineWidth = 2;
    context.strokeRect(cursor[1] * cell, cursor[0] * cell, cell, cell);
  };
  let cursor = null;
  const go = (r, c) => {
    cursor = [Math.min(n - 1, Math.max(0, r)), Math.min(n - 1, Math.max(0, c))];
    const [i, j] = cursor.map((k) => order[k]);
    const v = verified(data, i, j);
    said.textContent = i === j ? data.scans[i].name
      : `${data.scans[i].name} and ${data.scans[j].name}: predicted ${share(predicted(data, i, j))}, ${v === null ? 'not verified (not in one model)' : `verified ${share(v)}`}`;
    draw(cursor);
  };
  canvas.addEventListener('pointermove', (e) => {
    const box = canvas.getBoundingClientRect();
    go(Math.floor(((e.clientY - box.top) / box.height) * n), Math.floor(((e.clientX - box.left) / box.width) * n));
  });
  canvas.addEventListener('click', () => cursor && state.select(order[cursor[0]]));
  canvas.addEventListener('keydown', (e) => {
    const step = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] }[e.key];
    if (e.key === 'Enter' && cursor) state.select(order[cursor[0]]);
    if (!step) return;
    e.preventDefault();
    const [r, c] = cursor ?? [0, 0];
    go(r + step[0], c + step[1]);
  });
  draw(null);
  const ends = el('p', { textContent: `Above the diagonal: overlap as predicted before registration. Below: as measured at the final positions; grey where two scans are not in one model. ${errors(data)}` });
  place.append(canvas, said, ends);
}

function sorted(data) {
  const key = (i) => {
    const p = data.scans[i].placed;
    return p ? p.component * 1e6 + p.step : 1e12;
  };
  return data.scans.map((_, i) => i).sort((a, b) => key(a) - key(b) || a - b);
}

/** Mean difference between both, over all pairs that can be verified. */
function errors(data) {
  let [sum, count] = [0, 0];
  for (let i = 0; i < data.scans.length; i++) for (let j = 0; j < i; j++) {
    const v = verified(data, i, j);
    if (v === null) continue;
    sum += Math.abs(v - predicted(data, i, j));
    count += 1;
  }
  return count ? `On average they differ by ${share(sum / count)} over ${count} pairs.` : '';
}
