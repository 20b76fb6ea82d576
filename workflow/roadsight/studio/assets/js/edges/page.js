// Road edges: draw edges, zones, mounts and the monitored area over the cloud.

import { get, send, siteUrl } from "../api.js";
import { CLASSES, COLOURS, GROUND, HEIGHT_STOPS, HIGHEST_M } from "../cloud/material.js";
import { CloudView } from "../cloud/view.js";
import { button, choice, digits, el, failed, note, select } from "../dom.js";
import { History } from "../history.js";
import { drawAll } from "./draw.js";
import { Editor } from "./editor.js";
import { Panel } from "./panel.js";
import { changedLayers, documentOf, itemsOf, pointsOf } from "./shapes.js";

const PREVIEW_MS = 60;
const POINT_M = { fine: 0.05, usual: 0.11, large: 0.25, all: 0.05 };
const KEYS = {
  "V E Z M A R": "select, edge, zone, pole, add area, cut area",
  "Space": "place a point at the cross in the middle",
  "Enter": "finish what is drawn", "Esc": "finish, then let go",
  ", .": "point before, after", "Arrows": "move the chosen point by 0.1 m, with Shift by 1 m; else move the map",
  "I": "split the segment", "Delete": "delete the point", "+ -": "zoom", "0": "show all", "P": "plan or 3D", "D": "measure",
  "Ctrl Z": "undo", "Ctrl Y": "redo", "Ctrl S": "save",
};

class EdgesPage {
  constructor(site, about, loaded) {
    Object.assign(this, { site, keys: KEYS, preview: null, shown: { reference: true, area: true, candidates: true } });
    this.view = new CloudView(site.stem, about, { ondraw: (context, view) => drawAll(context, view, this), onerror: failed });
    this.take(loaded);
    this.history = new History(`edges-${site.stem}`, documentOf(loaded));
    this.editor = new Editor(this.view, this.history, {
      references: (layer) => this.snapTo(layer), edgeNear: (place) => this.edgeNear(place), ontool: (tool) => this.panel.tools.press(tool), onchoose: () => this.panel?.fill(),
    });
    this.panel = new Panel(this);
    this.history.listeners.add(() => this.changed());
    this.foot = el("div", { className: "foot", "aria-live": "off" });
    this.legend = el("div", { className: "legend" });
    this.view.element.append(this.bar(), this.foot, this.legend);
    this.view.element.addEventListener("pointermove", (event) => this.tell(event));
    this.element = el("div", { className: "split" }, this.panel.element, this.view.element);
    this.colour("height");
    addEventListener("beforeunload", this.leaving = () => this.history.keep());
    if (this.history.restored) this.tellRestored();
  }

  take(loaded) {
    Object.assign(this, { references: loaded.reference, area: loaded.area, own: loaded.own, frame: loaded.frame, fields: loaded.fields, version: loaded.version });
  }

  tellRestored() {
    const more = this.history.conflict ? " The site's files have changed since: look closely before you save." : "";
    note(`Your unsaved changes are back.${more}`, this.history.conflict ? "warn" : "good");
  }

  bar() {
    const layers = { reference: "Found lines", area: "Area", candidates: "Candidates" };
    const toggles = Object.entries(layers).map(([name, text]) => button(text, ({ target }) => {
      this.shown[name] = !this.shown[name];
      target.setAttribute("aria-pressed", this.shown[name]);
      this.view.redraw();
    }, { "aria-pressed": "true", "data-layer": name }));
    const colours = Object.fromEntries(Object.entries(COLOURS).filter(([name]) => name !== "ground" || this.view.about.has_ground));
    this.mode = choice({ plan: "Plan", "3d": "3D" }, "plan", (mode) => this.setMode(mode), "View");
    const size = select({ fine: "fine", usual: "usual", large: "large", all: "all, fine" }, "usual", (name) => {
      this.view.setPointSize(POINT_M[name]);
      this.view.setAll(name === "all");
    }, { "data-points": true });
    return el("div", { className: "bar" }, this.mode,
      el("label", {}, "Colour", select(colours, "height", (name) => this.colour(name), { "data-colour": true })),
      el("label", {}, "Points", size),
      el("span", { className: "group", role: "group", "aria-label": "Layers" }, toggles),
      button("All", () => this.showAll(), { title: "0" }), this.view.ruler.button);
  }

  setMode(mode) {
    this.editor.finish();
    this.mode.press(mode);
    this.view.setMode(mode);
    if (mode === "3d") this.foot.textContent = "3D: drag to move, right button to turn, wheel to zoom. Draw in plan.";
  }

  colour(name) {
    this.view.setColour(name);
    const swatch = ([text, colour]) => el("div", {}, el("span", { className: "swatch", style: `background:${colour}` }), text);
    const rows = {
      height: () => HEIGHT_STOPS.map((colour, n) => swatch([`${digits((n * HIGHEST_M) / (HEIGHT_STOPS.length - 1), 1)} m`, colour])).reverse(),
      ground: () => Object.values(GROUND).map(swatch), intensity: () => [swatch(["bright", "#fafafa"]), swatch(["dark", "#1f1f1f"])],
      class: () => Object.values(CLASSES).map(swatch),
    };
    this.legend.replaceChildren(...rows[name]());
  }

