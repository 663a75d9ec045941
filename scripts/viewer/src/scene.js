// The 3D view: every scan a cloud of packed points, drawn only when something changed.

import {
  BufferAttribute, BufferGeometry, Color, DataTexture, DepthTexture, Float32BufferAttribute, GLSL3,
  Group, LinearFilter, LinearSRGBColorSpace, LineBasicMaterial, LineSegments, Matrix4, Mesh, NearestFilter,
  OrthographicCamera, PerspectiveCamera, PlaneGeometry, Points, RGBAFormat, Scene, ShaderMaterial,
  UnsignedIntType, Vector3, WebGLRenderer, WebGLRenderTarget,
} from 'three';
import { ramp, MOST_RESIDUAL, scanColour } from './colours.js';
import { pointsOf } from './data.js';
import { directionOf, frameOf } from './frame.js';
import { Orbit } from './orbit.js';
import { POINT_FRAGMENT, POINT_VERTEX, SCREEN_FRAGMENT, SCREEN_VERTEX } from './shaders.js';

const IDENTITY = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]];
const SAMPLE = 400;
/** A click chooses among points up to so many pixels away. */
const REACH_PX = 7;
/** How much nearer to the eye a point must be for each length that it is farther from the click. */
const ASIDE = 4;
/** Share of the points below which the rest of the picture gets simpler too. */
const COARSE = 0.6;

export class View {
  /** Throws where the browser offers no WebGL 2. */
  constructor(canvas, data) {
    this.data = data;
    this.canvas = canvas;
    this.renderer = new WebGLRenderer({ canvas, antialias: false, alpha: false, powerPreference: 'high-performance' });
    this.renderer.outputColorSpace = LinearSRGBColorSpace;
    this.renderer.autoClear = true;
    this.scene = new Scene();
    this.marks = new Group();
    this.scene.add(this.marks);
    this.camera = new PerspectiveCamera(45, 1, 0.01, 100);
    this.options = { size: 1, cut: 1, markers: true, shading: true };
    this.ground = new Color(0.95, 0.96, 0.97);
    this.ramp = residualRamp();
    this.clouds = data.scans.map((scan, i) => this.cloud(scan, i));
    this.frames = new Map();
    this.screen = this.screenPass();
    this.pending = false;
    this.drawn = 0;
    this.size = [4, 4];
    this.settled = false;
    this.moving = { share: 1, last: -Infinity, timer: 0, full: false };
    this.orbit = new Orbit(canvas, this);
  }

