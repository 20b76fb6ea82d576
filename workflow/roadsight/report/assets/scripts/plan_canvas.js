// A plan on a canvas: moving, zooming, pointing. Subclasses say what it draws and what lies where:
// paint(), pick(px, py), choose(found or null) and, for other colours, recolour().

const MAP_MARGIN_PX = 34;
const PICK_RADIUS_PX = 11;

class PlanCanvas {
  constructor(canvas, site, state, tooltip) {
    Object.assign(this, { canvas, site, state, tooltip });
    this.context = canvas.getContext("2d");
    this.active = false;
    this.listen();
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
      this.context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
      this.paint();
    });
  }

  listen() {
    const { canvas } = this;
    let last = null, travelled = 0;
    canvas.addEventListener("pointerdown", (event) => {
      this.active = true;
      last = [event.clientX, event.clientY];
      travelled = 0;
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (last) {
        const [dx, dy] = [event.clientX - last[0], event.clientY - last[1]];
        travelled += Math.abs(dx) + Math.abs(dy);
        last = [event.clientX, event.clientY];
        this.move(dx, dy);
      } else this.point(event);
    });
    canvas.addEventListener("pointerup", (event) => {
      last = null;
      if (travelled < 4) this.click(event);
    });
    canvas.addEventListener("pointerleave", () => {
      this.active = false;
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
      0: () => this.fit(), Escape: () => this.choose(null),
    };
    if (!actions[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    actions[event.key]();
  }

  point(event) {
    const found = this.pick(event.offsetX, event.offsetY);
    this.canvas.style.cursor = found?.chosen ? "pointer" : "";
    if (found) this.tooltip.show(found.text, event.clientX, event.clientY);
    else this.tooltip.hide();
  }

  click(event) {
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
