// What is stale, a run and how far it is, what it has told.

import { get, send } from "../api.js";
import { ask, button, choice, el, failed, note, select } from "../dom.js";
import { PlanList } from "../plans/list.js";
import { evidenceParts } from "./evidence.js";
import { progressPart } from "./progress.js";
import { stalePart } from "./stale.js";

const TARGETS = {
  all: "Everything the sites ask for", placement: "Placement of sensors", poles: "Poles", scene: "Scene: pavement and edges",
  report: "Report", tradeoffs: "Accuracy and time (long)", hardcases: "Hard cases", audit: "Audit of effects (long)",
};
const BUSY_MS = 1200;
const IDLE_MS = 5000;

class RunPage {
  constructor(site, project) {
    Object.assign(this, { site, project, state: null, plan: null, order: {} });
    this.keys = { L: "look what is stale", S: "start", X: "stop" };
    this.panel = el("div", { className: "panel" });
    this.plans = new PlanList(site);
    this.progress = el("section", { className: "part", "aria-label": "Progress" });
    this.stale = el("section", { className: "part", "aria-label": "What is stale" });
    this.evidence = el("div");
    this.element = el("div", { className: "split" }, this.panel, el("div", { className: "page" }, this.progress, this.stale, this.evidence));
  }

  async open() {
    this.state = await get("run");
    Object.assign(this.order, this.state.usual, { site: this.site.stem });
    if (this.state.order) Object.assign(this.order, { target: this.state.order.target, cores: this.state.order.cores, site: this.state.order.site && this.site.stem });
    this.show();
    await this.plans.load();
    this.evidence.replaceChildren(...(await evidenceParts(this.site)));
    this.wait();
    return this;
  }

  wait() {
    clearTimeout(this.timer);
    if (!this.closed) this.timer = setTimeout(() => this.poll(), this.state.running ? BUSY_MS : IDLE_MS);
  }

  async poll() {
    const before = this.state;
    try {
      this.state = await get("run");
      this.lost = "";
    } catch (error) {
      this.lost = error.message;
    }
    if (this.closed) return;
    if (JSON.stringify(before) !== JSON.stringify(this.state) || this.lost !== this.wasLost) this.show();
    this.wasLost = this.lost;
    if (before.running && !this.state.running) this.ended();
    this.wait();
  }

  async ended() {
    const words = { done: "The run is finished", stopped: "The run was stopped", failed: "The run failed", lost: "The run ended without saying how" };
    note(words[this.state.status] ?? "The run ended", this.state.status === "done" ? "good" : "bad");
    this.plan = null;
    window.studio.refresh().catch(failed);
    this.evidence.replaceChildren(...(await evidenceParts(this.site)));
    this.show();
  }

  get free() { return !this.state.running && !this.state.outside.length && !this.state.locked; }

  show() {
    const held = document.activeElement?.dataset?.do;
    this.panel.replaceChildren(this.orderPart(), ...this.obstacles(), this.plans.element);
    this.progress.replaceChildren(...progressPart(this.state, this.lost));
    this.progress.hidden = !this.state.order && !this.lost;
    this.stale.replaceChildren(...stalePart(this.plan, this.looking, this.problem));
    if (held) this.element.querySelector(`[data-do="${held}"]`)?.focus();
  }

  orderPart() {
    const { order, state, project } = this;
    const change = (name, value) => { order[name] = value; this.plan = null; this.problem = ""; this.show(); };
    const sites = choice({ one: `Only ${this.site.stem}`, all: "All of the settings" }, order.site ? "one" : "all",
      (value) => change("site", value === "one" ? this.site.stem : null), "Sites");
    const cores = el("input", { type: "number", min: 1, max: state.most_cores, value: order.cores, "data-do": "cores", onchange: () => {
      change("cores", Math.max(1, Math.min(state.most_cores, Math.round(Number(cores.value)) || 1)));
    } });
    const busy = state.running || Boolean(this.waiting);
    return el("section", {}, el("h1", {}, "Run the workflow"),
      el("div", { className: "row" }, sites),
      el("p", {}, el("small", {}, order.site ? `The report then shows this site alone.` : `Sites: ${project.configured.join(", ")}`)),
      el("div", { className: "row" }, select(TARGETS, order.target, (value) => change("target", value), { "aria-label": "What to make", className: "wide", "data-do": "target" })),
      el("div", { className: "row" }, el("label", {}, "Cores", cores), el("small", {}, `of ${state.most_cores}`)),
      el("div", { className: "row" },
        button("Look what is stale", () => this.look(), { disabled: Boolean(this.looking), "data-do": "look" }),
        state.running
          ? button(state.status === "stopping" ? "Stop at once" : "Stop", () => this.stop(), { className: "danger", "data-do": "stop" })
          : button("Start", () => this.start(), { className: "primary", disabled: busy || !this.free, "data-do": "start" })));
  }

  // What keeps a run from starting, and the one thing to do about it.
  obstacles() {
    const { state } = this;
    if (state.outside.length) {
      return [el("p", { className: "message", role: "status" }, `The workflow runs outside the studio (process ${state.outside.map(({ pid }) => pid).join(", ")}). Wait for it, or stop it where it was started; its results appear here.`)];
    }
    if (!state.locked) return [];
    return [el("div", { className: "message bad", role: "alert" },
      el("p", {}, "A run that was killed has left its lock. If no other machine runs this project, remove it; nothing that was finished is lost."),
      button("Remove the lock", () => this.unlock(), { "data-do": "unlock" }))];
  }

  async look() {
    if (this.looking) return;
    this.looking = true;
    this.problem = "";
    this.show();
    try {
      this.plan = await send("POST", "run/plan", this.order);
    } catch (error) {
      this.plan = null;
      this.problem = error.message;
    }
    this.looking = false;
    if (!this.closed) this.show();
  }

  async act(call) {
    this.waiting = true;
    this.show();
    try {
      this.state = await call();
    } catch (error) {
      failed(error);
    }
    this.waiting = false;
    if (this.closed) return;
    this.show();
    this.wait();
  }

  start() {
    if (!this.free || this.waiting) return;
    this.plan = null;
    this.act(() => send("POST", "run/start", this.order));
  }

  stop() {
    if (this.state.running) this.act(() => send("POST", "run/stop", { firmly: this.state.status === "stopping" }));
  }

  async unlock() {
    const sure = await ask("Remove the lock?", "Do this only if the workflow runs nowhere, on no other machine either. Two runs at once would undo each other's results.", "Remove");
    if (sure) this.act(() => send("POST", "run/unlock", {}));
  }

  onKey({ key }) {
    if (key === "l") this.look();
    else if (key === "s") this.start();
    else if (key === "x") this.stop();
    else return false;
    return true;
  }

  close() {
    this.closed = true;
    clearTimeout(this.timer);
    this.plans.close();
  }
}

export const open = (site, project) => new RunPage(site, project).open();
