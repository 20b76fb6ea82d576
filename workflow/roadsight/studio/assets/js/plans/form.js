// A plan as a form: which sensors, how often each target is seen, the goal, and the places.

import { get, send, siteUrl } from "../api.js";
import { button, el, fieldInput, fieldLabel, limits, note, select } from "../dom.js";
import { barredText, readBarred, readStanding, standingText } from "./places.js";

const COVER = { cover: "the cheapest set that sees every target" };
const AMOUNTS = ["sensors", "cost", "price"];
const PLACES = {
  mandatory: { title: "Mandatory places", hint: "a line each: x; y; sensor; height in m; candidate with its pose, for sensors that are aimed (x and y as in the cloud's files)", write: standingText, read: readStanding },
  forbidden: { title: "Forbidden places", hint: "a line each: x; y; half the side of the square in m; they are added to those of the plan that it is based on", write: barredText, read: readBarred },
};

// base: name of the plan it starts from; edit: whether that plan itself is changed; given: fields and
// places that are known already.
export async function planForm(site, { base = "", edit = false, given = {} } = {}) {
  const known = await get(siteUrl(site.stem, "plans"));
  return new Form(site, known, base, edit, given);
}

class Form {
  constructor(site, { sensors, plans, version, fields }, base, edit, given) {
    Object.assign(this, { site, plans, version, fields, edit, given });
    this.base = plans.find(({ name }) => name === base) ?? null;
    this.name = fieldInput(fields.name, { maxLength: 60, disabled: edit, "data-do": "plan-name" });
    this.title = fieldInput(fields.title, { "data-do": "plan-title" });
    this.start = select({ "": "nothing", ...Object.fromEntries(plans.map(({ name, title }) => [name, title])) }, this.base?.name ?? "", (name) => { this.base = plans.find((one) => one.name === name) ?? null; this.fill(); }, { disabled: edit || Boolean(given.mandatory), "data-do": "plan-base" });
    this.boxes = sensors.map(({ name, cost }) => el("label", {}, el("input", { type: "checkbox", value: name }), `${name} (${cost})`));
    this.least = fieldInput(fields.at_least, { placeholder: "as set", "data-do": "at-least" });
    this.amount = el("input", { "aria-label": "Amount of the goal", "data-do": "amount" });
    const goals = { ...COVER, ...Object.fromEntries(AMOUNTS.map((name) => [name, fields[name].description])) };
    this.goal = select(goals, "cover", () => this.showAmount(), { "data-do": "goal" });
    this.lists = Object.fromEntries(Object.keys(PLACES).map((part) => [part, this.list(part)]));
    this.told = el("div", { role: "alert" });
    this.dialog = el("dialog", { className: "form", "aria-label": "Plan", onclose: () => this.dialog.remove() }, this.content());
    this.fill();
    document.body.append(this.dialog);
    this.dialog.showModal();
    (edit ? this.title : this.name).focus();
  }

  content() {
    const field = (text, ...inputs) => el("label", { className: "field" }, el("span", {}, text), ...inputs);
    const sensors = el("fieldset", {}, el("legend", {}, "Sensors that it may place (cost)"), el("div", { className: "boxes" }, this.boxes));
    return el("form", { onsubmit: (event) => { event.preventDefault(); this.save(); } },
      el("h1", {}, this.edit ? `Plan ${this.base.name}` : "New plan of this site"),
      field("Name: a-z, 0-9, - and _", this.name), field(fieldLabel(this.fields.title), this.title), field("Based on", this.start), sensors,
      field(fieldLabel(this.fields.at_least), this.least), field("Goal", this.goal, this.amount),
      Object.values(this.lists).map(({ element }) => element), this.told,
      el("div", { className: "row" }, el("button", { type: "submit", className: "primary", "data-do": "save-plan" }, "Save in the site file"), button("Cancel", () => this.dialog.close())));
  }

  list(part) {
    const { title, hint } = PLACES[part];
    const text = el("textarea", { rows: 4, "aria-label": `${title}: ${hint}`, "data-do": `${part}-text`, spellcheck: false });
    const lines = el("div", {}, text, el("small", {}, hint));
    const which = select({ none: "none" }, "none", () => { lines.hidden = which.value !== "own"; }, { "aria-label": title, "data-do": part });
    const element = el("div", { className: "field" }, el("span", {}, title), which, lines);
    return { which, text, lines, element };
  }

  fill() {
    const { base, given } = this;
    const from = { name: "", title: "", sensors: [], at_least: null, goal: "cover", amount: null, ...base, ...(this.edit ? {} : { name: "", title: "" }), ...given };
    [this.name.value, this.title.value] = [from.name || this.name.value, from.title || this.title.value];
    for (const box of this.boxes) box.firstChild.checked = from.sensors.includes(box.firstChild.value);
    [this.least.value, this.goal.value, this.amount.value] = [from.at_least ?? "", from.goal, from.amount ?? ""];
    for (const [part, { which, text, lines }] of Object.entries(this.lists)) {
      const kept = base?.[part] ? { keep: `those of ${base.name}` } : {};
      const options = { none: "none", ...kept, own: part === "forbidden" && base?.[part] ? `those of ${base.name} and these` : "these" };
      which.replaceChildren(...Object.entries(options).map(([value, label]) => el("option", { value }, label)));
      text.value = given[part] ? PLACES[part].write(given[part]) : "";
      which.value = given[part]?.length ? "own" : base?.[part] ? "keep" : "none";
      lines.hidden = which.value !== "own";
    }
    this.showAmount();
  }

  showAmount() {
    this.amount.hidden = this.goal.value === "cover";
    this.amount.required = !this.amount.hidden;
    if (this.amount.required) Object.assign(this.amount, limits(this.fields[this.goal.value]));
  }

  places(part) {
    const { which, text } = this.lists[part];
    if (which.value === "keep") return null;
    return which.value === "own" ? PLACES[part].read(text.value) : [];
  }

  async save() {
    const name = this.name.value;
    try {
      const sensors = this.boxes.map((box) => box.firstChild).filter(({ checked }) => checked).map(({ value }) => value);
      if (!sensors.length) throw new Error("Choose at least one sensor.");
      const { changed, dropped } = await send("PUT", siteUrl(this.site.stem, `plans/${encodeURIComponent(name)}`), {
        title: this.title.value, sensors, at_least: this.least.value === "" ? null : Number(this.least.value),
        goal: this.goal.value, amount: this.amount.hidden ? null : Number(this.amount.value),
        mandatory: this.places("mandatory"), forbidden: this.places("forbidden"), base: this.base?.name ?? null, replace: this.edit,
      }, { version: this.version });
      this.dialog.close();
      if (dropped) note(dropped, "warn");
      note(changed.length ? `Saved: ${changed.join(", ")}. The page Run solves plan ${name}.` : "Saved; no file changed.");
      dispatchEvent(new Event("planschange"));
    } catch (error) {
      this.told.replaceChildren(el("p", { className: "message bad" }, error.message));
    }
  }
}
