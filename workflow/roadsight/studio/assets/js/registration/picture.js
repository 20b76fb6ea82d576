// The image with the cloud projected over it, and what the mouse does there.

import { el, themeColour } from "../dom.js";
import { fieldOfView, projector } from "./camera.js";

const PICK_PX = 14;
const CLICK_PX = 4;
const FAR_M = 150;
const RAMP = [[70, 150, 255], [40, 190, 220], [63, 182, 122], [198, 216, 74], [242, 160, 61], [217, 66, 58]];
export const LAYERS = { points: "Cloud", edges: "Cloud's edges", pixels: "Image's edges" };
export const SIDES = { left: "#ff8a3d", right: "#35c4ff" };
export const PIXELS = { lane: "#ffe14d", border: "#ff5ad1" };

export class Picture {
  // page: pose, turn(changes), pairs, addPair(pair), mode.
  constructor(page) {
    this.page = page;
    this.canvas = el("canvas", { tabIndex: 0, "aria-label": "Image with the cloud over it" });
    this.element = el("div", { className: "view" }, this.canvas);
    this.shown = { points: true, edges: true, pixels: true };
    this.zoom = 1;
    this.shift = [0, 0];
    for (const [name, listener] of Object.entries({ pointerdown: "down", pointermove: "move", pointerup: "up" })) {
      this.canvas.addEventListener(name, (event) => this[listener](event));
    }
    this.canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    this.watching = new ResizeObserver(() => this.draw());
    this.watching.observe(this.element);
  }

  show(content, bitmap, points) {
    this.bitmap?.close?.();
    Object.assign(this, { content, bitmap, points });
    if (!this.content || this.of !== content.size.join()) [this.zoom, this.shift] = [1, [0, 0]];
    this.of = content.size.join();
    this.draw();
  }

  // Scale from image to window, and where the image's corner is.
  get fit() {
    const [width, height] = this.content.size;
    const { clientWidth, clientHeight } = this.element;
    const scale = this.zoom * Math.min(clientWidth / width, clientHeight / height);
    return { scale, left: (clientWidth - scale * width) / 2 + this.shift[0], top: (clientHeight - scale * height) / 2 + this.shift[1] };
  }

  toImage(event) {
    const { left, top } = this.canvas.getBoundingClientRect();
    const fit = this.fit;
    return [(event.clientX - left - fit.left) / fit.scale - 0.5, (event.clientY - top - fit.top) / fit.scale - 0.5];
  }

  draw() {
    if (this.requested) return;
    this.requested = requestAnimationFrame(() => { this.requested = 0; this.paint(); });
  }

  paint() {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (!width || !this.content) return;
    const ratio = Math.min(devicePixelRatio, 2);
    if (this.canvas.width !== width * ratio) this.canvas.width = width * ratio;
    if (this.canvas.height !== height * ratio) this.canvas.height = height * ratio;
    const context = this.canvas.getContext("2d");
    const fit = this.fit;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.fillStyle = themeColour("canvas");
    context.fillRect(0, 0, width, height);
    context.imageSmoothingEnabled = fit.scale < 3;
    if (this.bitmap) context.drawImage(this.bitmap, fit.left, fit.top, fit.scale * this.content.size[0], fit.scale * this.content.size[1]);
    const at = ([u, v]) => [fit.left + (u + 0.5) * fit.scale, fit.top + (v + 0.5) * fit.scale];
    const project = projector(this.page.pose, this.content.centre);
    if (this.shown.points) this.paintPoints(context, project, at, [width, height]);
    if (this.shown.pixels) this.paintPixels(context, at);
    if (this.shown.edges) for (const side of Object.keys(SIDES)) this.paintEdges(context, project, at, side);
    this.paintPairs(context, project, at);
    this.paintCross(context);
  }

  paintPoints(context, project, at, [width, height]) {
    const { points } = this;
    this.picked = [];
    for (let i = 0; i < points.length; i += 4) {
      const seen = project(points[i], points[i + 1], points[i + 2]);
      if (!seen || seen[2] > FAR_M) continue;
      const [u, v] = at(seen);
      if (u < 0 || v < 0 || u > width || v > height) continue;
      this.picked.push(i, u, v, seen[2]);
      const share = Math.max(0, Math.min(0.999, points[i + 3] / 10)) * (RAMP.length - 1);
      const [low, part] = [Math.floor(share), share % 1];
      const [r, g, b] = RAMP[low].map((value, k) => Math.round(value + part * (RAMP[low + 1][k] - value)));
      context.fillStyle = `rgba(${r},${g},${b},0.75)`;
      const size = seen[2] < 15 ? 2.4 : 1.5;
      context.fillRect(u - size / 2, v - size / 2, size, size);
    }
  }

  paintPixels(context, at) {
    for (const [name, flat] of Object.entries(this.content.pixels)) {
      context.fillStyle = PIXELS[name.split("_")[0]];
      for (let i = 0; i < flat.length; i += 2) {
        const [u, v] = at([flat[i], flat[i + 1]]);
        context.fillRect(u - 1.5, v - 1.5, 3, 3);
      }
    }
  }

  paintEdges(context, project, at, side) {
    const flat = this.content[side];
    const places = [];
    for (let i = 0; i < flat.length; i += 3) {
      const seen = project(flat[i], flat[i + 1], flat[i + 2]);
      if (seen) places.push(at(seen));
    }
    for (const [colour, size] of [["#000c", 6], [SIDES[side], 4]]) {
      context.fillStyle = colour;
      for (const [u, v] of places) context.fillRect(u - size / 2, v - size / 2, size, size);
    }
  }

