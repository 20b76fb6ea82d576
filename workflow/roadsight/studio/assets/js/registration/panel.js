// The panel beside the image: which one, how it was solved, sliders, pairs, and what is kept.

import { button, digits, el } from "../dom.js";
import { KNOBS, fieldOfView, focalOf, knobsOf, turned } from "./camera.js";
import { Route, STATES } from "./route.js";

export class Panel {
  constructor(page) {
    this.page = page;
    this.route = new Route(page, (number) => page.open(number));
    this.head = el("section");
    this.told = el("section", { "aria-live": "polite" });
    this.sliders = el("section");
    this.rest = el("div");
    this.element = el("aside", { className: "panel", "aria-label": "Registration" }, el("h1", {}, "Registration"), this.route.canvas, this.head, this.told, this.sliders, this.rest);
  }

  fill() {
    this.fillHead();
    this.fillSliders();
    this.fillRest();
    this.tellError();
    if (this.of !== this.page.content) this.route.draw();
    this.of = this.page.content;
  }

  fillHead() {
    const { page } = this;
    const image = page.images[page.number];
    const number = el("input", { type: "number", min: 1, max: page.images.length, value: page.number + 1, "aria-label": "Number of the image", onchange: () => page.open(Number(number.value) - 1) });
    number.style.width = "70px";
    const counts = Object.keys(STATES).map((state) => [state, page.images.filter((one) => one.state === state).length]).filter(([, count]) => count);
    this.head.replaceChildren(
      el("div", { className: "row" },
        button("◀", () => page.step(-1), { "aria-label": "Image before", title: "[" }), number, el("span", {}, `of ${page.images.length}`),
        button("▶", () => page.step(1), { "aria-label": "Next image", title: "]" }),
        button("Next rejected", () => page.step(1, true), { title: "}", disabled: !page.images.slice(page.number + 1).some(({ state }) => state === "rejected") })),
      el("p", { className: "mono" }, image.image),
      el("p", {}, el("b", { "data-state": image.state }, image.state), image.reason ? `: ${image.reason}` : "",
        image.residual_px === null ? "" : `, residual ${digits(image.residual_px, 2)} px`),
      el("small", {}, counts.map(([state, count]) => `${count} ${state}`).join(", ")));
  }

  tellError() {
    const { error } = this.page;
    this.told.replaceChildren(el("h2", {}, "Alignment error"), el("dl", { className: "facts" },
      el("dt", {}, "Typical (median)"), el("dd", { "data-told": "median" }, `${digits(error?.median_px ?? NaN, 2)} px`),
      el("dt", {}, "Root mean square"), el("dd", { "data-told": "rms" }, `${digits(error?.rms_px ?? NaN, 2)} px`),
      el("dt", {}, "Left, right"), el("dd", {}, `${digits(error?.left_px ?? NaN, 2)}, ${digits(error?.right_px ?? NaN, 2)} px`),
      el("dt", {}, "Points compared"), el("dd", {}, error?.points ?? 0)));
  }

  fillSliders() {
    const { page } = this;
    const knobs = knobsOf(page.pose, page.base);
    const width = page.content.size[0];
    if (!this.inputs) this.makeSliders();
    const values = { ...knobs, view: fieldOfView(page.pose.focal_px, width) };
    for (const [name, [range, number]] of Object.entries(this.inputs)) {
      if (document.activeElement !== number) number.value = values[name].toFixed(2);
      range.value = values[name];
    }
  }

  makeSliders() {
    this.inputs = {};
    const rows = Object.entries({ ...KNOBS, view: ["Field of view", "°", null, 0.05] }).map(([name, [text, unit, most, step]]) => {
      const limits = most === null ? { min: 5, max: 130 } : { min: -most, max: most };
      const set = (value) => Number.isFinite(value) && this.set(name, value);
      const range = el("input", { type: "range", ...limits, step, value: 0, "aria-label": text, "data-knob": name, oninput: () => set(range.valueAsNumber) });
      const number = el("input", { type: "number", step, "aria-label": `${text}, ${unit}`, onchange: () => set(number.valueAsNumber) });
      number.style.width = "78px";
      range.classList.add("wide");
      this.inputs[name] = [range, number];
      return el("div", { className: "row knob" }, el("span", { className: "name" }, text), range, number, el("small", {}, unit));
    });
    this.sliders.append(el("h2", {}, "Position, rotation, field of view"), el("small", {}, "From the pose that the workflow has."), ...rows);
  }

  set(name, value) {
    const { page } = this;
    const knobs = knobsOf(page.pose, page.base);
    const focal = name === "view" ? focalOf(Math.max(1, Math.min(170, value)), page.content.size[0]) : page.pose.focal_px;
    if (name !== "view") knobs[name] = value;
    page.setPose(turned(page.base, knobs, focal), `slider ${name}`);
  }

  fillRest() {
    const { page } = this;
    const { own, pairs, history, content } = page;
    const reset = (pose) => () => page.setPose({ ...pose });
    const gaps = page.found?.residuals_px.length === pairs.length ? page.found.residuals_px : [];
    const rows = pairs.map((pair, number) => el("li", {},
      button(`Pair ${number + 1}: pixel ${pair.u.toFixed(0)}, ${pair.v.toFixed(0)}`, () => {}), el("span", { className: "end" }, gaps[number] === undefined ? "" : `${gaps[number].toFixed(2)} px`),
      button("Delete", () => page.edit((mine) => mine.pairs.splice(number, 1)), { "aria-label": `Delete pair ${number + 1}` })));
    const use = el("input", { type: "checkbox", checked: own?.baseline ?? false, "data-do": "use", onchange: () => page.edit((mine) => { mine.baseline = use.checked; }) });
    const count = page.forBaseline.length;
    this.rest.replaceChildren(
      el("section", {}, el("div", { className: "row" },
        button("Undo", () => history.step(-1), { disabled: !history.canUndo }), button("Redo", () => history.step(1), { disabled: !history.canRedo }),
        button("As solved", reset(content.solved), { disabled: !content.solved }), button("As expected", reset(content.expected), { title: "By the drive's calibration alone" }))),
      el("section", {}, el("h2", {}, `Clicked pairs (${pairs.length})`), el("ul", { className: "list", "data-list": "pairs" }, rows),
        el("div", { className: "row" }, button("Click pairs", () => page.setMode("pairs")),
          button("Solve", () => page.solve(), { className: "primary", disabled: pairs.length < 4, "data-do": "solve", title: "Enter" })),
        pairs.length < 4 ? el("small", {}, "At least 4, better 6 or more, on both sides and at several depths.") : null),
      el("section", {}, el("h2", {}, `Baseline of ${content.size.join("x")}`), el("div", { className: "row" }, el("label", {}, use, "Use this image for it")),
        el("div", { className: "row" }, button(`Save baseline (${count} image${count === 1 ? "" : "s"})`, () => page.saveBaseline(), { disabled: !count, "data-do": "baseline" })),
        el("small", {}, "Where the camera sits on its vehicle and its field of view, for all images of this size.")),
      el("section", {}, el("h2", {}, "This image by hand"), el("div", { className: "row" },
        button("Save correction", () => page.saveCorrection(), { "data-do": "correct" }),
        button("Forget correction", () => page.forgetCorrection(), { disabled: !content.corrected, "data-do": "forget" })),
        el("small", {}, "The workflow then takes this pose as it is.")));
  }
}
