// The cloud in plan or in three dimensions, with a canvas over it for drawings.
//
// While the camera moves, a frame shows as many points as can be drawn in time, coarse levels first.
// When it rests, the other points are added over the next frames, without clearing.

import { el, themeColour } from "../dom.js";
import { Color, Scene, Vector3, WebGLRenderer } from "../vendor.js";
import { FIELD_OF_VIEW_DEG, camerasOf } from "./cameras.js";
import { modeNumber, pointMaterial } from "./material.js";
import { Ruler } from "./ruler.js";
import { COARSEST_PX, Tiles } from "./tiles.js";

const FRAME_MS = { slow: 45, fast: 22 };
const BUDGET = { least: 20_000, first: 600_000, atRest: 150_000 };
const REST_MS = 150;

export class CloudView {
  constructor(stem, about, options = {}) {
    this.about = about;
    this.canvas = el("canvas", { tabIndex: 0, "aria-label": "Map of the cloud: drag to move, wheel to zoom, right button to turn in 3D" });
    this.over = el("canvas", { className: "over" });
    this.element = el("div", { className: "view" }, this.canvas, this.over);
    this.ruler = new Ruler(this);
    this.scene = new Scene();
    this.scene.matrixWorldAutoUpdate = false;
    this.material = pointMaterial();
    this.renderer = new WebGLRenderer({ canvas: this.canvas, antialias: false, preserveDrawingBuffer: true, powerPreference: "high-performance" });
    this.renderer.autoClear = false;
    this.tiles = new Tiles(stem, about, this.scene, this.material, () => this.draw());
    this.tiles.onerror = options.onerror;
    this.ondraw = options.ondraw ?? (() => {});
    Object.assign(this, { budget: BUDGET.first, stats: { frames: [], points: 0 } });
    Object.assign(this, camerasOf(about.tiles, this.canvas, () => this.moved()));
    this.setMode("plan");
    this.resizing = new ResizeObserver(() => this.resize());
    this.resizing.observe(this.element);
    this.themed = () => this.draw();
    addEventListener("themechange", this.themed);
  }

  setMode(mode) {
    const before = this.control;
    this.mode = mode;
    for (const [name, controls] of Object.entries(this.controls)) controls.enabled = name === mode;
    if (before && before !== this.control) this.lookFrom(before);
    this.draw();
  }

  get camera() { return this.cameras[this.mode]; }
  get control() { return this.controls[this.mode]; }

  // The new mode looks at the same place, about as near.
  lookFrom(before) {
    const { target } = before;
    if (this.mode === "plan") this.centre(target.x, target.y);
    else {
      const shift = target.clone().sub(this.control.target).setZ(0);
      this.control.target.add(shift);
      this.camera.position.add(shift);
      const wide = this.size[1] / this.cameras.plan.zoom;
      const away = wide / (2 * Math.tan((FIELD_OF_VIEW_DEG * Math.PI) / 360));
      const ray = this.camera.position.clone().sub(this.control.target).setLength(Math.max(away, 3));
      this.camera.position.copy(this.control.target).add(ray);
      this.control.update();
    }
  }

  centre(x, y, metresAcross = null) {
    const { camera, control } = this;
    const shift = new Vector3(x - control.target.x, y - control.target.y, 0);
    control.target.add(shift);
    camera.position.add(shift);
    if (metresAcross && this.mode === "plan") {
      camera.zoom = this.size[0] / metresAcross;
      camera.updateProjectionMatrix();
    }
    control.update();
    this.moved();
  }

