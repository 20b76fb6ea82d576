// A scale bar, and lengths measured by clicks: in metres and in the units of the site's files.

import { button, el, themeColour } from "../dom.js";

const CLICK_PX = 4;
const WIDEST_PX = 140;
const SHORT = { metre: "m", foot: "ft", "us-survey-foot": "US ft" };

const lengthOf = (points) => points.slice(1).reduce((sum, [x, y], n) => sum + Math.hypot(x - points[n][0], y - points[n][1]), 0);

// Greatest of 1, 2, 5, 10, ... that is not above a value.
export function roundBelow(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [5, 2, 1].find((step) => step * power <= value * (1 + 1e-9)) * power;
}

// Length as text; unit: name and metres of the site's own.
export function lengthText(metres, { name, metres: unit }) {
  const text = (value, label) => `${value.toFixed(value < 1000 ? 2 : 1)} ${label}`;
  return name === "metre" ? text(metres, "m") : `${text(metres, "m")} = ${text(metres / unit, SHORT[name] ?? name)}`;
}

export class Ruler {
  // view: of the cloud, in plan.
  constructor(view) {
    Object.assign(this, { view, active: false, points: [], unit: view.about.unit });
    this.scale = el("div", { className: "scale", role: "group", "aria-label": "Scale" });
    this.told = el("div", { className: "measured", role: "status" });
    this.button = button("Measure", () => this.turn(!this.active), { title: "D", "aria-pressed": "false", "data-do": "measure" });
    view.element.append(el("div", { className: "corner" }, this.told, this.scale));
    const on = (name, listener) => view.element.addEventListener(name, listener, { capture: true });
    on("pointerdown", (event) => { this.pressed = this.active && event.button === 0 && event.target === view.canvas ? this.at(event) : null; });
    on("pointermove", (event) => { if (this.active) this.hover(this.at(event)); });
    on("pointerup", (event) => this.up(this.at(event)));
  }

  at(event) {
    const box = this.view.element.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  turn(on) {
    Object.assign(this, { active: on && this.view.mode === "plan", points: [], end: null });
    this.button.setAttribute("aria-pressed", String(this.active));
    if (on && !this.active) this.told.textContent = "Measure in plan (P).";
    else this.tell();
    this.view.redraw();
  }

  hover(pixel) {
    this.end = this.view.unproject(...pixel);
    this.tell();
    this.view.redraw();
  }

  up(pixel) {
    const { pressed } = this;
    this.pressed = null;
    if (pressed && Math.hypot(pixel[0] - pressed[0], pixel[1] - pressed[1]) <= CLICK_PX) this.add(pressed);
  }

  add(pixel) {
    this.points.push(this.view.unproject(...pixel));
    this.end = null;
    this.tell();
    this.view.redraw();
  }

  get line() { return this.end && this.points.length ? [...this.points, this.end] : this.points; }

  tell() {
    const { line, unit } = this;
    if (!this.active) this.told.textContent = "";
    else this.told.textContent = line.length > 1 ? `${lengthText(lengthOf(line), unit)}; Esc ends` : "Click points, or Space at the cross; Esc ends";
  }

  // Whether a key meant the ruler.
  onKey({ key, ctrlKey, metaKey, altKey, target }) {
    if (ctrlKey || metaKey || altKey) return false;
    if (key === "d") return this.turn(!this.active), true;
    if (!this.active) return false;
    if (key === "Escape") return this.turn(false), true;
    if (key === "Backspace" || key === "Delete") return this.points.pop(), this.tell(), this.view.redraw(), true;
    if (key === " " && target.tagName !== "BUTTON") return this.add(this.view.size.map((side) => side / 2)), true;
    return false;
  }

  draw(context) {
    this.drawScale();
    if (this.active && this.view.mode !== "plan") this.turn(false);
    if (!this.active) return;
    const pixels = this.line.map(([x, y]) => this.view.project(x, y));
    const [colour, halo] = ["ink", "halo"].map(themeColour);
    const [u, v] = this.view.size.map((side) => side / 2);
    const cross = [[[u - 8, v], [u + 8, v]], [[u, v - 8], [u, v + 8]]];
    for (const [style, width] of [[halo, 5], [colour, 2]]) {
      [context.strokeStyle, context.lineWidth] = [style, width];
      for (const line of [pixels, ...(this.end ? [] : cross)]) {
        context.beginPath();
        for (const point of line) context.lineTo(...point);
        context.stroke();
      }
    }
    context.fillStyle = colour;
    for (const [x, y] of pixels) context.fillRect(x - 3, y - 3, 6, 6);
  }

  // A bar of a round length in metres, and one in the site's own units where they are others.
  drawScale() {
    const { view, unit } = this;
    this.scale.hidden = view.mode !== "plan";
    const across = WIDEST_PX * view.metresPerPixel;
    if (this.scale.hidden || across === this.across) return;
    this.across = across;
    const bar = (metres, label) => {
      const length = roundBelow(across / metres);
      return el("div", { style: `width: ${(length * metres) / view.metresPerPixel}px` }, `${Number(length.toPrecision(1)).toLocaleString("en", { maximumFractionDigits: 4 })} ${label}`);
    };
    this.scale.replaceChildren(bar(1, "m"), ...(unit.name === "metre" ? [] : [bar(unit.metres, SHORT[unit.name] ?? unit.name)]));
  }
}
