// Drawing with mouse and keys: what is chosen, which tool is held, and how that changes the drawing.

import { LAYERS, itemsOf, nearestOnLine, newItem, pointsOf, setPoint, snapped } from "./shapes.js";

const HANDLE_PX = 9;
const LINE_PX = 7;
const SNAP_PX = 14;
const CLICK_PX = 4;
const LAYER_OF_TOOL = Object.fromEntries(Object.entries(LAYERS).map(([layer, { tool }]) => [tool, layer]));
const TOOL_KEYS = { v: "select", e: "edge", z: "zone", m: "mount", a: "add", r: "remove" };

export class Editor {
  // references(layer): what points of a layer snap to. edgeNear(place): promise of an edge that the
  // cloud shows there. ontool, onchoose: called on a change.
  constructor(view, history, { references, edgeNear, ontool, onchoose }) {
    Object.assign(this, { view, history, references, edgeNear, ontool, onchoose });
    Object.assign(this, { tool: "select", chosen: null, drawing: false, snap: true, hover: null });
    const on = (name, listener) => view.element.addEventListener(name, listener, { capture: true });
    on("pointerdown", (event) => this.down(event));
    on("pointermove", (event) => this.move(event));
    on("pointerup", (event) => this.up(event));
    on("dblclick", (event) => this.double(event));
    history.listeners.add(() => this.check());
  }

  get now() { return this.history.now; }

  setTool(tool) {
    this.finish();
    this.tool = tool;
    this.view.canvas.style.cursor = tool === "select" ? "" : "crosshair";
    this.ontool(tool);
    this.view.redraw();
  }

  choose(chosen) {
    this.chosen = chosen;
    this.onchoose();
    this.view.redraw();
  }

  // What was chosen may have gone by undoing.
  check() {
    if (this.chosen) {
      const item = itemsOf(this.now, this.chosen.layer)[this.chosen.item];
      const points = item && pointsOf(item, this.chosen.layer);
      if (!points) [this.chosen, this.drawing] = [null, false];
      else if (this.chosen.vertex !== null) this.chosen.vertex = Math.min(this.chosen.vertex, points.length - 1);
    }
    this.view.redraw();
  }

