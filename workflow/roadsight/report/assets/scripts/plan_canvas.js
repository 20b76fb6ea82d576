// A plan on a canvas: moving, zooming, pointing. Subclasses say what it draws and what lies where:
// paint(), pick(px, py), choose(found or null) and, for other colours, recolour().

const MAP_MARGIN_PX = 34;
const PICK_RADIUS_PX = 11;

class PlanCanvas {
  constructor(canvas, site, state, tooltip) {
    Object.assign(this, { canvas, site, state, tooltip });
    this.context = canvas.getContext("2d");
    this.active = false;
    this.ruler = null;
    this.stage = canvas.parentElement;
    this.listen();
    this.listenTools();
    new ResizeObserver(() => this.resize()).observe(canvas);
  }

  recolour() {
    this.colour = themeColours();
    this.draw();
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas;
    if (clientWidth === 0) return;
    this.ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(clientWidth * this.ratio);
    this.canvas.height = Math.round(clientHeight * this.ratio);
    const fitted = this.width === undefined || this.showsAll;
    this.width = clientWidth;
    this.height = clientHeight;
    if (fitted) this.fit();
    this.draw();
  }

  fit() {
    const { west, south, east, north } = this.site.extent;
    const wide = (this.width - 2 * MAP_MARGIN_PX) / Math.max(east - west, 1);
    const high = (this.height - 2 * MAP_MARGIN_PX) / Math.max(north - south, 1);
    this.scale = Math.min(wide, high);
    this.fitted = this.scale;
    this.centre = [(west + east) / 2, (south + north) / 2];
    this.showsAll = true;
    this.draw();
  }

  toScreen(x, y) {
    return [this.width / 2 + (x - this.centre[0]) * this.scale, this.height / 2 - (y - this.centre[1]) * this.scale];
  }

