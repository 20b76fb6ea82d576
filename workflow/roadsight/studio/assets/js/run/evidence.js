// What runs have told: pages to open, effects, frontiers of accuracy and time.

import { get, siteUrl } from "../api.js";
import { el, select } from "../dom.js";
import { enlargeable } from "../enlarge.js";

const told = (error) => [el("p", { className: "message bad", role: "alert" }, error.message)];

export async function evidenceParts(site) {
  const [pages, effects, frontiers] = await Promise.all([
    get("pages").then(pageList, told), get(siteUrl(site.stem, "effects")).then(effectsTable, told), get("frontiers").then(frontierPart, told),
  ]);
  const part = (title, children) => el("section", { className: "part", "aria-label": title }, el("h1", {}, title), children);
  return [part("Pages", pages), part(`Effects at ${site.stem}`, effects), part("Accuracy and time", frontiers)];
}

function pageList({ pages }) {
  if (!pages.length) return [el("p", { className: "muted" }, "None yet: the workflow writes a report at its end.")];
  return [el("p", { className: "pages" }, pages.map(({ title, url }) => el("a", { href: url, target: "_blank", rel: "noopener" }, title)))];
}

const amount = (value) => (Number.isFinite(value) ? Number(value.toPrecision(3)).toLocaleString("en") : "–");

function effectsTable({ effects }) {
  if (!effects.length) return [el("p", { className: "muted" }, "No decisions yet: a run looks at the scene first.")];
  const head = ["Effect", "Decision", "Measured", "Threshold", "Why"].map((text, n) => el("th", { scope: "col", className: n === 2 || n === 3 ? "number" : "" }, text));
  const rows = effects.map((row) => el("tr", {}, el("th", { scope: "row" }, row.effect.replaceAll("_", " ")),
    el("td", {}, el("b", { "data-decision": row.decision }, row.decision)),
    el("td", { className: "number" }, `${amount(row.value)} ${row.unit}`), el("td", { className: "number" }, `${amount(row.threshold)} ${row.unit}`), el("td", {}, row.reason)));
  const simulated = effects.filter(({ decision }) => decision === "simulate").length;
  return [el("p", {}, `${simulated} of ${effects.length} are simulated; the others change the answer too little at this site.`),
    el("div", { className: "scroll", tabIndex: 0, "aria-label": "Effects" }, el("table", {}, el("thead", {}, el("tr", {}, head)), el("tbody", {}, rows)))];
}

function frontierPart({ studies }) {
  if (!studies.length) return [el("p", { className: "muted" }, "Not measured here: choose “Accuracy and time” on the left and start; it takes hours.")];
  const place = el("div", { className: "frontiers" });
  const show = (number) => place.replaceChildren(...studies[number].views.map(frontier));
  const names = Object.fromEntries(studies.map(({ job, knob }, number) => [number, `${job}: ${knob}`]));
  show(0);
  return [el("div", { className: "row" }, el("label", {}, "Setting", select(names, "0", show, { "data-do": "study" }))), place];
}

function frontier({ title, svg, verdict, rows }) {
  const chart = el("div");
  chart.innerHTML = svg;
  const table = el("table", {}, el("thead", {}, el("tr", {}, ["Level", "CPU s", "MiB", "Value", "Error"].map((text, n) => el("th", { scope: "col", className: n ? "number" : "" }, text)))),
    el("tbody", {}, rows.map((row) => el("tr", {}, el("th", { scope: "row" }, row.level, row.is_default ? " (default)" : ""), [row.cpu_s, row.mib, row.value, row.error].map((text) => el("td", { className: "number" }, text))))));
  return el("figure", {}, el("figcaption", {}, el("b", {}, title), ` ${verdict}`), enlargeable(chart.firstElementChild, `Chart ${title}`), el("details", {}, el("summary", {}, "Figures"), table));
}
