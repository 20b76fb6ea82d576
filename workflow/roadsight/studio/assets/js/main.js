// The frame around the pages: token, site, theme, keys, and which page is shown.

import { get, takeToken } from "./api.js";
import { button, el, failed, note, showKeys, typing } from "./dom.js";
import { newSite } from "./new_site.js";

const PAGES = {
  edges: { title: "Road edges", load: () => import("./edges/page.js") },
  registration: { title: "Registration", load: () => import("./registration/page.js") },
  results: { title: "Results", load: () => import("./results/page.js") },
  run: { title: "Run", load: () => import("./run/page.js") },
};
const GROUPS = { own: "Own sites", sample: "Generated samples", audit: "Audits and trade-offs", absent: "Cannot run here" };
const KEYS = { "Alt 1…4": "page", "T": "theme", "?": "these keys" };
const THEME = "roadsight-theme";
const studio = (window.studio = { page: null, project: null, refresh });

const address = () => {
  const [, page, name] = /^#\/(\w+)\/([^/]+)$/.exec(location.hash) ?? [];
  const { sites } = studio.project;
  return { page: PAGES[page] ? page : "edges", site: sites.find(({ stem }) => encodeURIComponent(stem) === name) ?? sites[0] };
};
const addressOf = (page, { stem }) => `#/${page}/${encodeURIComponent(stem)}`;

function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  localStorage.setItem(THEME, theme);
  const toggle = document.getElementById("theme");
  toggle.setAttribute("aria-pressed", theme === "dark");
  window.dispatchEvent(new Event("themechange"));
}

const flipTheme = () => setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark");

function fillTop(page, site) {
  const list = document.getElementById("site");
  const groups = Object.entries(GROUPS).map(([group, label]) => el("optgroup", { label }, studio.project.sites.filter((one) => one.group === group).map(({ stem }) => el("option", { value: stem }, stem))));
  list.replaceChildren(...groups.filter((group) => group.children.length));
  list.value = site.stem;
  list.title = site.title;
  list.onchange = () => { location.hash = addressOf(address().page, { stem: list.value }); };
  document.getElementById("tabs").replaceChildren(...Object.entries(PAGES).map(([name, { title }]) => tab(name, title, site, name === page)));
}

// A page that cannot work on the site says why, and leads nowhere.
function tab(name, title, site, current) {
  const reason = site.cannot[name];
  const shown = { "aria-current": current ? "page" : null };
  if (!reason) return el("a", { href: addressOf(name, site), ...shown }, title);
  return el("a", { role: "link", "aria-disabled": "true", tabIndex: 0, ...shown }, title, " ", el("small", {}, reason));
}

// What is there of each site changes with runs and saves.
async function refresh() {
  studio.project = await get("project");
  const { page, site } = address();
  fillTop(page, site);
}

async function show() {
  const { page, site } = address();
  const main = document.getElementById("main");
  studio.page?.close?.();
  studio.page = null;
  fillTop(page, site);
  document.title = `${PAGES[page].title} · ${site.stem} · roadsight studio`;
  main.replaceChildren(el("p", { className: "loading" }, "Loading…"));
  const turn = (studio.turn = Symbol(page));
  try {
    if (site.cannot[page]) throw new Error(`This page cannot work on ${site.stem}: ${site.cannot[page]}.`);
    if (site.error) throw new Error(site.error);
    const opened = await (await PAGES[page].load()).open(site, studio.project);
    if (studio.turn !== turn) return opened.close?.();
    main.replaceChildren(opened.element);
    studio.page = opened;
    opened.onShown?.();
  } catch (error) {
    if (studio.turn === turn) main.replaceChildren(problem(error, site));
  }
}

// What to do where a page cannot be shown.
function problem(error, site) {
  const box = el("div", { className: "page" }, el("h1", {}, site.title), el("p", { className: "message bad", role: "alert" }, error.message));
  if (site.command && !site.there.cloud) {
    box.append(el("p", {}, "This site has no results yet. Run first, in the project's folder:"), el("p", {}, el("code", {}, site.command)));
    box.append(el("p", {}, el("a", { href: addressOf("run", site) }, "or start it on the page Run")));
  }
  box.append(el("p", {}, button("Try again", start)));
  return box;
}

function onKey(event) {
  if (typing(event) || document.querySelector("dialog[open]")) return;
  const number = event.altKey && /^Digit[1-9]$/.test(event.code) ? Number(event.code.slice(5)) : 0;
  const page = Object.keys(PAGES)[number - 1];
  if (page) location.hash = addressOf(page, address().site);
  else if (event.key === "?") showKeys({ ...KEYS, ...studio.page?.keys });
  else if (event.key === "t" && !event.ctrlKey && !event.metaKey) flipTheme();
  else if (!studio.page?.onKey?.(event)) return;
  event.preventDefault();
}

async function start() {
  const main = document.getElementById("main");
  try {
    studio.project = await get("project");
  } catch (error) {
    const box = el("div", { className: "page" }, el("h1", {}, "The studio cannot open the project"));
    main.replaceChildren(box);
    box.append(el("p", { className: "message bad", role: "alert" }, error.message), button("Try again", start));
    return;
  }
  if (studio.project.broken) note(studio.project.broken, "bad", 60);
  if (!studio.project.sites.length) {
    main.replaceChildren(el("div", { className: "page" }, el("p", { className: "message" }, "No site yet. Add a cloud above, or write one with: roadsight init CLOUD")));
    return;
  }
  await show();
}

takeToken();
setTheme(localStorage.getItem(THEME) ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"));
document.getElementById("theme").onclick = flipTheme;
document.getElementById("help").onclick = () => showKeys({ ...KEYS, ...studio.page?.keys });
document.getElementById("add").onclick = () => newSite(async (stem) => {
  await refresh();
  location.hash = addressOf("run", { stem });
});
addEventListener("planschange", () => refresh().catch(failed));
addEventListener("hashchange", () => { takeToken(); show(); });
addEventListener("keydown", onKey);
await start();
