// Registration: an image with the cloud over it, moved by hand or solved from clicked pairs.

import { get, getBlob, getBytes, send, siteUrl } from "../api.js";
import { button, choice, el, failed, note } from "../dom.js";
import { History } from "../history.js";
import { KNOBS, knobsOf, turned } from "./camera.js";
import { Panel } from "./panel.js";
import { LAYERS, PIXELS, Picture, SIDES } from "./picture.js";

const MODES = { view: "View", turn: "Turn", move: "Move", lens: "Lens", pairs: "Pairs" };
const KEYS = {
  "V R M L C": "view, turn, move, lens, click pairs",
  "[ ]": "image before, after", "{ }": "rejected image before, after",
  "Arrows": "turn by 0.05° or move by 0.05 m, with Shift ten times; the cross for pairs by 10 px, with Shift 1 px",
  "Space": "click where the cross is", "+ -": "field of view, or zoom of the view",
  "Enter": "solve from the pairs", "Delete": "last pair away", "Ctrl Z": "undo", "Ctrl Y": "redo",
};
const MODE_KEYS = { v: "view", r: "turn", m: "move", l: "lens", c: "pairs" };

class RegistrationPage {
  constructor(site, { images, road, version }) {
    Object.assign(this, { site, images, road, version, mode: "view", number: 0, half: null, error: null, keys: KEYS });
    this.history = new History(`registration-${site.stem}`, { images: {} });
    this.history.listeners.add(() => this.changed());
    this.picture = new Picture(this);
    this.panel = new Panel(this);
    this.modes = choice(MODES, "view", (mode) => this.setMode(mode), "What the mouse does");
    this.picture.element.append(this.bar(), this.legend(), this.foot = el("div", { className: "foot" }));
    this.element = el("div", { className: "split" }, this.panel.element, this.picture.element);
    this.themed = () => { this.picture.draw(); this.panel.route.draw(); };
    addEventListener("themechange", this.themed);
  }

  bar() {
    const toggles = Object.entries(LAYERS).map(([name, text]) => button(text, ({ target }) => {
      this.picture.shown[name] = !this.picture.shown[name];
      target.setAttribute("aria-pressed", this.picture.shown[name]);
      this.picture.draw();
    }, { "aria-pressed": "true", "data-layer": name }));
    return el("div", { className: "bar" }, this.modes, el("span", { className: "group", role: "group", "aria-label": "Layers" }, toggles));
  }

  legend() {
    const row = (colour, text) => el("div", {}, el("span", { className: "swatch", style: `background:${colour}` }), text);
    return el("div", { className: "legend" }, row(SIDES.left, "Cloud, left edge"), row(SIDES.right, "Cloud, right edge"),
      row(PIXELS.lane, "Image, painted line"), row(PIXELS.border, "Image, road border"));
  }

  setMode(mode) {
    this.mode = mode;
    this.modes.press(mode);
    this.half = null;
    this.picture.canvas.style.cursor = { view: "grab", pairs: "crosshair" }[mode] ?? "move";
    this.say({ turn: "Drag: heading and pitch; with Shift: roll.", move: "Drag: right and up; with Shift: ahead.", lens: "Drag or wheel: field of view.",
      pairs: "Click a point of the cloud, then where the image shows it.", view: "Drag and wheel: look closer." }[mode]);
    this.picture.draw();
  }

  say(text) { this.foot.textContent = text; }

  // What is set by hand of this image: pose and pairs.
  get name() { return this.images[this.number].image; }
  get own() { return this.history.now.images[this.name]; }
  get base() { return this.content.solved ?? this.content.expected; }
  get pose() { return this.own?.pose ?? this.base; }
  get pairs() { return this.own?.pairs ?? []; }

  edit(change, alike = null, { name, base } = this) {
    this.history.change(({ images }) => {
      images[name] ??= { pose: { ...base }, pairs: [], baseline: false };
      change(images[name]);
    }, alike && `${name} ${String(alike)}`);
  }

  setPose(pose, alike = null) { this.edit((own) => { own.pose = pose; }, alike); }

  // Change the pose by so much: knobs in metres and degrees, focal length as a factor.
  turn(changes, alike) {
    if (!this.content) return;
    const knobs = knobsOf(this.pose, this.base);
    for (const name of Object.keys(KNOBS)) knobs[name] += changes[name] ?? 0;
    const focal = Math.max(20, Math.min(1e5, this.pose.focal_px * (changes.focal ?? 1)));
    this.setPose(turned(this.base, knobs, focal), alike?.description ?? alike);
  }

  // A click for a pair: first a place of the cloud, then its pixel.
  clicked([u, v], place) {
    if (!this.half) {
      if (!place) return this.say("No point of the cloud is near: click one of its dots.");
      this.half = { x: place[0], y: place[1], z: place[2] };
      this.say("Now click where the image shows it.");
      return this.picture.draw();
    }
    const pair = { ...this.half, u, v };
    this.half = null;
    this.say("Click a point of the cloud, then where the image shows it.");
    this.edit((own) => own.pairs.push(pair));
  }

  // The pose is that of the image that was asked for, whichever is shown by then.
  async solve() {
    const { number, name, base, pairs } = this;
    const asked = JSON.stringify(pairs);
    try {
      const found = await send("POST", siteUrl(this.site.stem, `images/${number}/solve`), { pairs });
      if (this.name === name && JSON.stringify(this.pairs) === asked) this.found = found;
      this.edit((own) => { own.pose = found.pose; }, null, { name, base });
      note(`Solved${this.name === name ? "" : ` ${name}`}: ${found.rms_px.toFixed(2)} px from ${JSON.parse(asked).length} pairs.${found.flat ? " All places lie on one plane: the field of view rests on little." : ""}`, found.flat ? "warn" : "good");
    } catch (error) {
      failed(error);
    }
  }

