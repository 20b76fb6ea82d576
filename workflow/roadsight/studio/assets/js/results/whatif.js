// A plan's sensors: switch them off, move them, add others, and see at once what is covered.

import { download, get, send, siteUrl } from "../api.js";
import { button, digits, el, failed, note, select } from "../dom.js";
import { planForm } from "../plans/form.js";
import { placesOf } from "../plans/places.js";
import { drawLayout } from "./draw.js";

const HIT_PX = 10;
const FILES = { yaml: "Plan (YAML)", csv: "CSV", geojson: "GeoJSON" };
const MOST_LISTED = 200;
const SHOWN = { candidates: "Candidates", obstacles: "Obstacles" };

export class WhatIf {
  constructor(page) {
    this.page = page;
    this.plans = page.site.plans;
    this.plan = Object.keys(this.plans)[0];
    this.shown = { candidates: true, obstacles: false };
    this.keys = {
      "N B": "next, previous sensor", "O": "switch it off or on", "Delete": "take it away", "M": "move it: then click a candidate, Esc ends",
      ", .": "to the candidate before, behind", "; :": "lower, higher", "A": "add where most is gained", "Ctrl Z": "undo",
    };
  }

  async load() {
    if (!this.plan) throw new Error("No plan of this site has a solution yet. The page Run solves them.");
    const answer = await get(siteUrl(this.page.site.stem, `plans/${this.plan}`));
    this.about = answer;
    this.sensors = answer.chosen.map((row, number) => ({ row, before: row, number, on: true }));
    this.coverage = answer.coverage;
    [this.outdated, this.turn] = [false, null];
    [this.chosen, this.moving, this.kind, this.past] = [null, false, 0, []];
  }

  place(row) { return this.about.choices.xyz.slice(3 * row, 3 * row + 3); }
  name(row) { return this.about.choices.name[row]; }
  get rows() { return this.sensors.filter(({ on }) => on).map(({ row }) => row); }
  get changed() { return JSON.stringify([...this.rows].sort()) !== JSON.stringify([...this.about.chosen].sort()); }

  // Change the sensors, and ask what they see now.
  change(edit) {
    this.past.push(JSON.stringify(this.sensors));
    edit();
    this.ask();
  }

  undo() {
    if (!this.past.length) return;
    this.sensors = JSON.parse(this.past.pop());
    if (this.chosen !== null && this.chosen >= this.sensors.length) this.chosen = null;
    this.ask();
  }

  async ask() {
    const turn = (this.turn = Symbol("ask"));
    this.page.show();
    const began = performance.now();
    try {
      const answer = await send("POST", siteUrl(this.page.site.stem, `plans/${this.plan}/coverage`), { version: this.about.version, rows: this.rows });
      if (this.turn !== turn || this.page.closed) return;
      this.coverage = answer;
      this.outdated = false;
      this.tookMs = performance.now() - began;
    } catch (error) {
      if (this.turn === turn) this.outdated = true;
      failed(error);
    } finally {
      if (this.turn === turn) this.turn = null;
    }
    if (!this.turn && !this.page.closed) this.page.show();
  }

  taken(row, except = null) {
    const { position } = this.about.choices;
    return this.sensors.some((sensor, number) => number !== except && sensor.on && position[sensor.row] === position[row]);
  }

  choose(number) {
    this.chosen = number;
    this.moving = false;
    this.page.show();
  }

  toggle(number) {
    const sensor = this.sensors[number];
    if (!sensor.on && this.taken(sensor.row)) return failed(new Error("Another sensor stands there now: move one of them first."));
    this.change(() => { sensor.on = !sensor.on; });
  }

  remove(number) {
    [this.chosen, this.moving] = [null, false];
    this.change(() => this.sensors.splice(number, 1));
  }

  moveTo(row) {
    const { chosen } = this;
    if (this.taken(row, chosen)) return failed(new Error("A sensor stands there already."));
    this.moving = false;
    this.change(() => Object.assign(this.sensors[chosen], { row, on: true }));
  }

