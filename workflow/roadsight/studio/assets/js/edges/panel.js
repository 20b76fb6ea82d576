// The panel beside the drawing: tools, lists, numbers, and what is wrong.

import { ask, button, choice, digits, el, fieldInput, select } from "../dom.js";
import { LAYERS, itemsOf, pointsOf, setPoint } from "./shapes.js";

const TOOLS = { select: "Select", edge: "Edge", zone: "Zone", mount: "Pole", add: "Add area", remove: "Cut area" };

export class Panel {
  // page: editor, history, load(), save(), native(x, y), local(x, y), takeOver().
  constructor(page) {
    this.page = page;
    this.tools = choice(TOOLS, "select", (tool) => page.editor.setTool(tool), "Tools");
    this.tools.classList.add("tools");
    this.head = el("section");
    this.body = el("div");
    this.told = el("section", { "aria-live": "polite" });
    this.element = el("aside", { className: "panel", "aria-label": "Drawing" }, this.head, this.told, this.body);
    this.fill();
  }

  fill() {
    const focus = document.activeElement?.dataset?.focus;
    this.fillHead();
    this.body.replaceChildren(this.chosenPart(), ...["edges", "zones", "mounts"].map((layer) => this.listPart(layer)), this.areaPart());
    if (focus) this.element.querySelector(`[data-focus="${CSS.escape(focus)}"]`)?.focus();
  }

  fillHead() {
    const { history, editor } = this.page;
    const go = (step) => () => history.step(step);
    const snap = el("input", { type: "checkbox", checked: editor.snap, onchange: () => { editor.snap = snap.checked; } });
    this.head.replaceChildren(
      el("h1", {}, "Road edges"),
      el("div", { className: "row" }, this.tools),
      el("div", { className: "row" }, el("label", {}, snap, "Snap to edges (Alt: not)")),
      el("div", { className: "row" },
        button("Save", () => this.page.save(), { className: "primary", disabled: !history.dirty, "data-do": "save", title: "Ctrl S" }),
        button("Undo", go(-1), { disabled: !history.canUndo, "data-do": "undo", title: "Ctrl Z" }),
        button("Redo", go(1), { disabled: !history.canRedo, "data-do": "redo", title: "Ctrl Y" }),
        button("Discard", () => this.discard(), { disabled: !history.dirty, "data-do": "discard" })),
      el("small", { className: "state" }, history.dirty ? "Unsaved changes, kept in this browser." : "Saved."),
    );
  }

  async discard() {
    if (await ask("Discard the changes?", "The drawing becomes what the site's files say.", "Discard")) this.page.discard();
  }

  problems(preview) {
    const { drawing, chosen } = this.page.editor;
    const current = drawing && chosen ? itemsOf(this.page.history.now, chosen.layer)[chosen.item] : null;
    const unfinished = current?.name && new RegExp(`(edge|zone) ${current.name}: needs`);
    const told = (preview?.problems ?? []).filter((text) => !(unfinished && unfinished.test(text)));
    const free = preview ? preview.forbidden.filter((not) => !not).length : 0;
    const not = preview ? preview.forbidden.length - free : 0;
    const positions = () => {
      if (!preview.edges.length && !preview.forbidden.length) return "No edges are drawn: the workflow takes those of the pavement that it finds.";
      return `${free} candidate positions` + (not ? `, ${not} in zones without sensors` : "");
    };
    this.told.replaceChildren(
      el("p", { "data-told": "positions" }, preview ? positions() : "…"),
      ...told.map((text) => el("p", { className: "message", role: "alert" }, text)),
    );
  }

  chosenPart() {
    const { editor, history } = this.page;
    const { chosen } = editor;
    const part = el("section", { hidden: !chosen });
    if (!chosen) return part;
    const { layer, item, vertex } = chosen;
    const shape = itemsOf(history.now, layer)[item];
    const points = pointsOf(shape, layer);
    part.append(el("h2", {}, `${LAYERS[layer].title}: ${shape.name ?? item + 1}`));
    if (vertex !== null) part.append(this.coordinates(layer, item, vertex, points));
    const remove = vertex !== null && points.length > LAYERS[layer].least ? "Delete point" : "Delete";
    part.append(el("div", { className: "row" },
      layer === "mounts" ? null : button("Split segment", () => editor.split(), { title: "I" }),
      button(remove, () => editor.removePoint(), { className: "danger", title: "Delete" }),
      points.length > 1 && vertex !== null ? button("Delete all", () => editor.removeItem(layer, item), { className: "danger" }) : null,
      layer === "edges" && !editor.drawing ? button("Go on drawing", () => this.goOn(item)) : null));
    return part;
  }

  goOn(item) {
    const { editor, history } = this.page;
    editor.setTool("edge");
    editor.drawing = true;
    editor.choose({ layer: "edges", item, vertex: history.now.edges[item].points.length - 1 });
  }