  cloud(scan, index) {
    const packed = pointsOf(scan);
    const geometry = new BufferGeometry();
    geometry.setAttribute('position', new BufferAttribute(packed.xyz, 3, true));
    geometry.setAttribute('aRgb', new BufferAttribute(packed.rgb ?? new Uint8Array(3 * packed.count), 3, true));
    geometry.setAttribute('aResidual', new BufferAttribute(packed.residual ?? new Uint8Array(packed.count).fill(255), 1, true));
    const material = new ShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: POINT_VERTEX.replace('RESIDUAL_GAIN', (255 / 254 / MOST_RESIDUAL).toFixed(4)),
      fragmentShader: POINT_FRAGMENT,
      uniforms: {
        uSize: { value: 1 }, uScale: { value: 1 }, uMode: { value: 0 }, uCut: { value: 1e9 },
        uColor: { value: new Vector3() }, uUp: { value: new Vector3() }, uRamp: { value: this.ramp },
      },
    });
    const points = new Points(geometry, material);
    points.frustumCulled = false;
    points.matrixAutoUpdate = false;
    // One point a voxel would be a voxel apart; discs a little larger close the surface.
    const thinned = scan.size?.surface_points ?? packed.count;
    const spacing = this.data.scale.voxel_m * Math.min(1.5, Math.max(0.4, Math.sqrt(thinned / Math.max(1, packed.count))));
    points.userData = { index, packed, spacing: 1.25 * spacing, pose: scan.placed?.world_from_scan ?? IDENTITY };
    this.scene.add(points);
    return points;
  }

  screenPass() {
    const target = new WebGLRenderTarget(4, 4, { minFilter: NearestFilter, magFilter: NearestFilter });
    target.depthTexture = new DepthTexture(4, 4, UnsignedIntType);
    const material = new ShaderMaterial({
      glslVersion: GLSL3, vertexShader: SCREEN_VERTEX, fragmentShader: SCREEN_FRAGMENT,
      depthTest: false, depthWrite: false,
      uniforms: {
        uImage: { value: target.texture }, uDepth: { value: target.depthTexture }, uStep: { value: { x: 0, y: 0 } },
        uGround: { value: this.ground }, uNear: { value: 0.1 }, uFar: { value: 10 }, uStrength: { value: 0 },
      },
    });
    const scene = new Scene();
    const quad = new Mesh(new PlaneGeometry(2, 2), material);
    quad.frustumCulled = false;
    scene.add(quad);
    return { target, material, scene, camera: new OrthographicCamera(-1, 1, 1, -1, 0, 1) };
  }

  /** The frame of one component, or of one scan that was left out. */
  frameOf(state) {
    const lone = state.solo !== null && !this.data.scans[state.solo].placed;
    const key = lone ? `scan ${state.solo}` : `component ${state.component}`;
    if (!this.frames.has(key)) {
      const members = lone ? [state.solo] : state.component === null ? [] : this.data.components[state.component].scans;
      this.frames.set(key, { key, ...frameOf(members.map((i) => this.sampleOf(i))) });
    }
    return this.frames.get(key);
  }

  sampleOf(index) {
    const { packed, pose } = this.clouds[index].userData;
    const sample = [];
    for (let i = 0; i < Math.min(SAMPLE, packed.count); i++) {
      sample.push([0, 1, 2].map((a) => packed.low[a] + (packed.size[a] * packed.xyz[3 * i + a]) / 65535));
    }
    return { sample, pose, viewpoint: this.data.scans[index].viewpoint };
  }

  /** Takes over what is visible and in which colours; says how many points that is. */
  show(state, colourOf) {
    const frame = this.frameOf(state);
    const changed = this.frame?.key !== frame.key;
    this.frame = frame;
    let points = 0;
    for (const cloud of this.clouds) {
      const { index, packed, pose } = cloud.userData;
      cloud.visible = state.visible(index);
      if (!cloud.visible) continue;
      points += packed.count;
      const solo = state.solo === index && !this.data.scans[index].placed;
      cloud.matrix.copy(this.toView(solo ? IDENTITY : pose)).multiply(boxMatrix(packed));
      const uniforms = cloud.material.uniforms;
      uniforms.uColor.value.set(...colourOf(index));
      uniforms.uMode.value = state.colour === 'original' && packed.rgb ? 1 : state.colour === 'residual' && packed.residual ? 2 : 0;
    }
    this.drawMarks(state);
    if (changed) this.fit();
    this.draw();
    return points;
  }

  /** A pose in the frame that is drawn: the model's centre is the origin, so that single precision suffices. */
  toView(pose) {
    const matrix = new Matrix4().set(...pose.flat());
    const [x, y, z] = this.frame.centre;
    return new Matrix4().makeTranslation(-x, -y, -z).multiply(matrix);
  }

  /** Where the sensors stood (an octahedron each), and who joined whom (lines). */
  drawMarks(state) {
    this.marks.clear();
    if (!this.options.markers || state.component === null) return;
    const place = (i) => new Vector3(...this.data.scans[i].viewpoint).applyMatrix4(this.toView(this.clouds[i].userData.pose));
    const [positions, colours] = [[], []];
    const line = (a, b, colour) => { positions.push(...a.toArray(), ...b.toArray()); colours.push(...colour, ...colour); };
    const size = 0.018 * this.frame.radius;
    const tips = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]].map((t) => new Vector3(...t).multiplyScalar(size));
    for (const cloud of this.clouds) {
      const { index } = cloud.userData;
      const placed = this.data.scans[index].placed;
      if (!placed || !cloud.visible) continue;
      const at = place(index);
      for (let i = 0; i < 6; i++) for (let j = i + 1; j < 6; j++) {
        if (i >> 1 !== j >> 1) line(at.clone().add(tips[i]), at.clone().add(tips[j]), scanColour(index));
      }
      if (placed.parent !== null && this.clouds[placed.parent].visible) line(at, place(placed.parent), [0.5, 0.5, 0.5]);
    }
    const geometry = new BufferGeometry();
    geometry.setAttribute('position', new Float32BufferAttribute(positions, 3));
    geometry.setAttribute('color', new Float32BufferAttribute(colours, 3));
    this.marks.add(new LineSegments(geometry, new LineBasicMaterial({ vertexColors: true })));
  }

  /**
   * True where scans seem to be in the frames of their sensors, so that showing these says something:
   * all is ahead of a camera or around a scanner, or the file says where it stood.
   */
  sensorsKnown() {
    const scans = (this.data.components[0]?.scans ?? []).map((i) => this.sampleOf(i));
    const known = scans.filter(({ sample, viewpoint }) => {
      const ahead = directionOf(sample.map((p) => p.map((v, a) => v - viewpoint[a])));
      return viewpoint.some((v) => v !== 0) || ahead[2] > 0.7 * Math.hypot(...ahead) || Math.hypot(...ahead) < 0.6;
    });
    return scans.length > 0 && known.length >= 0.7 * scans.length;
  }

  /** Height along up beyond which nothing is drawn. */
  cutHeight() {
    const { low, high } = this.frame;
    return this.options.cut >= 1 ? Infinity : low + this.options.cut * (high - low);
  }

  /** The scan that is drawn at a place of the canvas, in its CSS pixels from above left; or null. */
  pick(x, y) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    this.orbit.place(this.camera);
    const clipFromView = new Matrix4().multiplyMatrices(this.camera.projectionMatrix, this.camera.matrixWorldInverse);
    const [up, cut] = [this.frame.up, this.cutHeight()];
    const pixel = (2 * Math.tan((Math.PI / 360) * this.camera.fov)) / height;
    // Device pixels for each pixel of the page: points are drawn as discs of so many of the former.
    const ratio = this.size[1] / height;
    // What a disc covers is seen there, the nearest in front; near what nothing covers the likeliest is chosen.
    let best = { covers: false, cost: Infinity, index: null };
    for (const cloud of this.clouds.filter((c) => c.visible)) {
      const { index, packed, spacing } = cloud.userData;
      const across = (this.options.size * spacing * ratio) / pixel;
      const m = new Matrix4().multiplyMatrices(clipFromView, cloud.matrix).elements;
      const w = cloud.matrix.elements;
      const [ux, uy, uz, u0] = [0, 4, 8, 12].map((c) => up[0] * w[c] + up[1] * w[c + 1] + up[2] * w[c + 2]);
      for (let i = 0; i < 3 * packed.count; i += 3) {
        const [px, py, pz] = [packed.xyz[i] / 65535, packed.xyz[i + 1] / 65535, packed.xyz[i + 2] / 65535];
        const depth = m[3] * px + m[7] * py + m[11] * pz + m[15];
        if (depth <= this.camera.near) continue;
        const dx = (0.5 + (0.5 * (m[0] * px + m[4] * py + m[8] * pz + m[12])) / depth) * width - x;
        const dy = (0.5 - (0.5 * (m[1] * px + m[5] * py + m[9] * pz + m[13])) / depth) * height - y;
        const aside = Math.hypot(dx, dy);
        if (aside > Math.max(REACH_PX, 12 / ratio) || ux * px + uy * py + uz * pz + u0 > cut) continue;
        const covers = aside <= Math.min(Math.max(across / depth, 1.5), 24) / (2 * ratio);
        const cost = covers ? depth : depth * (1 + ASIDE * aside * pixel);
        if (covers > best.covers || (covers === best.covers && cost < best.cost)) best = { covers, cost, index };
      }
    }
    return best.index;
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    this.renderer.setPixelRatio(ratio);
    this.renderer.setSize(width, height, false);
    this.size = [Math.round(width * ratio), Math.round(height * ratio)];
    this.camera.aspect = width / height;
    if (this.orbit.fitted) this.fit();
    this.draw();
  }

  fit() {
    this.orbit.fit();
  }

  /** Draws all points with the next frame of the display. */
  draw() {
    this.moving.full = true;
    this.schedule();
  }

  /** Draws while the view is being turned: with fewer points where all of them take too long. */
  move() {
    const { moving } = this;
    clearTimeout(moving.timer);
    moving.timer = setTimeout(() => this.draw(), 180);
    this.schedule();
  }

  schedule() {
    this.settled = false;
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame((now) => {
      const { moving } = this;
      this.pending = false;
      const took = now - moving.last;
      if (took > 45 && took < 5000) moving.share = Math.max(0.05, 0.6 * moving.share);
      else if (took < 22) moving.share = Math.min(1, 1.15 * moving.share);
      moving.last = moving.full ? -Infinity : now;
      this.settled = moving.full;
      this.render(moving.full ? 1 : moving.share);
      moving.full = false;
    });
  }

  /** Turns the model for a while as a hand would; frames a second. */
  async spin(milliseconds) {
    const [start, before] = [performance.now(), this.drawn];
    while (performance.now() - start < milliseconds) {
      this.orbit.turn(0.02, 0);
      await new Promise((done) => requestAnimationFrame(done));
    }
    return (1000 * (this.drawn - before)) / (performance.now() - start);
  }

  /** Turns the model once in so many frames, each drawn to its end; milliseconds of each. */
  async measure(frames, share) {
    const pixel = new Uint8Array(4);
    const gl = this.renderer.getContext();
    const times = [];
    for (let i = 0; i < frames; i++) {
      const start = performance.now();
      this.orbit.azimuth += (2 * Math.PI) / frames;
      this.render(share);
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
      times.push(performance.now() - start);
      await new Promise((done) => setTimeout(done));
    }
    return times;
  }

  render(share = 1) {
    const { target, material, scene, camera } = this.screen;
    // Where drawing is slow, a view that is being turned has fewer pixels and no shading.
    const coarse = share < COARSE;
    target.setSize(...this.size.map((s) => Math.ceil(coarse ? s / 2 : s)));
    this.orbit.place(this.camera);
    this.drawn += 1;
    const height = target.height;
    const scale = height / (2 * Math.tan((Math.PI / 360) * this.camera.fov));
    const cut = Math.min(1e9, this.cutHeight());
    for (const cloud of this.clouds) {
      if (!cloud.visible) continue;
      const { uniforms } = cloud.material;
      cloud.geometry.setDrawRange(0, Math.ceil(share * cloud.userData.packed.count));
      uniforms.uSize.value = (this.options.size * cloud.userData.spacing) / Math.sqrt(Math.max(share, 0.15));
      uniforms.uScale.value = scale;
      uniforms.uCut.value = cut;
      uniforms.uUp.value.set(...this.frame.up);
    }
    Object.assign(material.uniforms.uStep.value, { x: 1.4 / target.width, y: 1.4 / height });
    material.uniforms.uNear.value = this.camera.near;
    material.uniforms.uFar.value = this.camera.far;
    material.uniforms.uStrength.value = this.options.shading && !coarse ? 45 : 0;
    this.renderer.setRenderTarget(target);
    this.renderer.setClearColor(0x000000, 0);
    this.renderer.render(this.scene, this.camera);
    this.renderer.setRenderTarget(null);
    this.renderer.render(scene, camera);
  }
}

/** From the unit box of 16-bit positions to the scan's frame. */
function boxMatrix({ low, size }) {
  return new Matrix4().set(size[0], 0, 0, low[0], 0, size[1], 0, low[1], 0, 0, size[2], low[2], 0, 0, 0, 1);
}

function residualRamp() {
  const values = new Uint8Array(4 * 256);
  for (let i = 0; i < 256; i++) values.set([...ramp('error', i / 255).map((v) => Math.round(255 * v)), 255], 4 * i);
  const texture = new DataTexture(values, 256, 1, RGBAFormat);
  [texture.minFilter, texture.magFilter, texture.needsUpdate] = [LinearFilter, LinearFilter, true];
  return texture;
}