  paintPairs(context, project, at) {
    const mark = ([u, v], colour, size) => {
      context.strokeStyle = colour;
      context.lineWidth = 2;
      context.beginPath();
      context.moveTo(u - size, v); context.lineTo(u + size, v);
      context.moveTo(u, v - size); context.lineTo(u, v + size);
      context.stroke();
    };
    const half = this.page.half;
    for (const pair of [...this.page.pairs, ...(half ? [half] : [])]) {
      const seen = project(pair.x, pair.y, pair.z);
      if (seen) { context.strokeStyle = "#00e676"; context.lineWidth = 2; context.beginPath(); context.arc(...at(seen), 7, 0, 7); context.stroke(); }
      if (pair.u === undefined) continue;
      mark(at([pair.u, pair.v]), "#00e676", 8);
      if (seen) { context.beginPath(); context.moveTo(...at(seen)); context.lineTo(...at([pair.u, pair.v])); context.stroke(); }
    }
  }

  // The cross that keys move, for pairs without a mouse.
  nudge(right, down) {
    const { clientWidth: width, clientHeight: height } = this.element;
    const [x, y] = this.cross ?? [width / 2, height / 2];
    this.cross = [Math.max(0, Math.min(width, x + right)), Math.max(0, Math.min(height, y + down))];
    this.draw();
  }

  // A click where the cross is.
  clickCross() {
    this.nudge(0, 0);
    const { left, top } = this.canvas.getBoundingClientRect();
    const at = { clientX: left + this.cross[0], clientY: top + this.cross[1] };
    this.page.clicked(this.toImage(at), this.pick(at));
  }

  paintCross(context) {
    if (!this.cross || this.page.mode !== "pairs") return;
    const [x, y] = this.cross;
    for (const [colour, width] of [["#000", 4], ["#fff", 2]]) {
      context.strokeStyle = colour;
      context.lineWidth = width;
      context.beginPath();
      context.moveTo(x - 16, y); context.lineTo(x - 4, y); context.moveTo(x + 4, y); context.lineTo(x + 16, y);
      context.moveTo(x, y - 16); context.lineTo(x, y - 4); context.moveTo(x, y + 4); context.lineTo(x, y + 16);
      context.stroke();
    }
  }

  // Nearest point of the cloud (or of its edges) under the mouse, near ones first.
  pick(event) {
    const { left, top } = this.canvas.getBoundingClientRect();
    const [x, y] = [event.clientX - left, event.clientY - top];
    const best = { score: Infinity };
    for (let k = 0; k < (this.picked?.length ?? 0); k += 4) {
      const [i, u, v, depth] = this.picked.slice(k, k + 4);
      const away = Math.hypot(u - x, v - y);
      if (away <= PICK_PX && away + 0.05 * depth < best.score) Object.assign(best, { score: away + 0.05 * depth, place: [...this.points.slice(i, i + 3)] });
    }
    return best.place ?? null;
  }

  down(event) {
    if (event.button !== 0) return;
    this.canvas.focus({ preventScroll: true });
    this.canvas.setPointerCapture(event.pointerId);
    this.held = { x: event.clientX, y: event.clientY, from: [event.clientX, event.clientY], moved: false, step: Symbol("drag") };
  }

  move(event) {
    const { held } = this;
    if (!held) return;
    const [dx, dy] = [event.clientX - held.x, event.clientY - held.y];
    [held.x, held.y] = [event.clientX, event.clientY];
    held.moved ||= Math.hypot(event.clientX - held.from[0], event.clientY - held.from[1]) > CLICK_PX;
    if (held.moved) this.drag(dx, dy, event.shiftKey, held.step);
  }

  drag(dx, dy, shift, step) {
    const { mode, pose } = this.page;
    const degrees = fieldOfView(pose.focal_px, this.content.size[0]) / (this.content.size[0] * this.fit.scale);
    if (mode === "turn") this.page.turn(shift ? { roll: -0.1 * dx } : { heading: -dx * degrees, pitch: dy * degrees }, step);
    else if (mode === "move") this.page.turn(shift ? { ahead: -0.05 * dy } : { right: -0.01 * dx, up: 0.01 * dy }, step);
    else if (mode === "lens") this.page.turn({ focal: 1.002 ** -dy }, step);
    else { this.shift = [this.shift[0] + dx, this.shift[1] + dy]; this.draw(); }
  }

  up(event) {
    const { held } = this;
    this.held = null;
    if (held && !held.moved && this.page.mode === "pairs") this.page.clicked(this.toImage(event), this.pick(event));
  }

  wheel(event) {
    event.preventDefault();
    const factor = 1.0015 ** -event.deltaY;
    if (this.page.mode === "lens") return this.page.turn({ focal: factor ** 0.3 }, "wheel");
    const before = this.toImage(event);
    this.zoom = Math.max(1, Math.min(30, this.zoom * factor));
    const after = this.toImage(event);
    const { scale } = this.fit;
    this.shift = this.zoom === 1 ? [0, 0] : this.shift.map((value, k) => value + (after[k] - before[k]) * scale);
    this.draw();
  }

  close() {
    this.watching.disconnect();
    this.bitmap?.close?.();
  }
}
