// Everything beside the 3D view: headline, lists, table, tree, time, settings.

import { button, byId, check, el } from './dom.js';
import { counted, length, overlapOf, predicted, share, verified } from './data.js';
import { css, scanColour } from './colours.js';
import { compared, sortState } from './sort.js';

/** What is doubtful about a scan, by the word of poses.json. */
const DOUBTS = {
  ambiguous: 'ambiguous: another pose is not ruled out',
  'poorly-localised': 'poorly localised: held loosely by what touches it',
};

export function leftOut(data, state) {
  const lost = data.scans.map((s, i) => [s, i]).filter(([s]) => s.left_out);
  if (!lost.length) return;
  byId('left-out').hidden = false;
  byId('left-out-title').textContent = `${counted(lost.length, 'scan')} left out, and why`;
  byId('left-out-list').replaceChildren(...lost.map(([scan, i]) => {
    const alone = scan.points.count ? soloButton(state, i, 'Show alone') : null;
    return el('li', {}, el('p', { title: scan.left_out.exact }, el('strong', { textContent: scan.name }), `: ${scan.left_out.plain}`), alone);
  }));
}

function soloButton(state, scan, text) {
  const name = state.data.scans[scan].name;
  const b = button(text, () => state.toggleSolo(scan), { 'aria-label': `${text}: ${name}`, 'aria-pressed': 'false' });
  state.onChange(() => b.setAttribute('aria-pressed', String(state.solo === scan)));
  return b;
}

export function note(data) {
  const { components, scans } = data;
  const parts = [];
  if (components.length > 1) parts.push('Positions in different models have nothing to do with each other: each model is shown by itself.');
  const merged = scans.filter((s) => s.points.count && s.points_from === 'merged').length;
  if (merged) parts.push(`The points of ${counted(merged, 'scan')} come from the merged cloud of the result, as the scan files were not at hand: where scans overlap, only one of them shows points.`);
  const without = scans.filter((s) => !s.points.count).length;
  if (without) parts.push(`The points of ${counted(without, 'scan')} were not at hand when this page was made.`);
  const worst = scans.filter((s) => s.error).sort((a, b) => b.error.translation_m - a.error.translation_m);
  if (worst.length) {
    const middle = worst[Math.floor(worst.length / 2)].error;
    parts.push(`Against the truth a scan is off by ${length(middle.translation_m)} in the median; ${worst[0].name} is off most, by ${length(worst[0].error.translation_m)}.`);
  }
  byId('note').textContent = parts.join(' ');
}

/** The list of scans, with switches. */
export function list(data, state) {
  const rows = data.scans.map((scan, i) => {
    const box = el('input', { type: 'checkbox', checked: true, disabled: !scan.placed, 'aria-label': `Show ${scan.name}` });
    box.addEventListener('change', () => state.hide([i], !box.checked));
    const swatch = el('span', { className: 'swatch', 'aria-hidden': 'true' });
    swatch.style.background = css(scanColour(i));
    const what = scan.placed
      ? `${data.components.length > 1 ? `model ${scan.placed.component + 1}, ` : ''}step ${scan.placed.step}`
      : 'left out';
    const name = button('', () => state.select(i), { className: 'name' });
    name.append(scan.name, el('small', { textContent: what }));
    const row = el('li', {}, box, swatch, name, scan.points.count ? soloButton(state, i, 'Solo') : null);
    return { row, box, swatch };
  });
  byId('scans').replaceChildren(...order(data).map((i) => rows[i].row));
  const search = el('input', { type: 'search', placeholder: 'Find a scan', 'aria-label': 'Find a scan by its name' });
  search.addEventListener('input', () => {
    const wanted = search.value.toLowerCase();
    rows.forEach(({ row }, i) => { row.hidden = !data.scans[i].name.toLowerCase().includes(wanted); });
  });
  const all = () => data.scans.map((_, i) => i);
  byId('list-bar').append(search, button('All', () => { state.solo = null; state.hide(all(), false); }), button('None', () => { state.solo = null; state.hide(all(), true); }));
  state.onChange((_, changed) => {
    const row = changed.has('selected') && rows[state.selected]?.row;
    if (!row) return;
    // Within the list only: the page stays where it is.
    const [inner, outer] = [row.getBoundingClientRect(), byId('scans').getBoundingClientRect()];
    if (inner.top < outer.top || inner.bottom > outer.bottom) byId('scans').scrollTop += inner.top - outer.top;
  });
  const update = () => rows.forEach(({ row, box }, i) => {
    box.checked = Boolean(data.scans[i].placed) && !state.hidden.has(i);
    row.classList.toggle('chosen', state.selected === i);
    row.classList.toggle('away', !state.visible(i));
  });
  state.onChange(update);
  update();
  return rows.map((r) => r.swatch);
}