  add(row) {
    if (this.taken(row)) return failed(new Error("A sensor stands there already."));
    this.change(() => this.sensors.push({ row, before: null, number: this.sensors.length, on: true }));
    this.choose(this.sensors.length - 1);
  }

  addBest() {
    if (this.coverage.next !== null) this.add(this.coverage.next);
  }

  // Of all heights and poses of a kind at one place, in order; and the best of them.
  atPlace(row) {
    const { key, sensor } = this.about.choices;
    return key.flatMap((value, other) => (value === key[row] && sensor[other] === sensor[row] ? [other] : []));
  }

  best(rows) {
    const { sees } = this.about.choices;
    return rows.reduce((a, b) => (sees[b] > sees[a] ? b : a));
  }

  step(by) {
    const rows = this.atPlace(this.sensors[this.chosen].row);
    const to = rows[rows.indexOf(this.sensors[this.chosen].row) + by];
    if (to !== undefined) this.moveTo(to);
  }

  // To the next place in the order of candidates, at about the same height.
  along(by) {
    const { key, height_m: height } = this.about.choices;
    const { row } = this.sensors[this.chosen];
    const kind = this.about.choices.sensor[row];
    let other = row;
    while (key[other] === key[row] || this.taken(other, this.chosen)) {
      other += by;
      if (this.about.choices.sensor[other] !== kind) return;
    }
    this.moveTo(this.atPlace(other).reduce((a, b) => (Math.abs(height[b] - height[row]) < Math.abs(height[a] - height[row]) ? b : a)));
  }

  click(pixel) {
    const sensor = this.nearest(pixel, this.sensors.map(({ row }) => row));
    if (!this.moving && sensor !== null) return this.choose(sensor);
    const kind = this.moving ? this.about.choices.sensor[this.sensors[this.chosen].row] : this.kind;
    const rows = this.about.choices.sensor.flatMap((value, row) => (value === kind ? [row] : []));
    const hit = this.shown.candidates || this.moving || this.adding ? this.nearest(pixel, rows) : null;
    if (hit === null) return this.choose(null);
    const row = this.page.view.mode === "plan" ? this.best(this.atPlace(rows[hit])) : rows[hit];
    if (this.moving) this.moveTo(row);
    else if (this.adding) this.add(row);
  }

  nearest([px, py], rows) {
    const best = { distance: HIT_PX, number: null };
    rows.forEach((row, number) => {
      const point = this.page.view.project(...this.place(row));
      const distance = point ? Math.hypot(point[0] - px, point[1] - py) : Infinity;
      if (distance < best.distance) Object.assign(best, { distance, number });
    });
    return best.number;
  }

  onKey({ key, ctrlKey }) {
    const held = this.chosen !== null;
    const count = this.sensors.length;
    if (key === "z" && ctrlKey) this.undo();
    else if (ctrlKey) return false;
    else if (key === "n" && count) this.choose(held ? (this.chosen + 1) % count : 0);
    else if (key === "b" && count) this.choose(held ? (this.chosen + count - 1) % count : count - 1);
    else if (key === "a") this.addBest();
    else if (key === "Escape") { this.adding = this.moving = false; this.page.show(); }
    else if (!held) return false;
    else if (key === "o") this.toggle(this.chosen);
    else if (key === "Delete") this.remove(this.chosen);
    else if (key === "m") { this.moving = true; this.page.show(); }
    else if (key === "," || key === ".") this.along(key === "," ? -1 : 1);
    else if (key === ";" || key === ":") this.step(key === ";" ? -1 : 1);
    else return false;
    return true;
  }

  status() {
    if (this.moving) return "Click a candidate to move the sensor there; Esc: leave it";
    if (this.adding) return "Click a candidate to put a sensor there; Esc: end";
    return this.tookMs ? `Coverage in ${Math.round(this.tookMs)} ms` : "";
  }

