// Tables that are sorted by a click on the head of a column.

/** Order of two values; those that are missing come last either way. */
export function compared(a, b, down) {
  if (a === null || b === null) return (a === null) - (b === null);
  const order = typeof a === 'number' ? a - b : String(a).localeCompare(String(b), 'en', { numeric: true });
  return down ? -order : order;
}

/** Marks the column that is sorted by from now on; true where the greatest comes first. */
export function sortState(heads, head) {
  const down = head.getAttribute('aria-sort') === 'ascending';
  for (const other of heads) other.setAttribute('aria-sort', 'none');
  head.setAttribute('aria-sort', down ? 'descending' : 'ascending');
  return down;
}