/** Scans by component and step, those left out at the end. */
function order(data) {
  const key = (i) => {
    const placed = data.scans[i].placed;
    return placed ? [placed.component, placed.step, i] : [Infinity, 0, i];
  };
  return data.scans.map((_, i) => i).sort((a, b) => {
    const [x, y] = [key(a), key(b)];
    return x[0] === y[0] ? x[1] - y[1] || x[2] - y[2] : x[0] - y[0];
  });
}

const name = (data, i) => (i === null || i === undefined ? '' : data.scans[i].name);

const degrees = (v) => `${v.toFixed(2)}°`;

/** Columns of the evidence: head, value to sort by, text. */
function columns(data) {
  const placed = (f) => (s, i) => (s.placed ? f(s.placed, s, i) : null);
  const joined = (f) => placed((p, s) => (p.parent === null ? null : f(p, s)));
  const evidence = (f) => joined((p) => (p.evidence ? f(p.evidence) : null));
  const several = data.components.length > 1;
  const judged = data.scans.some((s) => s.error);
  const uncertain = data.scans.some((s) => typeof s.placed?.pose_uncertainty?.deviation_m === 'number');
  return [
    ['Outcome', (s) => (s.left_out ? 'left out' : s.placed.parent === null ? 'pivot' : 'placed'), String, 'text'],
    several ? ['Model', placed((p) => p.component + 1), String] : null,
    ['Step', placed((p) => p.step), String],
    ['Joined to', joined((p) => name(data, p.parent)), String, 'text'],
    ['Matches', joined((p) => p.matches), String],
    ['Inliers', joined((p) => p.inliers), String],
    ['Second best', evidence((p) => p.second_best_inliers), String],
    ['Overlap', placed((p, s) => overlapOf(s)), share],
    ['Residual', joined((p) => p.residual_m), length],
    ['Probability', evidence((p) => p.probability), share],
    uncertain ? ['Uncertainty', placed((p) => p.pose_uncertainty?.deviation_m ?? null), (v) => `± ${length(v)}`] : null,
    data.scans.some((s) => s.placed?.doubts?.length) ? ['Doubtful', placed((p) => (p.doubts ?? []).join(', ').replaceAll('-', ' ')), String, 'text'] : null,
    judged ? ['Angle off', (s) => s.error?.rotation_deg ?? null, degrees] : null,
    judged ? ['Shift off', (s) => s.error?.translation_m ?? null, length] : null,
    ['Points', (s) => s.size?.points ?? null, (v) => v.toLocaleString('en')],
    data.scans.some((s) => s.left_out) ? ['Why left out', (s) => s.left_out?.exact ?? null, String, 'text why'] : null,
  ].filter(Boolean);
}

export function evidence(data, state) {
  const shown = columns(data);
  const value = (i, c) => (c === null ? data.scans[i].name : shown[c][1](data.scans[i], i));
  const rows = data.scans.map((scan, i) => {
    const head = el('th', { scope: 'row', className: 'text' }, button(scan.name, () => state.select(i)));
    const cells = shown.map(([, , text, kind], c) => {
      const v = value(i, c);
      return el('td', { className: kind ?? 'number', textContent: v === null ? '' : text(v) });
    });
    return el('tr', { className: scan.left_out ? 'lost' : '' }, head, ...cells);
  });
  const body = el('tbody', {}, ...rows);
  const heads = [null, ...shown.keys()].map((c) => {
    const head = el('th', { scope: 'col', className: c !== null && !shown[c][3] ? 'number' : '', 'aria-sort': 'none' });
    head.append(button(c === null ? 'Scan' : shown[c][0], () => {
      const down = sortState(heads, head);
      body.append(...data.scans.map((_, i) => i).sort((a, b) => compared(value(a, c), value(b, c), down) || a - b).map((i) => rows[i]));
    }));
    return head;
  });
  byId('evidence').append(el('table', {}, el('thead', {}, el('tr', {}, ...heads)), body));
  state.onChange(() => rows.forEach((row, i) => row.classList.toggle('chosen', state.selected === i)));
}

export function tree(data, state) {
  const children = data.scans.map(() => []);
  for (const i of order(data)) {
    const parent = data.scans[i].placed?.parent;
    if (parent !== null && parent !== undefined) children[parent].push(i);
  }
  const items = new Map();
  const branch = (i) => {
    const { placed } = data.scans[i];
    const said = placed.parent === null ? 'pivot' : `step ${placed.step}, ${placed.inliers} of ${placed.matches} matches agree`;
    const item = el('li', {}, el('div', {}, button(data.scans[i].name, () => state.select(i)), el('span', { textContent: said })));
    if (children[i].length) item.append(el('ul', {}, ...children[i].map(branch)));
    items.set(i, item);
    return item;
  };
  const roots = order(data).filter((i) => data.scans[i].placed?.parent === null);
  byId('tree').append(roots.length ? el('ul', {}, ...roots.map(branch)) : el('p', { textContent: 'Nothing was joined.' }));
  state.onChange(() => items.forEach((item, i) => item.classList.toggle('chosen', state.selected === i)));
}