  at(event) {
    const box = this.view.element.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  // Place of a pixel, on what the workflow found if that is near.
  place(pixel, layer, exact = false) {
    const place = this.view.unproject(...pixel);
    if (!this.snap || exact) return place;
    return snapped(place, this.references(layer), SNAP_PX * this.view.metresPerPixel) ?? place;
  }

  // Move a road edge's new point onto an edge of the cloud itself, where nothing else was near.
  async refine(pixel, exact, { layer, item, vertex }, step) {
    const put = pointsOf(itemsOf(this.now, layer)[item], layer)[vertex].join();
    if (layer !== "edges" || !this.snap || exact || this.snappedAt(pixel, layer)) return;
    const found = await this.edgeNear(this.view.unproject(...pixel));
    const points = itemsOf(this.now, layer)[item] && pointsOf(itemsOf(this.now, layer)[item], layer);
    if (found && points?.[vertex]?.join() === put) {
      this.history.change((drawing) => setPoint(itemsOf(drawing, layer)[item], layer, vertex, found), step);
      this.refined = found;
    }
  }

  snappedAt(pixel, layer) {
    return snapped(this.view.unproject(...pixel), this.references(layer), SNAP_PX * this.view.metresPerPixel) !== null;
  }

  // Handle or line under a pixel.
  hit([px, py]) {
    const [x, y] = this.view.unproject(px, py);
    const reach = this.view.metresPerPixel;
    const best = { distance: HANDLE_PX * reach };
    for (const layer of Object.keys(LAYERS)) {
      itemsOf(this.now, layer).forEach((item, number) => pointsOf(item, layer).forEach(([a, b], vertex) => {
        const distance = Math.hypot(a - x, b - y);
        if (distance < best.distance) Object.assign(best, { distance, layer, item: number, vertex });
      }));
    }
    if (best.layer) return best;
    const line = { distance: LINE_PX * reach };
    for (const layer of Object.keys(LAYERS)) {
      itemsOf(this.now, layer).forEach((item, number) => {
        const before = line.distance;
        const points = pointsOf(item, layer);
        nearestOnLine((LAYERS[layer].closed ? [...points, points[0]] : points).flat(), 2, x, y, line);
        if (line.distance < before) Object.assign(line, { layer, item: number, vertex: null });
      });
    }
    return line.layer ? line : null;
  }

  down(event) {
    if (event.target !== this.view.canvas || event.button !== 0 || this.view.mode !== "plan" || this.view.ruler.active) return;
    this.view.canvas.focus({ preventScroll: true });
    const pixel = this.at(event);
    this.pressed = { pixel, moved: false, handle: null };
    const hit = this.tool === "select" ? this.hit(pixel) : null;
    if (!hit) return;
    this.choose({ layer: hit.layer, item: hit.item, vertex: hit.vertex });
    if (hit.vertex === null) return;
    this.pressed.handle = hit;
    this.pressed.step = Symbol("drag");
    event.stopPropagation();
    this.view.element.setPointerCapture(event.pointerId);
  }

  move(event) {
    if (this.view.mode !== "plan") return;
    const pixel = this.at(event);
    this.hover = event.target === this.view.canvas || this.pressed?.handle ? pixel : null;
    this.view.redraw();
    const { pressed } = this;
    if (!pressed) return;
    pressed.moved ||= Math.hypot(pixel[0] - pressed.pixel[0], pixel[1] - pressed.pixel[1]) > CLICK_PX;
    if (!pressed.handle || !pressed.moved) return;
    event.stopPropagation();
    const { layer, item, vertex } = pressed.handle;
    const to = this.place(pixel, layer, event.altKey);
    this.history.change((drawing) => setPoint(itemsOf(drawing, layer)[item], layer, vertex, to), pressed.step);
  }

  up(event) {
    const { pressed } = this;
    this.pressed = null;
    if (!pressed) return;
    if (pressed.handle) event.stopPropagation();
    if (pressed.handle?.vertex >= 0 && pressed.moved) this.refine(this.at(event), event.altKey, pressed.handle, pressed.step);
    if (pressed.handle) return;
    if (!pressed.moved && this.tool !== "select" && event.detail < 2) this.click(pressed.pixel, event.altKey);
    else if (!pressed.moved && this.tool === "select" && !this.hit(pressed.pixel)) this.choose(null);
  }

  double(event) {
    if (event.target !== this.view.canvas || this.view.mode !== "plan" || this.view.ruler.active) return;
    event.stopPropagation();
    if (this.tool !== "select") return this.finish();
    const hit = this.hit(this.at(event));
    if (hit && hit.vertex === null) this.insert(hit.layer, hit.item, hit.segment + 1, hit.place);
  }

  // A point of the tool that is held.
  click(pixel, exact = false) {
    const layer = LAYER_OF_TOOL[this.tool];
    if (!layer) return;
    const place = this.place(pixel, layer, exact);
    const step = Symbol("point");
    if (this.drawing && this.chosen?.layer === layer) {
      const points = pointsOf(itemsOf(this.now, layer)[this.chosen.item], layer);
      this.insert(layer, this.chosen.item, points.length, place, step);
    } else {
      this.history.change((drawing) => itemsOf(drawing, layer).push(newItem(drawing, layer, place)), step);
      this.drawing = layer !== "mounts";
      this.choose({ layer, item: itemsOf(this.now, layer).length - 1, vertex: 0 });
    }
    this.refine(pixel, exact, { ...this.chosen }, step);
  }

  insert(layer, item, vertex, [x, y], step = null) {
    this.history.change((drawing) => {
      const points = pointsOf(itemsOf(drawing, layer)[item], layer);
      points.splice(vertex, 0, [0, 0]);
      setPoint(itemsOf(drawing, layer)[item], layer, vertex, [x, y]);
    }, step);
    this.choose({ layer, item, vertex });
  }

  // End the shape that is being drawn; what has too few points goes.
  finish() {
    if (!this.drawing) return false;
    this.drawing = false;
    const { layer, item } = this.chosen ?? {};
    if (layer && pointsOf(itemsOf(this.now, layer)[item], layer).length < LAYERS[layer].least) this.removeItem(layer, item);
    this.view.redraw();
    return true;
  }

  removeItem(layer, item) {
    this.drawing = false;
    this.chosen = null;
    this.history.change((drawing) => itemsOf(drawing, layer).splice(item, 1));
    this.onchoose();
  }

  removePoint() {
    if (!this.chosen) return;
    const { layer, item, vertex } = this.chosen;
    const count = pointsOf(itemsOf(this.now, layer)[item], layer).length;
    if (vertex === null || count <= LAYERS[layer].least) return this.removeItem(layer, item);
    this.history.change((drawing) => pointsOf(itemsOf(drawing, layer)[item], layer).splice(vertex, 1));
    this.choose({ layer, item, vertex: Math.min(vertex, count - 2) });
  }

  // Insert a point in the middle of the segment behind the chosen one.
  split() {
    if (!this.chosen || this.chosen.layer === "mounts") return;
    const { layer, item } = this.chosen;
    const points = pointsOf(itemsOf(this.now, layer)[item], layer);
    const vertex = Math.min(this.chosen.vertex ?? 0, points.length - (LAYERS[layer].closed ? 1 : 2));
    const [a, b] = [points[vertex], points[(vertex + 1) % points.length]];
    this.insert(layer, item, vertex + 1, [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2]);
  }

  nudge(dx, dy) {
    const { layer, item, vertex } = this.chosen;
    const [x, y] = pointsOf(itemsOf(this.now, layer)[item], layer)[vertex];
    this.history.change((drawing) => setPoint(itemsOf(drawing, layer)[item], layer, vertex, [x + dx, y + dy]), `nudge ${layer} ${item} ${vertex}`);
    this.onchoose();
  }

  nextPoint(step) {
    const { layer, item, vertex } = this.chosen;
    const count = pointsOf(itemsOf(this.now, layer)[item], layer).length;
    this.choose({ layer, item, vertex: ((vertex ?? -1) + step + count) % count });
  }

  // Whether a key meant something here.
  onKey(event) {
    const { key, ctrlKey, metaKey, shiftKey, altKey } = event;
    const letter = key.toLowerCase();
    if (ctrlKey || metaKey) {
      if (letter === "z") return this.history.step(shiftKey ? 1 : -1), true;
      if (letter === "y") return this.history.step(1), true;
      return false;
    }
    if (altKey || this.view.mode !== "plan") return false;
    const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[key];
    if (arrow && this.tool === "select" && Number.isInteger(this.chosen?.vertex)) {
      const step = shiftKey ? 1 : 0.1;
      return this.nudge(arrow[0] * step, arrow[1] * step), true;
    }
    if (TOOL_KEYS[letter]) return this.setTool(TOOL_KEYS[letter]), true;
    if (key === " " && this.tool !== "select") return this.click(this.view.size.map((side) => side / 2)), true;
    if (key === "Enter") return this.finish();
    if (key === "Escape") return this.finish() || (this.tool !== "select" ? this.setTool("select") : this.choose(null)), true;
    if ((key === "Delete" || key === "Backspace") && this.chosen) return this.removePoint(), true;
    if (letter === "i" && this.chosen) return this.split(), true;
    if ((key === "," || key === ".") && this.chosen) return this.nextPoint(key === "," ? -1 : 1), true;
    return false;
  }
}
