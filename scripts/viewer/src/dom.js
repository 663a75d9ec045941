// Elements from data. Text always goes in as text, never as markup.

export const byId = (id) => document.getElementById(id);

/** An element with properties, `on…` handlers, `aria` attributes and children (elements or text). */
export function el(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name.startsWith('on')) element.addEventListener(name.slice(2), value);
    else if (name.includes('-') || name === 'role' || name === 'scope' || name === 'for') element.setAttribute(name, value);
    else element[name] = value;
  }
  element.append(...children.filter((c) => c !== null && c !== undefined));
  return element;
}

export function button(text, onclick, properties = {}) {
  return el('button', { type: 'button', textContent: text, onclick, ...properties });
}

/** A labelled checkbox. */
export function check(text, checked, onchange) {
  const box = el('input', { type: 'checkbox', checked });
  box.addEventListener('change', () => onchange(box.checked));
  return el('label', {}, box, text);
}

/** A labelled slider. */
export function slider(text, [min, max, step, value], oninput) {
  const range = el('input', { type: 'range', min, max, step, value });
  range.addEventListener('input', () => oninput(Number(range.value)));
  return el('label', {}, text, range);
}

/** A labelled choice of [value, text] pairs. */
export function choice(text, options, value, onchange) {
  const select = el('select', {}, ...options.map(([v, t]) => el('option', { value: v, textContent: t })));
  select.value = value;
  select.addEventListener('change', () => onchange(select.value));
  return el('label', {}, text, select);
}