/** What is known about the selected scan. */
export function details(data, state) {
  const place = byId('details');
  const update = () => {
    const i = state.selected;
    place.hidden = i === null;
    if (i === null) return;
    const scan = data.scans[i];
    const facts = factsOf(data, scan);
    place.replaceChildren(
      el('h2', { id: 'details-title', textContent: scan.name }),
      el('dl', {}, ...facts.flatMap(([k, v]) => [el('dt', { textContent: k }), el('dd', { textContent: v })])),
    );
    if (!scan.placed) return;
    const near = [...scan.placed.neighbours].sort((a, b) => b.overlap - a.overlap);
    const head = ['Touches', 'Overlap', 'Predicted', 'Residual'].map((t, c) => el('th', { scope: 'col', className: c ? 'number' : '', textContent: t }));
    const rows = near.map((n) => el('tr', {},
      el('th', { scope: 'row' }, button(name(data, n.scan), () => state.select(n.scan), { className: 'link' })),
      ...[share(verified(data, i, n.scan)), share(predicted(data, i, n.scan)), length(n.residual_m)].map((t) => el('td', { className: 'number', textContent: t }))));
    place.append(el('div', { className: 'scroll tall', tabIndex: 0, role: 'region', 'aria-label': `Scans that ${scan.name} touches` },
      el('table', {}, el('thead', {}, el('tr', {}, ...head)), el('tbody', {}, ...rows))));
  };
  state.onChange((_, changed) => changed.has('selected') && update());
  update();
}

function factsOf(data, scan) {
  const facts = [];
  if (scan.file) facts.push(['File', scan.file]);
  if (scan.size) {
    facts.push(['Points', `${scan.size.points.toLocaleString('en')}, ${scan.size.surface_points.toLocaleString('en')} after thinning, ${scan.size.keypoints.toLocaleString('en')} keypoints`]);
  }
  if (scan.left_out) facts.push(['Left out', scan.left_out.plain], ['In numbers', scan.left_out.exact]);
  const p = scan.placed;
  if (!p) return facts;
  facts.push(['Placed', p.parent === null ? 'pivot: its frame is the frame of the model' : `at step ${p.step}, joined to ${name(data, p.parent)}`]);
  if (p.parent !== null) facts.push(['Matches', `${p.matches}, of which ${p.inliers} agree on the position`]);
  const s = p.evidence;
  if (s && p.parent !== null) {
    facts.push(
      ['Second best position', `${s.second_best_inliers} matches agree`],
      ['Surface on the model', `${share(s.overlap)}, normals agree on ${share(s.normal_agreement)} of it`],
      ['Free-space violation', share(s.free_space_violation)],
      ['Localizability', s.localizability.toPrecision(2)],
    );
    if (typeof s.probability === 'number') facts.push(['Probability to be right', share(s.probability)]);
  }
  if (p.parent !== null) facts.push(['Residual', length(p.residual_m)]);
  for (const doubt of p.doubts ?? []) facts.push(['Doubtful', DOUBTS[doubt] ?? doubt]);
  const uncertainty = p.pose_uncertainty;
  if (typeof uncertainty?.deviation_m === 'number') {
    facts.push(['Pose uncertainty', `± ${length(uncertainty.deviation_m)}, ± ${degrees(uncertainty.deviation_deg)} (one standard deviation)`]);
  }
  if (uncertainty?.weakest_edge) {
    const [i, j, probability] = uncertainty.weakest_edge;
    facts.push(['Weakest edge to the pivot', `${name(data, i)} and ${name(data, j)}, right with probability ${share(probability)}`]);
  }
  if (scan.error) facts.push(['Error against the truth', `${degrees(scan.error.rotation_deg)}, ${length(scan.error.translation_m)}`]);
  return facts;
}

export function runFacts(data) {
  const meters = data.timings.map((t) => {
    const meter = el('div', { className: 'meter', 'aria-hidden': 'true' });
    meter.style.width = `${(100 * t.seconds) / Math.max(...data.timings.map((u) => u.seconds), 1e-9)}%`;
    const bar = el('td', {}, meter);
    bar.style.width = '50%';
    return el('tr', {}, el('th', { scope: 'row', textContent: t.stage }), el('td', { className: 'number', textContent: `${t.seconds.toFixed(2)} s` }), bar);
  });
  byId('time').append(el('table', {}, el('tbody', {}, ...meters)), el('p', { textContent: `${data.total_seconds.toFixed(1)} s in all, ${counted(data.threads, 'thread')}` +
    (data.peak_memory_bytes ? `, at most ${Math.round(data.peak_memory_bytes / 1e6)} MB of memory` : '') }));
  const facts = [['Preset', data.preset], ['Method', data.method], ['Seed', data.seed], ['Voxel', length(data.scale.voxel_m)],
    ['Inlier radius', length(data.scale.inlier_radius_m)], ['Overlap head', data.overlap_head]];
  byId('run').append(...facts.flatMap(([k, v]) => [el('dt', { textContent: k }), el('dd', { textContent: String(v) })]));
  byId('config').textContent = data.config;
  byId('generator').textContent = `Made by ${data.generator}.`;
}
