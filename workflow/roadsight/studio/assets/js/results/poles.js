// Poles on the map with the images that saw them; accept, reject or move them.

import { get, getBlob, send, siteUrl } from "../api.js";
import { button, digits, el, failed, note } from "../dom.js";
import { History } from "../history.js";
import { enlargeable } from "../enlarge.js";
import { drawPoles } from "./draw_poles.js";

const HIT_PX = 11;
const MOST_LISTED = 300;
export const STATES = { kept: "kept", withheld: "withheld", accept: "accepted", reject: "rejected", move: "moved" };
const FILTERS = { all: "All", open: "Not decided", withheld: "Withheld", decided: "Decided" };

export class Poles {
  constructor(page) {
    this.page = page;
    [this.filter, this.chosen, this.moving, this.image] = ["all", null, false, 0];
    this.keys = { "N B": "next, previous pole", "A": "accept", "R": "reject", "M": "move: then click its place; Esc ends", "arrow keys": "move the moved pole by 0.1 m (Shift: 1 m)",
      "U": "as computed", "[ ]": "previous, next image", "Ctrl Z": "undo", "Ctrl Y": "redo", "Ctrl S": "save" };
  }

  async load() {
    const { stem } = this.page.site;
    this.about = await get(siteUrl(stem, "poles"));
    const { decisions } = this.about;
    const first = !this.history;
    if (!first) this.history.reset({ decisions });
    else {
      this.history = new History(`poles-${stem}`, { decisions });
      this.history.listeners.add(() => this.page.show());
    }
    if (this.history.restored && (first || this.history.conflict)) {
      note(this.history.conflict ? "Unsaved decisions are back; the saved ones have changed meanwhile" : "Unsaved decisions are back", "warn");
    }
    this.chosen = this.chosen !== null && this.chosen < this.about.poles.length ? this.chosen : null;
    this.showImage();
  }

  // The decision on a pole: found by where the pole was computed.
  decisionOn({ base, kind }, decisions = this.history.now.decisions) {
    let best = null;
    for (const one of decisions) {
      const apart = Math.hypot(one.x - base[0], one.y - base[1]);
      if (one.kind === kind && apart <= 2 && this.owner(one) === base && (!best || apart < best.apart)) best = { one, apart };
    }
    return best?.one ?? null;
  }

  owner({ x, y, kind }) {
    let best = { apart: Infinity };
    for (const pole of this.about.poles) {
      const apart = Math.hypot(pole.base[0] - x, pole.base[1] - y);
      if (pole.kind === kind && apart < best.apart) best = { apart, base: pole.base };
    }
    return best.base;
  }

  stateOf(pole) {
    return this.decisionOn(pole)?.decision ?? (pole.kept ? "kept" : "withheld");
  }

  placeOf(pole) {
    const decision = this.decisionOn(pole);
    return decision?.decision === "move" ? [decision.to_x, decision.to_y] : pole.base;
  }

  decide(word, to = null, alike = null) {
    if (this.chosen === null) return;
    const pole = this.about.poles[this.chosen];
    this.history.change((now) => {
      const before = this.decisionOn(pole, now.decisions);
      now.decisions = now.decisions.filter((one) => one !== before);
      if (word) now.decisions.push({ decision: word, kind: pole.kind, x: pole.base[0], y: pole.base[1], to_x: to?.[0] ?? null, to_y: to?.[1] ?? null, pole: pole.id });
    }, alike);
  }

  choose(number, centre = false) {
    [this.chosen, this.moving, this.image] = [number, false, 0];
    if (centre && number !== null) this.page.view.centre(...this.about.poles[number].base);
    this.showImage();
    this.page.show();
  }

  get listed() {
    const wanted = { all: () => true, open: (pole) => !this.decisionOn(pole), withheld: (pole) => !pole.kept, decided: (pole) => this.decisionOn(pole) }[this.filter];
    return this.about.poles.flatMap((pole, number) => (wanted(pole) ? [number] : []));
  }

  step(by) {
    const { listed } = this;
    if (!listed.length) return;
    const at = listed.indexOf(this.chosen);
    this.choose(listed[at < 0 ? 0 : (at + by + listed.length) % listed.length], true);
  }

  nudge(dx, dy) {
    const [x, y] = this.placeOf(this.about.poles[this.chosen]);
    this.decide("move", [x + dx, y + dy], `nudge ${this.chosen}`);
  }

