// How far a run is, its steps, and the log of one that failed.

import { get } from "../api.js";
import { button, el, failed } from "../dom.js";
import { duration, stepName } from "./words.js";

const WORDS = {
  running: ["Running", ""], stopping: ["Stopping: steps that are being worked on are given up", ""], done: ["Finished", "good"],
  stopped: ["Stopped; what was finished stays, start again to go on", ""], failed: ["Failed", "bad"],
  lost: ["The run was killed or the machine went down; what was finished stays, start again to go on", "bad"],
};
const opened = new Map();

export function progressPart(state, lost) {
  const parts = lost ? [el("p", { className: "message bad", role: "alert" }, lost)] : [];
  if (!state.order) return parts;
  const [words, kind] = WORDS[state.status];
  const share = state.total ? state.done / state.total : 0;
  const what = `${state.order.target} for ${state.order.site ?? "all sites of the settings"}`;
  parts.push(el("h1", {}, "Progress"), el("p", { className: `message ${kind}`, role: "status" }, `${words}: ${what}, after ${duration(state.seconds)}.`));
  if (state.total) parts.push(bar(state, share));
  else if (state.running) parts.push(el("p", { className: "muted" }, "Snakemake is working out the steps…"));
  else if (state.status === "done") parts.push(el("p", {}, "Nothing had to be done."));
  if (state.steps.length) parts.push(el("h2", {}, "Steps at work"), steps(state.steps));
  parts.push(...failures(state));
  if (state.last.length) parts.push(el("details", {}, el("summary", {}, "Last steps that were finished"), steps(state.last)));
  return parts;
}

function bar(state, share) {
  const left = state.left_s === null ? "" : `, about ${duration(state.left_s)} left by ${state.basis}`;
  const text = `${state.done} of ${state.total} steps, ${Math.floor(100 * share)} %${left}`;
  return el("div", {}, el("progress", { max: 1, value: share, "aria-label": "Share of steps that are finished" }), el("p", { className: "count" }, text));
}

const steps = (list) => el("ul", { className: "steps" }, list.map((step) => el("li", {}, el("code", {}, stepName(step)), ` ${duration(step.seconds)}`)));

// Steps that failed, each with its log, or what Snakemake said where no step had begun.
function failures(state) {
  if (state.failed.length) return [el("h2", {}, "Failed"), ...state.failed.map((step) => failure(state, step))];
  return state.status === "failed" ? [el("p", { className: "message bad", role: "alert" }, state.complaint)] : [];
}

function failure(state, step) {
  const key = `${state.begun_s}/${step.job}`;
  const place = el("div");
  const fill = ({ path, text }) => place.replaceChildren(el("p", {}, el("code", {}, path)), el("pre", { className: "log", tabIndex: 0, "aria-label": `Log of ${stepName(step)}` }, text || "The log is empty."));
  const show = async () => {
    try {
      opened.set(key, await get(`run/log/${step.job}`));
      fill(opened.get(key));
    } catch (error) {
      failed(error);
    }
  };
  if (opened.has(key)) fill(opened.get(key));
  else if (step.log) show();
  return el("div", { className: "failure" }, el("p", {}, el("b", {}, stepName(step)), ` failed after ${duration(step.seconds)} `, step.log ? button("Read its log again", show, { "data-do": `log${step.job}` }) : "and has no log."), place);
}