  showAll() {
    const { low, high } = this.view.box;
    const [wide, tall] = this.view.size;
    const across = Math.max(high[0] - low[0], ((high[1] - low[1]) * wide) / tall) * 1.06;
    this.view.centre((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, across);
  }

  // Bring a shape of a list into view and choose it.
  show(layer, number) {
    const points = pointsOf(itemsOf(this.history.now, layer)[number], layer);
    const mean = [0, 1].map((axis) => points.reduce((sum, point) => sum + point[axis], 0) / points.length);
    this.editor.choose({ layer, item: number, vertex: 0 });
    const pixel = this.view.project(...mean);
    if (!pixel || pixel.some((value, axis) => value < 0 || value > this.view.size[axis])) this.view.centre(...mean);
  }

  snapTo(layer) {
    if (layer === "mounts") return { poles: this.references.poles };
    return layer === "edges" ? { lines: this.references.lines, rings: this.preview?.area ?? this.area } : {};
  }

  // Edge that the cloud itself shows near a place; null if there is none.
  async edgeNear([x, y]) {
    try {
      return (await send("POST", siteUrl(this.site.stem, "snap"), { x, y })).place;
    } catch (error) {
      failed(error);
      return null;
    }
  }

  native(x, y) {
    const { origin, unit_m: unit } = this.frame;
    return [x / unit + origin[0], y / unit + origin[1]];
  }

  local(east, north) {
    const { origin, unit_m: unit } = this.frame;
    return [(east - origin[0]) * unit, (north - origin[1]) * unit];
  }

  tell(event) {
    if (this.view.mode !== "plan" || event.target !== this.view.canvas) return;
    const [east, north] = this.native(...this.view.unproject(...this.editor.at(event)));
    const { points } = this.view.stats;
    this.foot.textContent = `E ${east.toFixed(2)}  N ${north.toFixed(2)}  ${(points / 1e6).toFixed(2)} M points`;
  }

  changed() {
    this.panel.fill();
    this.view.redraw();
    this.look();
  }

  // Splines and candidates of the present drawing; one request at a time, the last one counts.
  async look() {
    this.stale = true;
    if (this.looking) return;
    this.looking = true;
    while (this.stale && !this.closed) {
      this.stale = false;
      try {
        this.preview = await send("POST", siteUrl(this.site.stem, "preview"), this.drawn());
        this.panel.problems(this.preview);
        this.view.redraw();
      } catch (error) {
        failed(error);
      }
      await new Promise((resolve) => setTimeout(resolve, PREVIEW_MS));
    }
    this.looking = false;
    this.panel.fill();
  }

  // Without areas that have too few corners yet.
  drawn() {
    const { tma, ...rest } = this.history.now;
    const whole = (areas) => areas.filter((points) => points.length > 2);
    const changed = tma.base !== "current" || tma.add.length || tma.remove.length;
    return { ...rest, tma: changed ? { base: tma.base, add: whole(tma.add), remove: whole(tma.remove) } : null };
  }

  // What the workflow found becomes what is drawn.
  takeOver(layer, found) {
    const items = layer === "mounts" ? found.map(({ name, x, y }) => ({ name, x, y, height_m: null })) : structuredClone(found);
    this.history.change((drawing) => { drawing[layer] = items; });
  }

  async save() {
    this.editor.finish();
    if (!this.history.dirty || this.saving) return;
    this.saving = true;
    const { text: sent, now, saved } = this.history;
    try {
      const url = siteUrl(this.site.stem, "drawing");
      const { changed, version } = await send("PUT", url, changedLayers(now, JSON.parse(saved)), { version: this.version });
      this.version = version;
      const loaded = await get(url);
      this.take({ ...loaded, version });
      this.history.wasSaved(documentOf(loaded), sent);
      note(changed.length ? `Saved: ${changed.join(", ")}. What depends on it is stale now.` : "Saved; no file changed.");
    } catch (error) {
      failed(error);
    } finally {
      this.saving = false;
    }
  }

  async discard() {
    try {
      const loaded = await get(siteUrl(this.site.stem, "drawing"));
      this.take(loaded);
      this.editor.choose(null);
      localStorage.removeItem(this.history.key);
      this.history.reset(documentOf(loaded));
      this.history.tell();
    } catch (error) {
      failed(error);
    }
  }

  onKey(event) {
    const letter = event.key.toLowerCase();
    if ((event.ctrlKey || event.metaKey) && letter === "s") return this.save(), true;
    if (event.key === " " && event.target.tagName === "BUTTON") return false;
    if (event.key === "Enter" && event.target.tagName === "BUTTON") return false;
    if (this.view.ruler.onKey(event) || this.editor.onKey(event)) return true;
    if (event.ctrlKey || event.metaKey || event.altKey) return false;
    if (letter === "p") {
      const mode = this.view.mode === "plan" ? "3d" : "plan";
      return this.setMode(mode), true;
    }
    if (event.key === "0") return this.showAll(), true;
    return this.view.onKey(event);
  }

  close() {
    this.closed = true;
    removeEventListener("beforeunload", this.leaving);
    this.history.keep();
    this.view.close();
  }
}

export async function open(site) {
  const [about, loaded] = await Promise.all([get(siteUrl(site.stem, "cloud")), get(siteUrl(site.stem, "drawing"))]);
  const page = new EdgesPage(site, about, loaded);
  page.look();
  return page;
}
