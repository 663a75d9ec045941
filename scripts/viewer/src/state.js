// What is shown: one model or one scan, up to one step of its growth.

export class State {
  constructor(data) {
    this.data = data;
    this.hidden = new Set();
    this.solo = null;
    this.selected = null;
    this.colour = 'scan';
    this.listeners = [];
    this.component = data.components.length ? 0 : null;
    this.step = this.component === null ? 0 : data.lastStep[0];
  }

  onChange(listener) {
    this.listeners.push(listener);
  }

  /** Changes some fields and tells everybody which. */
  set(fields) {
    Object.assign(this, fields);
    for (const listener of this.listeners) listener(this, new Set(Object.keys(fields)));
  }

  chooseComponent(component) {
    this.set({ component, step: this.data.lastStep[component], solo: null });
  }

  /** Shows a scan, in its own component. */
  select(scan) {
    const placed = scan === null ? null : this.data.scans[scan].placed;
    if (placed && placed.component !== this.component) this.chooseComponent(placed.component);
    this.set({ selected: scan });
  }

  toggleSolo(scan) {
    if (this.solo === scan) return this.set({ solo: null });
    const placed = this.data.scans[scan].placed;
    if (placed && placed.component !== this.component) this.chooseComponent(placed.component);
    this.set({ solo: scan, selected: scan });
  }

  hide(scans, hidden) {
    for (const scan of scans) hidden ? this.hidden.add(scan) : this.hidden.delete(scan);
    this.set({ hidden: this.hidden });
  }

  visible(scan) {
    if (this.solo !== null) return scan === this.solo;
    const placed = this.data.scans[scan].placed;
    return placed !== null && placed.component === this.component && placed.step <= this.step && !this.hidden.has(scan);
  }
}