  // Moves and zooms by keys; whether the key meant that.
  onKey({ key, shiftKey }) {
    const step = (shiftKey ? 0.4 : 0.1) * this.size[1];
    const pan = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] }[key];
    if (pan) this.pan(...pan);
    else if (key === "+" || key === "=") this.zoomBy(1.3);
    else if (key === "-") this.zoomBy(1 / 1.3);
    else return false;
    return true;
  }

  // Move by pixels, to the right and up as the window shows them.
  pan(right, up) {
    const { camera, control } = this;
    const away = camera.position.distanceTo(control.target);
    const scale = this.mode === "plan" ? 1 / camera.zoom : (away * 2 * Math.tan((FIELD_OF_VIEW_DEG * Math.PI) / 360)) / this.size[1];
    const side = new Vector3().setFromMatrixColumn(camera.matrixWorld, 0);
    const ahead = new Vector3(-side.y, side.x, 0);
    const shift = side.multiplyScalar(right * scale).add(ahead.multiplyScalar(up * scale));
    control.target.add(shift);
    camera.position.add(shift);
    control.update();
    this.moved();
  }

  zoomBy(factor) {
    const { camera, control } = this;
    if (this.mode === "plan") {
      camera.zoom *= factor;
      camera.updateProjectionMatrix();
    } else camera.position.sub(control.target).divideScalar(factor).add(control.target);
    control.update();
    this.moved();
  }

  setColour(name) {
    this.material.uniforms.u_mode.value = modeNumber(name);
    this.draw();
  }

  setPointSize(metres) {
    this.material.uniforms.u_size.value = metres;
    this.draw();
  }

  // All points, as far as memory allows, or as many as the window can show.
  setAll(all) {
    this.tiles.coarsestPx = all ? 0 : COARSEST_PX;
    this.draw();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (!width || !height) return;
    const first = !this.size;
    this.size = [width, height];
    const ratio = Math.min(devicePixelRatio, 2);
    this.renderer.setPixelRatio(ratio);
    this.renderer.setSize(width, height, false);
    [this.over.width, this.over.height] = [width * ratio, height * ratio];
    const { plan, "3d": space } = this.cameras;
    Object.assign(plan, { left: -width / 2, right: width / 2, top: height / 2, bottom: -height / 2 });
    if (first) {
      const { low, high } = this.box;
      plan.zoom = 0.94 * Math.min(width / Math.max(high[0] - low[0], 1), height / Math.max(high[1] - low[1], 1));
    }
    plan.updateProjectionMatrix();
    space.aspect = width / height;
    space.updateProjectionMatrix();
    this.moved();
  }

  moved() {
    this.movedAt = performance.now();
    this.inMotion = true;
    this.draw();
  }

  // Begin a frame anew; further calls before it is drawn cost nothing.
  draw() {
    this.restart = true;
    this.request();
  }

  // Only what is drawn over the cloud has changed.
  redraw() {
    this.overOnly = true;
    this.request();
  }

  request() {
    if (this.requested || this.closed || !this.size) return;
    this.requested = requestAnimationFrame((now) => { this.requested = 0; this.frame(now); });
  }

  pixelsPerMetre(bounds) {
    if (this.mode === "plan") return this.camera.zoom;
    const distance = Math.max(bounds.distanceToPoint(this.camera.position), 1);
    return this.size[1] / (2 * Math.tan((FIELD_OF_VIEW_DEG * Math.PI) / 360) * distance);
  }

  frame(now) {
    if (this.isDrawing(now)) {
      if (this.overOnly && !this.restart) this.drawOver();
      this.overOnly = false;
      return this.request();
    }
    const moving = this.inMotion || now - (this.movedAt ?? 0) < REST_MS;
    this.inMotion = false;
    if (this.restart) this.begin();
    if (this.pending?.length) this.slice(now, moving);
    if (this.overOnly || this.began) this.drawOver();
    this.overOnly = this.began = false;
    if (this.pending?.length || moving) this.request();
  }

  // Whether the last slice is still being drawn. Nothing is begun before it is on the screen: frames that
  // queue up come late, and what one takes would not be known.
  isDrawing(now) {
    if (!this.drawing) return false;
    const gl = this.renderer.getContext();
    if (gl.clientWaitSync(this.drawing.fence, 0, 0) === gl.TIMEOUT_EXPIRED) return true;
    gl.deleteSync(this.drawing.fence);
    if (this.drawing.moving) this.adapt(now - this.drawing.began);
    this.drawing = null;
    return false;
  }

  begin() {
    this.restart = false;
    this.began = true;
    this.camera.updateMatrixWorld();
    const wanted = this.tiles.update(this.camera, (bounds) => this.pixelsPerMetre(bounds));
    this.pending = wanted.map((points) => ({ points, start: 0 }));
    const ratio = this.renderer.getPixelRatio();
    const { uniforms } = this.material;
    uniforms.u_scale.value = ratio * (this.mode === "plan" ? this.camera.zoom : this.size[1] / (2 * Math.tan((FIELD_OF_VIEW_DEG * Math.PI) / 360)));
    uniforms.u_least.value = 2 * ratio;
    uniforms.u_most.value = 5 * ratio;
    this.renderer.setClearColor(new Color(themeColour("canvas")), 1);
    this.renderer.clear();
    this.stats.points = 0;
    this.stats.wanted = wanted.reduce((sum, points) => sum + points.userData.count, 0);
  }

  // Draw the next points of the frame, as many as fit: of the last chunk only a part.
  slice(began, moving) {
    let room = moving ? this.budget : Math.max(this.budget, BUDGET.atRest);
    const shown = [];
    while (this.pending.length && room > 0) {
      const part = this.pending[0];
      const count = Math.min(part.points.userData.count - part.start, Math.ceil(room));
      part.points.geometry.setDrawRange(part.start, count);
      part.points.visible = true;
      shown.push(part.points);
      part.start += count;
      if (part.start === part.points.userData.count) this.pending.shift();
      this.stats.points += count;
      room -= count;
    }
    this.renderer.render(this.scene, this.camera);
    for (const points of shown) points.visible = false;
    const gl = this.renderer.getContext();
    this.drawing = { began, moving, fence: gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0) };
    gl.flush();
  }

  // More points in a frame where frames come fast, fewer where they come late.
  adapt(took) {
    this.stats.frames.push(took);
    if (this.stats.frames.length > 600) this.stats.frames.shift();
    if (took > FRAME_MS.slow) this.budget = Math.max(BUDGET.least, 0.7 * this.budget);
    else if (took < FRAME_MS.fast) this.budget = Math.min(this.tiles.mostPoints, 1.15 * this.budget);
  }

  get settled() {
    return !this.requested && !this.restart && this.tiles.complete && !this.tiles.fetching.size;
  }

  drawOver() {
    const context = this.over.getContext("2d");
    const ratio = this.renderer.getPixelRatio();
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, ...this.size);
    this.ondraw(context, this);
    this.ruler.draw(context);
  }

  // Pixel of a place; null behind the camera.
  project(x, y, z = 0) {
    if (this.mode === "plan") {
      const { position, zoom } = this.camera;
      return [this.size[0] / 2 + (x - position.x) * zoom, this.size[1] / 2 - (y - position.y) * zoom];
    }
    const place = new Vector3(x, y, z).applyMatrix4(this.camera.matrixWorldInverse);
    if (place.z > -0.1) return null;
    place.applyMatrix4(this.camera.projectionMatrix);
    return [((place.x + 1) / 2) * this.size[0], ((1 - place.y) / 2) * this.size[1]];
  }

  // Place under a pixel of the plan.
  unproject(px, py) {
    const { position, zoom } = this.cameras.plan;
    return [position.x + (px - this.size[0] / 2) / zoom, position.y - (py - this.size[1] / 2) / zoom];
  }

  get metresPerPixel() { return 1 / this.cameras.plan.zoom; }

  close() {
    this.closed = true;
    cancelAnimationFrame(this.requested);
    removeEventListener("themechange", this.themed);
    this.resizing.disconnect();
    for (const controls of Object.values(this.controls)) controls.dispose();
    this.tiles.close();
    this.material.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }
}