  click(pixel) {
    const { view } = this.page;
    if (this.moving) {
      if (view.mode !== "plan") return;
      this.moving = false;
      return this.decide("move", view.unproject(...pixel).map((value) => Math.round(value * 1e3) / 1e3));
    }
    const best = { distance: HIT_PX, number: null };
    this.about.poles.forEach((pole, number) => {
      const point = view.project(...this.placeOf(pole), pole.z ?? 0);
      const distance = point ? Math.hypot(point[0] - pixel[0], point[1] - pixel[1]) : Infinity;
      if (distance < best.distance) Object.assign(best, { distance, number });
    });
    this.choose(best.number);
  }

  onKey(event) {
    const { key, ctrlKey, shiftKey } = event;
    if (ctrlKey) {
      if (key === "z") this.history.step(-1);
      else if (key === "y") this.history.step(1);
      else if (key === "s") this.save();
      else return false;
      return true;
    }
    const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[key];
    if (key === "n" || key === "b") this.step(key === "n" ? 1 : -1);
    else if (this.chosen === null) return false;
    else if (key === "a") this.decide("accept");
    else if (key === "r") this.decide("reject");
    else if (key === "m") this.startMove();
    else if (key === "u") this.decide(null);
    else if (key === "Escape") { this.moving = false; this.page.show(); }
    else if (key === "[" || key === "]") this.turnImage(key === "[" ? -1 : 1);
    else if (arrow && this.stateOf(this.about.poles[this.chosen]) === "move") this.nudge(...arrow.map((one) => one * (shiftKey ? 1 : 0.1)));
    else return false;
    return true;
  }

  startMove() {
    this.page.setMode("plan");
    this.moving = true;
    this.page.show();
  }

  async save() {
    if (!this.history.dirty || this.saving) return;
    this.saving = true;
    const { text: sent, now } = this.history;
    try {
      const { changed, version } = await send("PUT", siteUrl(this.page.site.stem, "poles"), now, { version: this.about.version });
      this.about.version = version;
      this.history.wasSaved(JSON.parse(sent), sent);
      note(`Saved: ${changed.join(", ") || "nothing had changed"}. The next run takes it up.`);
    } catch (error) {
      failed(error);
    } finally {
      this.saving = false;
    }
  }

  turnImage(by) {
    const { seen } = this.about.poles[this.chosen];
    if (!seen.length) return;
    this.image = (this.image + by + seen.length) % seen.length;
    this.showImage();
    this.page.show();
  }

  // The image that saw the chosen pole, with the pole marked.
  async showImage() {
    const turn = (this.turn = Symbol("image"));
    this.picture = el("p", { className: "muted" }, "Loading the image…");
    const seen = this.chosen === null ? null : this.about.poles[this.chosen].seen[this.image];
    if (!seen) {
      this.picture = el("p", { className: "muted" }, this.chosen === null ? "" : "No image that saw it.");
      return;
    }
    try {
      const { image, view } = seen;
      const blob = await getBlob(siteUrl(this.page.site.stem, `poles/picture?image=${encodeURIComponent(image)}&view=${view}`));
      const bitmap = await createImageBitmap(blob);
      if (this.turn !== turn || this.page.closed) return;
      this.picture = enlargeable(marked(bitmap, seen), `Image ${image} with the pole marked`);
    } catch (error) {
      if (this.turn !== turn) return;
      this.picture = el("p", { className: "message", role: "status" }, error instanceof DOMException ? "This image cannot be read." : error.message);
    }
    this.page.show();
  }

  status() {
    if (this.moving) return "Click where the pole stands; Esc: leave it";
    const { dirty } = this.history;
    return dirty ? "Decisions are not saved yet (Ctrl S)" : "";
  }

  legend() {
    return Object.entries(STATES).map(([state, text]) => el("div", {}, el("span", { className: "swatch", style: `background: var(--pole-${state})` }), text));
  }

  draw(context, view) {
    if (this.about && !this.page.problem) drawPoles(context, view, this);
  }