  async open(number) {
    if (!(number >= 0 && number < this.images.length)) return;
    const turn = (this.opening = Symbol("open"));
    const url = siteUrl(this.site.stem, `images/${number}`);
    try {
      const [content, bitmap, bytes] = await Promise.all([get(url), this.bitmap(url), getBytes(`${url}/points`)]);
      if (this.opening !== turn || this.closed) return;
      Object.assign(this, { number, content, half: null, found: null, error: content.error });
      this.panel.route.chosen = number;
      this.picture.show(content, bitmap, new Float32Array(bytes));
      this.changed();
    } catch (error) {
      this.trouble = error;
      failed(error);
    }
  }

  // The image itself; without it, the cloud and the edges still show.
  async bitmap(url) {
    try {
      return await createImageBitmap(await getBlob(`${url}/picture`));
    } catch (error) {
      note(`The image cannot be shown: ${error.message}`, "warn");
      return null;
    }
  }

  // The next image that can be shown, or the next rejected one.
  step(by, rejected = false) {
    const passed = ({ state }) => (rejected ? state !== "rejected" : state === "unusable");
    let number = this.number + by;
    while (this.images[number] && passed(this.images[number])) number += by;
    this.open(number);
  }

  changed() {
    if (!this.content) return;
    this.picture.draw();
    this.panel.fill();
    this.measure();
  }

  // Alignment error of the present pose; one request at a time, the last one counts.
  async measure() {
    this.stale = true;
    if (this.measuring) return;
    this.measuring = true;
    while (this.stale && !this.closed) {
      this.stale = false;
      try {
        const { number } = this;
        const error = await send("POST", siteUrl(this.site.stem, `images/${number}/error`), this.pose);
        if (this.number === number) this.error = error;
        this.panel.tellError();
      } catch (error) {
        failed(error);
      }
      await new Promise((resolve) => setTimeout(resolve, 50));
    }
    this.measuring = false;
  }

  // Numbers of the images that shall make the baseline.
  get forBaseline() {
    return this.images.flatMap(({ image }, number) => (this.history.now.images[image]?.baseline ? [number] : []));
  }

  async saveBaseline() {
    const images = this.forBaseline.map((number) => {
      const { pose, pairs } = this.history.now.images[this.images[number].image];
      return { number, pose, pairs };
    });
    await this.save("PUT", "baseline", { images }, ({ baselines }) => `Baseline of ${Object.keys(baselines).join(", ")}`);
  }

  async saveCorrection() {
    if (await this.save("PUT", `images/${this.number}/correction`, this.pose, () => "Correction")) await this.reload();
  }

  async forgetCorrection() {
    if (await this.save("DELETE", `images/${this.number}/correction`, {}, () => "Correction forgotten")) await this.reload();
  }

  async save(method, path, content, text) {
    try {
      const answer = await send(method, siteUrl(this.site.stem, path), content, { version: this.version });
      this.version = answer.version;
      note(`${text(answer)}: ${answer.changed.join(", ") || "no file changed"}.`);
      return true;
    } catch (error) {
      failed(error);
      return false;
    }
  }

  async reload() {
    try {
      const { images, version } = await get(siteUrl(this.site.stem, "images"));
      Object.assign(this, { images, version });
      this.panel.route.images = images;
      await this.open(this.number);
    } catch (error) {
      failed(error);
    }
  }

  onKey(event) {
    const { key, shiftKey, ctrlKey, metaKey, altKey } = event;
    const letter = key.toLowerCase();
    if (ctrlKey || metaKey) {
      if (letter === "z") return this.history.step(shiftKey ? 1 : -1), true;
      return letter === "y" && (this.history.step(1), true);
    }
    if (altKey || event.target.tagName === "BUTTON" || event.target.type === "range") return false;
    if (MODE_KEYS[letter]) return this.setMode(MODE_KEYS[letter]), true;
    if ("[]{}".includes(key)) return this.step(key === "[" || key === "{" ? -1 : 1, key === "{" || key === "}"), true;
    if (key === "Enter" && this.pairs.length > 3) return this.solve(), true;
    if (key === "Delete" && this.pairs.length) return this.edit((own) => own.pairs.pop()), true;
    if (key === "+" || key === "-") return this.turn({ focal: key === "+" ? 1.01 : 1 / 1.01 }, "key lens"), true;
    const step = 0.05 * (shiftKey ? 10 : 1);
    const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[key];
    if (key === " " && this.mode === "pairs") return this.picture.clickCross(), true;
    if (!arrow) return false;
    if (this.mode === "pairs") this.picture.nudge(arrow[0] * (shiftKey ? 1 : 10), -arrow[1] * (shiftKey ? 1 : 10));
    else if (this.mode === "move") this.turn({ right: arrow[0] * step, up: arrow[1] * step }, "key move");
    else this.turn({ heading: arrow[0] * step, pitch: arrow[1] * step }, "key turn");
    return true;
  }

  close() {
    this.closed = true;
    removeEventListener("themechange", this.themed);
    this.history.keep();
    this.picture.close();
  }
}

export async function open(site) {
  const listed = await get(siteUrl(site.stem, "images"));
  const first = listed.images.findIndex(({ state }) => state !== "unusable");
  const page = new RegistrationPage(site, listed);
  await page.open(Math.max(first, 0));
  if (!page.content) throw page.trouble;
  return page;
}