  legend() {
    const times = ["not covered", "one sensor", "two", "three", "four or more"].map((text, n) => el("div", {}, el("span", { className: "swatch", style: `background: var(--seen-${n})` }), `Target: ${text}`));
    const obstacle = this.shown.obstacles ? [el("div", {}, el("span", { className: "swatch", style: "background: var(--mount)" }), "Obstacle")] : [];
    return [...times, el("div", {}, el("span", { className: "swatch", style: "background: var(--chosen)" }), "Sensor"), ...obstacle];
  }

  draw(context, view) {
    if (this.about && !this.page.problem) drawLayout(context, view, this);
  }

  content() {
    const plans = select(this.plans, this.plan, (plan) => { this.plan = plan; this.page.turnTo("sensors"); }, { "aria-label": "Plan", "data-do": "plan", className: "wide" });
    const layers = Object.entries(SHOWN).map(([name, text]) => el("label", {}, el("input", { type: "checkbox", checked: this.shown[name], "data-do": name, onchange: (event) => { this.shown[name] = event.target.checked; this.page.show(); } }), text));
    return [el("section", {}, el("h1", {}, "Plan"), el("div", { className: "row" }, plans), ...this.figures(), el("div", { className: "row" }, layers)),
      this.sensorPart(), this.chosenPart(), this.keepPart(), this.uncoveredPart()].filter(Boolean);
  }

  figures() {
    const { solution, targets } = this.about;
    const { covered, lost, gained, cost, next_covers: gain } = this.coverage;
    const count = targets.length / 3;
    const on = this.rows.length;
    const proven = solution.status === "optimal" ? "proven" : Number.isFinite(solution.bound) ? `at least ${digits(solution.bound, 1)}` : solution.status;
    const fact = (name, value) => [el("dt", {}, name), el("dd", {}, value)];
    const signed = (value) => (value > 0 ? `+${value}` : String(value));
    const change = this.changed
      ? [...fact("Lost, gained", el("span", {}, el("b", { "data-state": lost ? "rejected" : "" }, `−${lost}`), " ", el("b", { "data-state": gained ? "accepted" : "" }, `+${gained}`))),
        ...fact("Sensors, cost against the plan", `${signed(on - this.about.chosen.length)}, ${signed(Number((cost - this.planCost).toFixed(2)))}`)] : [];
    const outdated = this.outdated ? [el("p", { className: "message bad" }, "Figures of before: the last change could not be counted.")] : [];
    return [...this.about.notes.map((text) => el("p", { className: "message" }, text)),
    el("div", { role: "status" }, outdated, el("dl", { className: "facts" },
      fact("Sensors", String(on)), fact(this.changed ? "Cost" : `Cost (${proven})`, digits(cost, 2).replace(/\.00$/, "")),
      fact("Targets covered", `${covered} of ${count}, ${digits((100 * covered) / Math.max(count, 1), 1)} %`), change)),
    el("div", { className: "row" },
      button(gain ? `Add best: covers ${gain} more` : "Nothing more can be covered", () => this.addBest(), { disabled: !gain, "data-do": "best" }),
      button("Undo", () => this.undo(), { disabled: !this.past.length, "data-do": "undo" }),
      button("As planned", () => this.page.turnTo("sensors"), { disabled: !this.changed, "data-do": "reset" }))];
  }

  get planCost() {
    return this.about.chosen.reduce((sum, row) => sum + this.about.choices.cost[row], 0);
  }

