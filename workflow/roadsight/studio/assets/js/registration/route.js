// The route in plan: images by their state; a click chooses one.

import { el, themeColour } from "../dom.js";

export const STATES = { accepted: "good", corrected: "accent", rejected: "bad", unsolved: "muted", unusable: "line" };

export class Route {
  constructor({ images, road }, choose) {
    Object.assign(this, { images, road, chosen: 0 });
    this.canvas = el("canvas", { className: "route", "aria-label": "Route in plan: click an image", onclick: (event) => {
      const near = this.nearest(event.offsetX, event.offsetY);
      if (near !== null) choose(near);
    } });
    this.watching = new ResizeObserver(() => this.draw());
    this.watching.observe(this.canvas);
  }

  at(x, y) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const all = this.images.filter((image) => Number.isFinite(image.x));
    const range = (key) => [Math.min(...all.map((image) => image[key])), Math.max(...all.map((image) => image[key]))];
    this.box ??= { x: range("x"), y: range("y") };
    const scale = Math.min((width - 24) / Math.max(this.box.x[1] - this.box.x[0], 1), (height - 24) / Math.max(this.box.y[1] - this.box.y[0], 1));
    return [width / 2 + (x - (this.box.x[0] + this.box.x[1]) / 2) * scale, height / 2 - (y - (this.box.y[0] + this.box.y[1]) / 2) * scale];
  }

  nearest(px, py) {
    const best = { away: 15, number: null };
    this.images.forEach(({ x, y }, number) => {
      const [u, v] = this.at(x, y);
      const away = Math.hypot(u - px, v - py);
      if (away < best.away) Object.assign(best, { away, number });
    });
    return best.number;
  }

  draw() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width) return;
    const ratio = Math.min(devicePixelRatio, 2);
    [this.canvas.width, this.canvas.height] = [width * ratio, height * ratio];
    const context = this.canvas.getContext("2d");
    context.scale(ratio, ratio);
    context.fillStyle = themeColour("border");
    for (let i = 0; i < this.road.length; i += 2) context.fillRect(...this.at(this.road[i], this.road[i + 1]), 1, 1);
    const spot = (image, size) => { context.beginPath(); context.arc(...this.at(image.x, image.y), size, 0, 7); context.fill(); };
    for (const image of this.images) {
      if (!Number.isFinite(image.x)) continue;
      context.fillStyle = themeColour(STATES[image.state]);
      spot(image, image.state === "rejected" ? 3.2 : 2.4);
    }
    const chosen = this.images[this.chosen];
    if (!Number.isFinite(chosen?.x)) return;
    context.strokeStyle = themeColour("ink");
    context.lineWidth = 2;
    context.beginPath();
    context.arc(...this.at(chosen.x, chosen.y), 7, 0, 7);
    context.stroke();
  }
}