  coordinates(layer, item, vertex, points) {
    const native = this.page.native(...points[vertex]);
    const inputs = native.map((value, axis) => el("input", {
      type: "number", step: "any", value: value.toFixed(3), "data-focus": `axis${axis}`, "aria-label": axis ? "North" : "East",
      onchange: () => {
        const typed = inputs.map((input) => Number(input.value));
        if (!typed.every(Number.isFinite)) return;
        this.page.history.change((drawing) => setPoint(itemsOf(drawing, layer)[item], layer, vertex, this.page.local(...typed)));
      },
    }));
    for (const input of inputs) input.style.width = "118px";
    return el("div", { className: "row" }, el("small", {}, `${vertex + 1}/${points.length}`), ...inputs);
  }

  listPart(layer) {
    const { editor, history } = this.page;
    const items = itemsOf(history.now, layer);
    const rows = items.map((item, number) => el("li", { "aria-current": editor.chosen?.layer === layer && editor.chosen.item === number ? "true" : null },
      button(item.name, () => this.page.show(layer, number), { "data-focus": `${layer}${number}` }),
      ...this.details(layer, item, number)));
    const offered = items.length ? [] : { edges: this.page.references.automatic, mounts: this.page.references.poles }[layer] ?? [];
    const word = `${layer === "edges" ? "edge" : "pole"}${offered.length === 1 ? "" : "s"}`;
    const take = offered.length ? button(`Take over the ${offered.length} ${word} found`, () => this.page.takeOver(layer, offered)) : null;
    const empty = { edges: "None: the workflow finds edges itself.", zones: "None.", mounts: "None." }[layer];
    return el("section", {}, el("h2", {}, `${LAYERS[layer].title} (${items.length})`),
      items.length ? el("ul", { className: "list", "data-list": layer }, rows) : el("p", { className: "muted" }, empty), take);
  }

  details(layer, item, number) {
    const { history, fields } = this.page;
    const change = (edit) => history.change((drawing) => edit(itemsOf(drawing, layer)[number]));
    const rename = button("Rename", () => this.rename(layer, number), { "aria-label": `Rename ${item.name}` });
    if (layer === "edges") {
      const length = this.page.preview?.edges.find(({ name }) => name === item.name)?.length_m;
      return [el("span", { className: "end" }, `${digits(length, 0)} m`),
        select(Object.fromEntries(fields.kind.enum.map((kind) => [kind, kind])), item.kind, (kind) => change((edge) => { edge.kind = kind; }), { "aria-label": `Kind of ${item.name}` }), rename];
    }
    if (layer !== "mounts") return [rename];
    const height = fieldInput(fields.height_m, { value: item.height_m ?? "", placeholder: "m high", "aria-label": `Height of ${item.name}`, "data-focus": `height${number}`,
      onchange: () => change((pole) => { pole.height_m = height.value === "" ? null : Number(height.value); }) });
    height.style.width = "76px";
    return [height, rename];
  }

  rename(layer, number) {
    const { history, fields } = this.page;
    const before = itemsOf(history.now, layer)[number].name;
    const name = fieldInput(fields.name, { value: before, "aria-label": "Name" });
    const dialog = el("dialog", { onclose: () => dialog.remove() });
    const form = el("form", { onsubmit: (event) => {
      event.preventDefault();
      if (name.value !== before && itemsOf(history.now, layer).some((item) => item.name === name.value)) return name.setCustomValidity("used already"), name.reportValidity();
      dialog.close();
      history.change((drawing) => { itemsOf(drawing, layer)[number].name = name.value; });
    } }, el("h1", {}, `Rename ${before}`), el("div", { className: "row" }, name, el("button", { type: "submit", className: "primary" }, "Rename"), button("Cancel", () => dialog.close())),
    el("small", {}, "Letters, digits, point, hyphen, underscore; at most 40."));
    name.oninput = () => name.setCustomValidity("");
    dialog.append(form);
    document.body.append(dialog);
    dialog.showModal();
    name.select();
  }

  areaPart() {
    const { history, editor } = this.page;
    const { tma } = history.now;
    const base = (value) => () => history.change((drawing) => { drawing.tma = value === "found" ? { base: "found", add: [], remove: [] } : { ...drawing.tma, base: value }; });
    const area = this.page.preview?.area_m2;
    const words = { current: this.page.own.tma ? "Your own area" : "The pavement that was found", none: "Only what you draw", found: "Back to the pavement that the workflow finds" };
    const list = ["add", "remove"].flatMap((layer) => tma[layer].map((_, number) => el("li", { "aria-current": editor.chosen?.layer === layer && editor.chosen.item === number ? "true" : null },
      button(`${layer === "add" ? "Added" : "Cut"} ${number + 1}`, () => this.page.show(layer, number)))));
    return el("section", {}, el("h2", {}, "Monitored area"),
      el("p", {}, `${words[tma.base]}${Number.isFinite(area) ? `, ${Math.round(area).toLocaleString("en")} m²` : ""}`),
      el("ul", { className: "list" }, list),
      el("div", { className: "row" },
        button("Draw anew", base("none"), { disabled: tma.base === "none" }),
        button("As it was", base("current"), { disabled: tma.base === "current" }),
        button("As found", base("found"), { disabled: !this.page.own.tma || tma.base === "found" })));
  }
}