  sensorPart() {
    const kinds = this.about.sensors.length > 1
      ? [select(Object.fromEntries(this.about.sensors.map(({ name }, n) => [n, name])), String(this.kind), (kind) => { this.kind = Number(kind); }, { "aria-label": "Sensor to add", "data-do": "kind" })] : [];
    const only = new Map(this.rows.map((row, n) => [row, this.coverage.only[n]]));
    const rows = this.sensors.slice(0, MOST_LISTED).map((sensor, number) => {
      const { row, on, before } = sensor;
      const state = before === null ? "added" : before !== row ? "moved" : "";
      return el("li", { "aria-current": this.chosen === number ? "true" : null },
        button(`${number + 1} ${this.about.sensors[this.about.choices.sensor[row]].name} ${this.name(row)}`, () => { this.choose(number); this.page.view.centre(...this.place(row).slice(0, 2)); }, { title: this.name(row) }),
        el("span", { className: "end" }, on ? `${state} ${only.get(row) ?? ""} alone` : "off"),
        el("input", { type: "checkbox", checked: on, "aria-label": `Sensor ${number + 1} stands`, "data-do": `on${number}`, onchange: () => this.toggle(number) }));
    });
    return el("section", {}, el("h2", {}, "Sensors"), el("ul", { className: "list tall" }, rows),
      el("div", { className: "row" }, kinds, button("Add by a click", () => { this.adding = !this.adding; this.page.show(); }, { "aria-pressed": String(Boolean(this.adding)), "data-do": "add" })));
  }

  // As a plan of the site, or as files.
  keepPart() {
    const save = () => planForm(this.page.site, { base: this.plan, given: {
      name: `${this.plan}-mine`, title: `${this.plans[this.plan]}, as drawn`, goal: "sensors", amount: this.rows.length, ...placesOf(this),
    } }).catch(failed);
    const files = Object.entries(FILES).map(([format, text]) => button(text, () => this.export(format), { "data-do": `export-${format}` }));
    return el("section", {}, el("h2", {}, "Keep these sensors"),
      el("div", { className: "row" }, button("Save as a plan…", save, { "data-do": "save-as" })), el("div", { className: "row" }, "Files", files));
  }

  export(format) {
    const url = siteUrl(this.page.site.stem, `plans/${this.plan}/export`);
    return download(url, { version: this.about.version, rows: this.rows, format }).then((name) => note(`Saved by the browser: ${name}`), failed);
  }

  chosenPart() {
    if (this.chosen === null) return null;
    const { row } = this.sensors[this.chosen];
    const { height_m: height, sees, name } = this.about.choices;
    const options = Object.fromEntries(this.atPlace(row).map((other) => [other, `${digits(height[other], 1)} m${name[other] === name[row] || height[other] !== height[row] ? "" : ` ${name[other]}`}, sees ${sees[other]}`]));
    return el("section", {}, el("h2", {}, `Sensor ${this.chosen + 1}`),
      el("div", { className: "row" }, el("label", {}, "Height", select(options, String(row), (to) => this.moveTo(Number(to)), { "data-do": "height" }))),
      el("div", { className: "row" },
        button("Before", () => this.along(-1), { "data-do": "before" }), button("Behind", () => this.along(1), { "data-do": "behind" }),
        button("Move by a click", () => { this.moving = true; this.page.show(); }, { "aria-pressed": String(this.moving), "data-do": "move" }),
        button("Take away", () => this.remove(this.chosen), { className: "danger", "data-do": "remove" })));
  }

  uncoveredPart() {
    const { uncovered, obstacles } = this.about;
    if (!uncovered.length && !obstacles.length) return null;
    const counted = new Map();
    for (const { reason } of uncovered) counted.set(reason, (counted.get(reason) ?? 0) + 1);
    const items = uncovered.slice(0, MOST_LISTED).map(({ target, reason }) => el("li", {}, button(`Target ${target + 1}`, () => this.page.view.centre(...this.about.targets.slice(3 * target, 3 * target + 2), 60)), el("span", { className: "end" }, reason)));
    const blocking = [...obstacles].sort((a, b) => b.targets - a.targets).slice(0, 12).map((one) => el("li", {},
      button(`${one.kind}, ${digits(one.height_m, 1)} m high`, () => { this.shown.obstacles = true; this.page.view.centre(one.x, one.y, 60); this.page.show(); }), el("span", { className: "end" }, `${one.targets} targets`)));
    return el("section", {}, el("h2", {}, "What hides targets from the plan's sensors"), el("ul", { className: "list" }, blocking),
      uncovered.length ? el("p", {}, `Not covered by the plan: ${[...counted].map(([reason, count]) => `${count} ${reason}`).join(", ")}.`) : null,
      el("ul", { className: "list" }, items));
  }
}
