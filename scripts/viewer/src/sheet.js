// A page of tables and plots: everything is there already, this only sorts and colours.

import { button } from './dom.js';
import { compared, sortState } from './sort.js';
import { theme } from './theme.js';

/** What a cell is sorted by: the number that it begins with, or its text; null where it is empty. */
function value(cell, number) {
  const text = cell.textContent.trim();
  if (!number) return text || null;
  const found = Number.parseFloat(text);
  return Number.isNaN(found) ? null : found;
}

for (const table of document.querySelectorAll('table')) {
  const rows = [...table.tBodies[0].rows];
  const heads = [...table.tHead.rows[0].cells];
  if (rows.length < 2) continue;
  heads.forEach((head, c) => {
    const number = head.classList.contains('number');
    head.setAttribute('aria-sort', 'none');
    const sort = button(head.textContent, () => {
      const down = sortState(heads, head);
      const values = new Map(rows.map((row) => [row, value(row.cells[c], number)]));
      table.tBodies[0].append(...[...rows].sort((a, b) => compared(values.get(a), values.get(b), down) || rows.indexOf(a) - rows.indexOf(b)));
    });
    head.replaceChildren(sort);
  });
}
theme();
window.scanweave = { ready: true, settled: () => true };
