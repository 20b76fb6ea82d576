// What a run would do, and why.

import { el } from "../dom.js";
import { duration } from "./words.js";

export function stalePart(plan, looking, problem) {
  const parts = [el("h1", {}, "What is stale")];
  if (looking) return [...parts, el("p", { className: "muted", role: "status" }, "Snakemake is looking; this takes some seconds…")];
  if (problem) return [...parts, el("p", { className: "message bad", role: "alert" }, problem)];
  if (!plan) return [...parts, el("p", { className: "muted" }, "“Look what is stale” (L) asks Snakemake what a run would do, and why. Nothing is changed.")];
  if (!plan.jobs) return [...parts, el("p", { className: "message good", role: "status" }, "Nothing: all results are up to date.")];
  parts.push(el("p", { role: "status" }, summary(plan)));
  if (plan.open) parts.push(el("p", { className: "message" }, "The scene is looked at first; what it calls for may add steps to these."));
  const head = ["Rule", "Steps", "Why", "Core time"].map((text, n) => el("th", { scope: "col", className: n % 2 ? "number" : "" }, text));
  parts.push(el("div", { className: "scroll" }, el("table", { className: "stale" }, el("thead", {}, el("tr", {}, head)), el("tbody", {}, plan.rules.map(row)))));
  return parts;
}

function summary({ jobs, seconds, known, cores, rules }) {
  const own = rules.reduce((sum, rule) => sum + rule.own, 0);
  const time = known ? ` Earlier, ${known === jobs ? "these" : `${known} of these`} took ${duration(seconds)} of a core's time, so about ${duration(seconds / cores)} on ${cores} ${cores > 1 ? "cores" : "core"}.` : "";
  return `${jobs} ${jobs > 1 ? "steps" : "step"}: ${own} stale by ${own === 1 ? "itself" : "themselves"}, ${jobs - own} because a step before runs.${time}`;
}

function row({ rule, jobs, own, why, sites, seconds }) {
  const causes = why.map(({ text, jobs: count }) => el("li", {}, text, count < jobs ? ` (${count} of ${jobs})` : ""));
  const [first, ...rest] = causes;
  const reason = rest.length ? el("details", {}, el("summary", {}, ...first.childNodes, ` and ${rest.length} more`), el("ul", {}, rest)) : el("span", {}, ...first.childNodes);
  return el("tr", { "data-own": own > 0 }, el("th", { scope: "row" }, el("code", {}, rule), el("small", {}, ` ${sites.join(", ")}`)),
    el("td", { className: "number" }, String(jobs)), el("td", { className: "why" }, reason),
    el("td", { className: "number" }, seconds === null ? "–" : duration(seconds)));
}
