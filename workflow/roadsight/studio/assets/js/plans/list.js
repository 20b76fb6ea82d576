// The plans that a site has of its own: new ones, changed ones, and away with them.

import { get, send, siteUrl } from "../api.js";
import { ask, button, el, failed, note } from "../dom.js";
import { planForm } from "./form.js";

export class PlanList {
  constructor(site) {
    this.site = site;
    this.element = el("section", { "aria-label": "Plans of this site" });
    this.changed = () => this.load();
    addEventListener("planschange", this.changed);
  }

  async load() {
    if (!this.site.jobs.includes("placement")) return;
    try {
      const { plans, version } = await get(siteUrl(this.site.stem, "plans"));
      this.version = version;
      this.show(plans.filter(({ own }) => own));
    } catch (error) {
      failed(error);
    }
  }

  show(own) {
    const open = (options) => planForm(this.site, options).catch(failed);
    const rows = own.map(({ name, title }) => el("li", {}, button(title, () => open({ base: name, edit: true }), { title: name, "data-do": `edit-${name}` }),
      button("Remove", () => this.remove(name), { "aria-label": `Remove plan ${name}`, "data-do": `remove-${name}` })));
    this.element.replaceChildren(el("h2", {}, "Plans of this site alone"), el("ul", { className: "list" }, rows),
      button("New plan…", () => open({}), { "data-do": "new-plan" }));
  }

  async remove(name) {
    if (!(await ask(`Remove plan ${name}?`, "It goes from the site file, with the places that were saved for it. Results stay.", "Remove"))) return;
    try {
      await send("DELETE", siteUrl(this.site.stem, `plans/${encodeURIComponent(name)}`), {}, { version: this.version });
      note(`Removed: plan ${name}.`);
      dispatchEvent(new Event("planschange"));
    } catch (error) {
      failed(error);
    }
  }

  close() { removeEventListener("planschange", this.changed); }
}