  content() {
    const counts = {};
    for (const pole of this.about.poles) counts[this.stateOf(pole)] = (counts[this.stateOf(pole)] ?? 0) + 1;
    const gone = this.about.gone.length;
    return [
      el("section", {}, el("h1", {}, "Poles"),
        el("p", { role: "status" }, `${this.about.poles.length} poles: ${Object.entries(counts).map(([state, count]) => `${count} ${STATES[state]}`).join(", ") || "none"}.`),
        gone ? el("p", { className: "message" }, `${gone} saved ${gone > 1 ? "decisions are" : "decision is"} about poles that are not found any more.`) : null,
        el("div", { className: "row" },
          button("Save", () => this.save(), { className: "primary", disabled: !this.history.dirty, "data-do": "save" }),
          button("Undo", () => this.history.step(-1), { disabled: !this.history.canUndo, "data-do": "undo" }),
          button("Redo", () => this.history.step(1), { disabled: !this.history.canRedo, "data-do": "redo" }))),
      this.chosenPart(), this.listPart()].filter(Boolean);
  }

  chosenPart() {
    if (this.chosen === null) return el("p", { className: "muted" }, "Choose a pole on the map or in the list (N).");
    const pole = this.about.poles[this.chosen];
    const state = this.stateOf(pole);
    const fact = (name, value) => [el("dt", {}, name), el("dd", {}, value)];
    const pressed = (word) => ({ "aria-pressed": String(state === word), "data-do": word });
    const shown = pole.seen[this.image];
    return el("section", {}, el("h2", {}, pole.id),
      el("dl", { className: "facts" }, fact("State", STATES[state]), pole.kept || state !== "withheld" ? null : fact("Why", pole.reason),
        fact("Error, 1 sigma", `${digits(pole.sigma_major_m, 2)} m, ${digits(pole.sigma_minor_m, 2)} m`), fact("Images", String(pole.seen.length)),
        pole.hazard ? fact("Hazard", pole.hazard) : null),
      el("div", { className: "row" }, button("Accept", () => this.decide("accept"), pressed("accept")), button("Reject", () => this.decide("reject"), pressed("reject")),
        button("Move", () => this.startMove(), pressed("move")), button("As computed", () => this.decide(null), { disabled: !this.decisionOn(pole), "data-do": "none" })),
      this.picture,
      shown ? el("div", { className: "row" }, button("‹", () => this.turnImage(-1), { "aria-label": "Previous image", "data-do": "before" }), button("›", () => this.turnImage(1), { "aria-label": "Next image", "data-do": "after" }),
        el("small", {}, `${this.image + 1} of ${pole.seen.length}: ${shown.image}${shown.view === "front" ? "" : `, ${shown.view}`}${shown.depth_m === null ? "" : `, ${digits(shown.depth_m, 1)} m away`}`)) : null);
  }

  listPart() {
    const { listed } = this;
    const filters = Object.entries(FILTERS).map(([name, text]) => button(text, () => { this.filter = name; this.page.show(); }, { "aria-pressed": String(this.filter === name), "data-do": `filter-${name}` }));
    const rows = listed.slice(0, MOST_LISTED).map((number) => {
      const pole = this.about.poles[number];
      return el("li", { "aria-current": this.chosen === number ? "true" : null },
        button(pole.id, () => this.choose(number, true)), el("span", { className: "end" }, `${STATES[this.stateOf(pole)]}, ±${digits(pole.sigma_major_m, 1)} m`));
    });
    return el("section", {}, el("h2", {}, "All poles"), el("div", { className: "row" }, el("span", { className: "group" }, filters)), el("ul", { className: "list tall" }, rows),
      listed.length > MOST_LISTED ? el("small", {}, `The first ${MOST_LISTED} of ${listed.length}; choose others on the map.`) : null);
  }
}

// The image on a canvas with the pole's box and foot.
function marked(bitmap, { image, u_min: left, v_min: top, u_max: right, v_max: bottom, u_foot: u, v_foot: v }) {
  const canvas = el("canvas", { className: "shot", width: bitmap.width, height: bitmap.height, role: "img", "aria-label": `Image ${image} with the pole marked` });
  const context = canvas.getContext("2d");
  const wide = Math.max(2, bitmap.width / 250);
  context.drawImage(bitmap, 0, 0);
  for (const [style, width] of [["#000", 2.4 * wide], ["#ffd400", wide]]) {
    context.strokeStyle = style;
    context.lineWidth = width;
    context.strokeRect(left - 2 * wide, top - 2 * wide, right - left + 4 * wide, bottom - top + 4 * wide);
    context.beginPath();
    context.arc(u, v, 3 * wide, 0, 7);
    context.stroke();
  }
  return canvas;
}
