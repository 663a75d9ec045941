// Turning, shifting and zooming by mouse, touch and keyboard, about the model's up.

import { Vector3 } from 'three';

const MOST_ELEVATION = 1.55;
const CLICK_PX = 5;

export class Orbit {
  constructor(canvas, view) {
    this.canvas = canvas;
    this.view = view;
    this.azimuth = 0;
    this.elevation = 0;
    this.distance = 1;
    this.target = new Vector3();
    this.flipped = false;
    this.fitted = false;
    this.pointers = new Map();
    this.several = false;
    this.onClick = () => {};
    canvas.addEventListener('pointerdown', (e) => this.down(e));
    canvas.addEventListener('pointermove', (e) => this.moved(e));
    for (const end of ['pointerup', 'pointercancel']) canvas.addEventListener(end, (e) => this.up(e));
    canvas.addEventListener('contextmenu', (e) => e.preventDefault());
    // The wheel scrolls the page until the view has the focus.
    canvas.addEventListener('wheel', (e) => {
      if (document.activeElement !== canvas && !e.ctrlKey) return;
      e.preventDefault();
      this.zoom(Math.exp(e.deltaY * (e.deltaMode === 1 ? 0.05 : 0.0015)));
    }, { passive: false });
    canvas.addEventListener('keydown', (e) => this.key(e));
  }

  /** All of the model, from obliquely above, on the side from which it was seen. */
  fit() {
    const { east, north } = this.axes();
    const from = new Vector3(...this.view.frame.seenFrom);
    const [x, y] = [from.dot(east), from.dot(north)];
    const aside = Math.hypot(x, y) > 0.1 * this.view.frame.radius;
    this.look(aside ? Math.atan2(y, x) : 0.7, 0.65);
    this.fitted = true;
  }

  /** All of the model but stray points, from a given side. */
  look(azimuth, elevation) {
    const { frame, camera } = this.view;
    Object.assign(this, { azimuth, elevation, distance: 1, fitted: false });
    this.target.set(0, 0, 0);
    this.place(camera);
    const [right, above, back] = [new Vector3(), new Vector3(), new Vector3()];
    camera.matrixWorld.extractBasis(right, above, back);
    const high = Math.tan((Math.PI / 360) * camera.fov);
    const needed = frame.points.map((p) => {
      const at = new Vector3(...p);
      return at.dot(back) + Math.max(Math.abs(at.dot(above)) / high, Math.abs(at.dot(right)) / (high * camera.aspect));
    }).sort((a, b) => a - b);
    this.distance = Math.max(0.5 * frame.radius, 1.06 * (needed[Math.floor(0.98 * (needed.length - 1))] ?? 1));
    this.view.draw();
  }

  flip() {
    this.flipped = !this.flipped;
    this.view.draw();
  }

  /** Right, up and backward axes of the turntable. */
  axes() {
    const up = new Vector3(...this.view.frame.up).multiplyScalar(this.flipped ? -1 : 1);
    const side = Math.abs(up.x) < 0.8 ? new Vector3(1, 0, 0) : new Vector3(0, 1, 0);
    const east = side.sub(up.clone().multiplyScalar(side.dot(up))).normalize();
    return { up, east, north: new Vector3().crossVectors(up, east) };
  }

  place(camera) {
    const { up, east, north } = this.axes();
    const flat = east.multiplyScalar(Math.cos(this.azimuth)).add(north.multiplyScalar(Math.sin(this.azimuth)));
    const back = flat.multiplyScalar(Math.cos(this.elevation)).add(up.clone().multiplyScalar(Math.sin(this.elevation)));
    camera.position.copy(this.target).add(back.multiplyScalar(this.distance));
    camera.up.copy(up);
    camera.lookAt(this.target);
    camera.near = 0.01 * this.distance;
    camera.far = 4 * (this.distance + this.target.length() + this.view.frame.radius);
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
  }

  turn(dx, dy) {
    this.fitted = false;
    this.azimuth -= dx;
    this.elevation = Math.min(MOST_ELEVATION, Math.max(-MOST_ELEVATION, this.elevation + dy));
    this.view.move();
  }

  zoom(factor) {
    this.fitted = false;
    const { radius } = this.view.frame;
    this.distance = Math.min(20 * radius, Math.max(0.01 * radius, this.distance * factor));
    this.view.move();
  }

  /** Shifts by pixels. */
  shift(dx, dy) {
    this.fitted = false;
    const { camera } = this.view;
    const scale = (2 * this.distance * Math.tan((Math.PI / 360) * camera.fov)) / this.canvas.clientHeight;
    const [right, above] = [new Vector3(), new Vector3()];
    camera.matrixWorld.extractBasis(right, above, new Vector3());
    this.target.addScaledVector(right, -dx * scale).addScaledVector(above, dy * scale);
    this.view.move();
  }

  down(e) {
    if (!this.pointers.size) this.several = false;
    this.canvas.focus({ preventScroll: true });
    this.canvas.setPointerCapture(e.pointerId);
    this.pointers.set(e.pointerId, { x: e.clientX, y: e.clientY, travel: 0 });
  }

  moved(e) {
    const pointer = this.pointers.get(e.pointerId);
    if (!pointer) return;
    const [dx, dy] = [e.clientX - pointer.x, e.clientY - pointer.y];
    pointer.travel += Math.abs(dx) + Math.abs(dy);
    const before = this.spread();
    Object.assign(pointer, { x: e.clientX, y: e.clientY });
    if (this.pointers.size >= 2) {
      this.shift(dx / 2, dy / 2);
      if (before > 0) this.zoom(before / Math.max(1, this.spread()));
    } else if (e.buttons & 2 || e.shiftKey) this.shift(dx, dy);
    else this.turn(dx * 0.008, dy * 0.008);
  }

  spread() {
    const [a, b] = [...this.pointers.values()];
    return b ? Math.hypot(a.x - b.x, a.y - b.y) : 0;
  }

  up(e) {
    const pointer = this.pointers.get(e.pointerId);
    this.pointers.delete(e.pointerId);
    // A press that was moved, a second finger or another button turns and shifts, and chooses nothing.
    if (this.pointers.size) this.several = true;
    else if (pointer && pointer.travel < CLICK_PX && e.type === 'pointerup' && e.button === 0 && !this.several) {
      const box = this.canvas.getBoundingClientRect();
      this.onClick(e.clientX - box.left, e.clientY - box.top);
    }
  }

  key(e) {
    const step = 0.12;
    const actions = {
      ArrowLeft: () => (e.shiftKey ? this.shift(-30, 0) : this.turn(step, 0)),
      ArrowRight: () => (e.shiftKey ? this.shift(30, 0) : this.turn(-step, 0)),
      ArrowUp: () => (e.shiftKey ? this.shift(0, -30) : this.turn(0, step)),
      ArrowDown: () => (e.shiftKey ? this.shift(0, 30) : this.turn(0, -step)),
      '+': () => this.zoom(0.85), '=': () => this.zoom(0.85), '-': () => this.zoom(1 / 0.85),
      Home: () => this.fit(),
    };
    if (!actions[e.key] || e.ctrlKey || e.metaKey || e.altKey) return;
    e.preventDefault();
    actions[e.key]();
  }
}
