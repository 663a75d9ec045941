// Puts the page together: data → state → view and panels.

import { button, byId, check, choice, el, slider } from './dom.js';
import { counted, length, readData } from './data.js';
import { colourOf, css, cssRamp, modes, MOST_ERROR, MOST_RESIDUAL } from './colours.js';
import { details, evidence, leftOut, list, note, runFacts, tree } from './panels.js';
import { matrix } from './matrix.js';
import { View } from './scene.js';
import { State } from './state.js';
import { theme } from './theme.js';

function viewBar(data, state, view) {
  const bar = byId('view-bar');
  if (data.components.length > 1) {
    const models = data.components.map((c, i) => [String(i), `model ${i + 1} (${counted(c.scans.length, 'scan')})`]);
    const pick = choice('Model', models, '0', (v) => state.chooseComponent(Number(v)));
    state.onChange(() => { pick.querySelector('select').value = String(state.component); });
    bar.append(pick);
  }
  bar.append(choice('Colour by', modes(data), state.colour, (v) => state.set({ colour: v })));
  if (!view) return;
  view.options.markers = view.sensorsKnown();
  bar.append(
    slider('Point size', [0.3, 4, 0.1, 1], (v) => { view.options.size = v; view.draw(); }),
    slider('Cut from above', [0.05, 1, 0.01, 1], (v) => { view.options.cut = v; view.draw(); }),
    check('Scanner positions and joins', view.options.markers, (v) => { view.options.markers = v; state.set({}); }),
    check('Shading', true, (v) => { view.options.shading = v; view.draw(); }),
    button('Show all', () => view.fit()),
    button('From above', () => view.orbit.look(view.orbit.azimuth, 1.55)),
    button('From the side', () => view.orbit.look(view.orbit.azimuth, 0.05)),
    button('Upside down', () => view.orbit.flip()),
  );
}

function growth(data, state) {
  const [range, said, play] = [byId('step'), byId('step-text'), byId('play')];
  const text = () => {
    if (state.component === null) return 'Nothing was joined.';
    const at = data.components[state.component].scans.filter((i) => data.scans[i].placed.step === state.step);
    const what = at.map((i) => {
      const { name, placed } = data.scans[i];
      if (placed.parent === null) return `starts with ${name}`;
      return `${name} joins ${data.scans[placed.parent].name}, ${placed.inliers} of ${placed.matches} matches agree`;
    });
    return `Step ${state.step} of ${data.lastStep[state.component]}: ${what.join('; ')}`;
  };
  const update = () => {
    range.max = String(state.component === null ? 0 : data.lastStep[state.component]);
    range.value = String(state.step);
    said.textContent = text();
    range.setAttribute('aria-valuetext', said.textContent);
  };
  range.addEventListener('input', () => state.set({ step: Number(range.value), solo: null }));
  let timer = null;
  const stop = () => { clearInterval(timer); timer = null; play.textContent = 'Play'; };
  play.addEventListener('click', () => {
    if (timer !== null) return stop();
    const last = data.lastStep[state.component] ?? 0;
    if (state.step >= last) state.set({ step: 0, solo: null });
    play.textContent = 'Pause';
    timer = setInterval(() => {
      if (state.step >= data.lastStep[state.component]) return stop();
      state.set({ step: state.step + 1, solo: null });
    }, Math.max(150, Math.min(900, 12000 / Math.max(1, last))));
  });
  for (const control of [range, play]) control.disabled = state.component === null;
  state.onChange(update);
  update();
}

function legend(data, state) {
  const place = byId('legend');
  const scale = (name, low, high) => {
    const strip = el('div', { className: 'ramp' });
    strip.style.background = cssRamp(name);
    return [strip, el('div', { className: 'ends' }, el('span', { textContent: low }), el('span', { textContent: high }))];
  };
  const update = () => {
    const radius = data.scale.inlier_radius_m;
    const content = {
      step: () => scale('order', 'first', 'last'),
      probability: () => scale('error', 'certain', 'doubtful'),
      error: () => scale('error', '0', `${length(MOST_ERROR * radius)} and more`),
      residual: () => [...scale('error', '0', `${length(MOST_RESIDUAL * radius)} and more`), `grey: no other scan within ${length(radius)}`],
    }[state.colour];
    place.replaceChildren(...(content ? content() : []));
  };
  state.onChange((_, changed) => changed.has('colour') && update());
  update();
}

function start() {
  const data = readData();
  const state = new State(data);
  byId('main').hidden = false;
  let view = null;
  try {
    view = new View(byId('canvas'), data);
  } catch (error) {
    byId('canvas').hidden = true;
    byId('no-view').hidden = false;
    byId('no-view').textContent = `This browser offers no 3D drawing (WebGL 2), so only lists and tables are shown. (${error.message})`;
  }
  note(data);
  leftOut(data, state);
  const swatches = list(data, state);
  details(data, state);
  evidence(data, state);
  tree(data, state);
  matrix(data, state);
  runFacts(data);
  growth(data, state);
  legend(data, state);
  const colour = (i) => colourOf(data, i, state.colour);
  const shown = byId('shown');
  const show = () => {
    const visible = data.scans.map((_, i) => i).filter((i) => state.visible(i));
    const points = view ? view.show(state, colour) : visible.reduce((sum, i) => sum + data.scans[i].points.count, 0);
    shown.textContent = `${counted(visible.length, 'scan')} shown, ${counted(points, 'point')}`;
    shown.dataset.points = String(points);
    swatches.forEach((s, i) => { s.style.background = css(colour(i)); });
  };
  viewBar(data, state, view);
  state.onChange((_, changed) => (changed.size === 1 && changed.has('selected') ? null : show()));
  if (view) view.orbit.onClick = (x, y) => state.select(view.pick(x, y));
  if (view) new ResizeObserver(() => view.resize()).observe(byId('canvas'));
  show();
  theme(() => {
    const ground = getComputedStyle(document.documentElement).getPropertyValue('--view').trim();
    view?.ground.setStyle(ground, '');
    view?.draw();
  });
  // For measuring: scripts/report-figures.mjs turns the model once and counts.
  window.scanweave = {
    ready: true,
    turn: (frames, share = 1) => view.measure(frames, share),
    spin: (milliseconds) => view.spin(milliseconds),
    settled: () => !view || view.settled,
  };
}

start();
