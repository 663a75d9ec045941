// Dark or light, as the system or the button says.

/** `changed` is called after every change. */
export function theme(changed = () => {}) {
  const toggle = document.getElementById('theme');
  const apply = (dark) => {
    document.documentElement.dataset.theme = dark ? 'dark' : 'light';
    toggle.setAttribute('aria-pressed', String(dark));
    changed();
  };
  const wanted = window.matchMedia('(prefers-color-scheme: dark)');
  apply(wanted.matches);
  wanted.addEventListener('change', (e) => apply(e.matches));
  toggle.addEventListener('click', () => apply(document.documentElement.dataset.theme !== 'dark'));
}
