// One site at a time; the others wait unread.

const tooltip = {
  element: document.querySelector(".tooltip"),
  show(text, x, y) {
    this.element.textContent = text;
    this.element.hidden = false;
    const { offsetWidth, offsetHeight } = this.element;
    this.element.style.left = `${Math.min(x + 14, window.innerWidth - offsetWidth - 8)}px`;
    this.element.style.top = `${Math.min(y + 14, window.innerHeight - offsetHeight - 8)}px`;
  },
  hide() {
    this.element.hidden = true;
  },
};

const sections = [...document.querySelectorAll(".site")];
const opened = new Map();

function showSite(section) {
  for (const other of sections) {
    other.hidden = other !== section;
    if (other !== section) for (const part of opened.get(other) ?? []) part.pause();
  }
  for (const link of document.querySelectorAll(".site-link")) {
    const current = link.hash === `#${section.id}`;
    mark(link, current);
    link.nextElementSibling.hidden = !current;
  }
  if (opened.has(section)) for (const part of opened.get(section)) part.resume();
  else opened.set(section, partsOf(section));
}

function partsOf(section) {
  const parts = [[".site-data", Site], [".poles-data", PolesPart]];
  return parts.filter(([data]) => section.querySelector(data)).map(([, Part]) => new Part(section, tooltip));
}

function followAnchor() {
  const target = document.getElementById(location.hash.slice(1));
  const section = target?.closest(".site");
  if (!section) return;
  if (section.hidden) showSite(section);
  target.scrollIntoView();
}

showSite(sections[0]);
// Paper is light, whatever the screen is; maps are drawn anew for it at once.
function paintFor(paper) {
  document.documentElement.toggleAttribute("data-paper", paper);
  for (const part of [...opened.values()].flat()) paper ? part.print() : part.recolour();
}
window.addEventListener("beforeprint", () => {
  for (const details of document.querySelectorAll("details")) details.open = true;
  paintFor(true);
});
window.addEventListener("afterprint", () => paintFor(false));
window.addEventListener("hashchange", followAnchor);
followAnchor();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => [...opened.values()].flat().forEach((part) => part.recolour()));
