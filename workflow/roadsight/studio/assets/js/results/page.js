// Results over the cloud: a plan's sensors with what-if, and the poles with decisions on them.

import { get, siteUrl } from "../api.js";
import { COLOURS } from "../cloud/material.js";
import { CloudView } from "../cloud/view.js";
import { choice, el, failed, select } from "../dom.js";
import { Poles } from "./poles.js";
import { WhatIf } from "./whatif.js";

const CLICK_PX = 4;

class ResultsPage {
  constructor(site) {
    this.site = site;
    this.panel = el("div", { className: "panel" });
    this.foot = el("div", { className: "foot", role: "status" });
    this.legend = el("div", { className: "legend" });
  }

  async open() {
    const about = await get(siteUrl(this.site.stem, "cloud"));
    this.parts = {};
    if (this.site.jobs.includes("placement")) this.parts.sensors = new WhatIf(this);
    if (this.site.jobs.includes("poles")) this.parts.poles = new Poles(this);
    const first = Object.values(this.parts)[0];
    if (!first) throw new Error("This site asks for neither placement nor poles, so there is nothing to show here.");
    this.view = new CloudView(this.site.stem, about, { onerror: failed, ondraw: (context, view) => this.part?.draw(context, view) });
    this.view.setColour("intensity");
    this.view.element.append(this.bar(), this.foot, this.legend);
    this.element = el("div", { className: "split" }, this.panel, this.view.element);
    this.listen();
    await this.turnTo(Object.keys(this.parts)[0]);
    return this;
  }

  get keys() { return { P: "plan or 3D", D: "measure", ...(Object.keys(this.parts).length > 1 ? { J: "sensors or poles" } : {}), ...this.part?.keys }; }

  bar() {
    this.modes = choice({ plan: "Plan", "3d": "3D" }, "plan", (mode) => this.setMode(mode), "View");
    const colours = el("label", {}, "Colour", select(COLOURS, "intensity", (name) => this.view.setColour(name)));
    return el("div", { className: "bar" }, this.modes, colours, this.view.ruler.button);
  }

  setMode(mode) {
    this.view.setMode(mode);
    this.modes.press(mode);
  }

  async turnTo(name) {
    const turn = (this.turn = Symbol(name));
    this.name = name;
    this.part = this.parts[name];
    this.panel.replaceChildren(el("p", { className: "muted" }, "Loading…"));
    this.loading = true;
    const problem = await this.part.load().then(() => "", (error) => error.message);
    if (this.turn !== turn || this.closed) return;
    [this.loading, this.problem] = [false, problem];
    this.show();
  }

  show() {
    if (this.loading) return;
    const names = Object.fromEntries(Object.keys(this.parts).map((name) => [name, { sensors: "Sensors", poles: "Poles" }[name]]));
    const held = document.activeElement?.dataset?.do;
    const top = this.panel.scrollTop;
    const jobs = Object.keys(names).length > 1 ? [el("div", { className: "row" }, choice(names, this.name, (name) => this.turnTo(name), "Results"))] : [];
    const parts = this.problem ? [el("p", { className: "message bad", role: "alert" }, this.problem)] : this.part.content();
    this.panel.replaceChildren(...jobs, ...parts);
    this.panel.scrollTop = top;
    if (held) this.panel.querySelector(`[data-do="${held}"]`)?.focus();
    this.legend.replaceChildren(...(this.problem ? [] : this.part.legend()));
    this.legend.hidden = !this.legend.children.length;
    this.foot.textContent = this.problem ? "" : this.part.status();
    this.view.redraw();
  }

  listen() {
    const at = (event) => {
      const box = this.view.element.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    this.view.canvas.addEventListener("pointerdown", (event) => { this.pressed = event.button === 0 && !this.view.ruler.active ? at(event) : null; });
    this.view.canvas.addEventListener("pointerup", (event) => {
      const pixel = at(event);
      const still = this.pressed && Math.hypot(pixel[0] - this.pressed[0], pixel[1] - this.pressed[1]) <= CLICK_PX;
      this.pressed = null;
      if (still && !this.loading && !this.problem) this.part.click(pixel);
    });
  }

  onKey(event) {
    const { key } = event;
    if (this.view.ruler.onKey(event)) return true;
    if (key === "p") this.setMode(this.view.mode === "plan" ? "3d" : "plan");
    else if (key === "j" && Object.keys(this.parts).length > 1) this.turnTo(this.name === "sensors" ? "poles" : "sensors");
    else if (!this.loading && !this.problem && this.part.onKey(event)) return true;
    else return this.view.onKey(event);
    return true;
  }

  onShown() { this.view.draw(); }

  close() {
    this.closed = true;
    for (const part of Object.values(this.parts)) part.close?.();
    this.view.close();
  }
}

export const open = (site) => new ResultsPage(site).open();