  toGround(px, py) {
    return [this.centre[0] + (px - this.width / 2) / this.scale, this.centre[1] - (py - this.height / 2) / this.scale];
  }

  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const [x, y] = this.toGround(px, py);
    this.showsAll = false;
    this.scale = Math.min(Math.max(this.scale * factor, this.fitted / 4), Math.max(400, this.fitted));
    this.centre = [x - (px - this.width / 2) / this.scale, y + (py - this.height / 2) / this.scale];
    this.draw();
  }

  move(dx, dy) {
    this.showsAll = false;
    this.centre = [this.centre[0] - dx / this.scale, this.centre[1] + dy / this.scale];
    this.draw();
  }

  draw() {
    if (this.pending || this.width === undefined) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = 0;
      this.paintAll();
    });
  }

  paintAll() {
    this.context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    this.paint();
    this.ruler?.paint(this);
    this.tell(this.pointed ?? this.centre);
  }

  // One finger moves the page, or the map sideways; two fingers move and zoom the map.
  listen() {
    const { canvas } = this;
    const held = new Map();
    let travelled = 0;
    const lift = (event) => {
      held.delete(event.pointerId);
      return held.size === 0 && travelled < 4;
    };
    canvas.addEventListener("pointerdown", (event) => {
      this.active = true;
      if (held.size === 0) travelled = 0;
      held.set(event.pointerId, [event.offsetX, event.offsetY]);
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      const now = [event.offsetX, event.offsetY];
      this.pointed = this.toGround(...now);
      if (!held.has(event.pointerId)) return this.point(event);
      const before = middleAndReach([...held.values()]);
      held.set(event.pointerId, now);
      const after = middleAndReach([...held.values()]);
      const [dx, dy] = [after.x - before.x, after.y - before.y];
      travelled += Math.abs(dx) + Math.abs(dy);
      this.move(dx, dy);
      if (before.reach > 0) this.zoom(after.reach / before.reach, after.x, after.y);
    });
    canvas.addEventListener("pointerup", (event) => {
      if (lift(event)) this.click(event);
    });
    canvas.addEventListener("pointercancel", lift);
    canvas.addEventListener("pointerleave", () => {
      this.active = false;
      this.pointed = null;
      this.tooltip.hide();
    });
    canvas.addEventListener("wheel", (event) => {
      if (!this.active && !event.ctrlKey) return;
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * 0.0015), event.offsetX, event.offsetY);
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  key(event) {
    const step = 60;
    const actions = {
      ArrowLeft: () => this.move(step, 0), ArrowRight: () => this.move(-step, 0),
      ArrowUp: () => this.move(0, step), ArrowDown: () => this.move(0, -step),
      "+": () => this.zoom(1.4), "=": () => this.zoom(1.4), "-": () => this.zoom(1 / 1.4),
      0: () => this.fit(), Escape: () => this.leave(),
    };
    if (!actions[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    actions[event.key]();
  }

  // The buttons beside the map, and the line below it.
  listenTools() {
    const { stage } = this;
    this.status = stage.querySelector("[data-coordinates]");
    this.online = Object.assign(document.createElement("a"), { target: "_blank", rel: "noopener noreferrer", textContent: "Online map" });
    this.status.after(this.online);
    const actions = { in: () => this.zoom(1.4), out: () => this.zoom(1 / 1.4), fit: () => this.fit(), measure: () => this.measure() };
    stage.addEventListener("click", ({ target }) => actions[target.closest("[data-map]")?.dataset.map]?.());
  }

  measure() {
    this.ruler = this.ruler ? null : new Ruler(this.site.place);
    this.stage.querySelector('[data-map="measure"]').setAttribute("aria-pressed", this.ruler !== null);
    this.canvas.focus({ preventScroll: true });
    this.draw();
  }

  // Escape ends a line that is measured, then measuring, then a choice.
  leave() {
    if (!this.ruler) return this.choose(null);
    if (this.ruler.points.length && !this.ruler.ended) this.ruler.ended = true;
    else this.measure();
    this.draw();
  }

  tell([x, y]) {
    if (this.ruler) this.status.textContent = this.ruler.text;
    else this.status.textContent = coordinatesText(this.site.place, x, y);
    const address = onlineMap(this.site.place, ...(this.chosenPlace ?? this.centre));
    this.online.hidden = address === null;
    if (address) this.online.href = address;
  }

  // Centre a place that lies outside the view, and come close enough to tell it from its neighbours.
  reveal({ x, y }, least = 10) {
    const [px, py] = this.toScreen(x, y);
    const inside = px > 40 && py > 40 && px < this.width - 40 && py < this.height - 40;
    if (inside && this.scale > 0.4 * least) return;
    this.showsAll = false;
    this.centre = [x, y];
    this.scale = Math.max(this.scale, least);
    this.draw();
  }

  point(event) {
    if (this.ruler) {
      this.ruler.pointer = this.pointed;
      this.canvas.style.cursor = "crosshair";
      return this.draw();
    }
    this.tell(this.pointed);
    const found = this.pick(event.offsetX, event.offsetY);
    this.canvas.style.cursor = found?.chosen ? "pointer" : "";
    if (found) this.tooltip.show(found.text, event.clientX, event.clientY);
    else this.tooltip.hide();
  }

  click(event) {
    if (this.ruler) {
      this.ruler.add(this.toGround(event.offsetX, event.offsetY));
      return this.draw();
    }
    const found = this.pick(event.offsetX, event.offsetY);
    if (found?.chosen) this.choose(found);
  }

  // Which of so many places lies nearest to the pointer and within its reach; -1 if none.
  nearest(px, py, count, place) {
    let best = -1, least = PICK_RADIUS_PX;
    for (let i = 0; i < count; i++) {
      const [x, y] = this.toScreen(...place(i));
      const distance = Math.hypot(x - px, y - py);
      if (distance < least) [best, least] = [i, distance];
    }
    return best;
  }
}

// Middle of the fingers, and how far apart two of them are; 0 for one.
function middleAndReach(places) {
  const [[x, y], [otherX, otherY]] = [places[0], places[1] ?? places[0]];
  return { x: (x + otherX) / 2, y: (y + otherY) / 2, reach: Math.hypot(otherX - x, otherY - y) };
}
