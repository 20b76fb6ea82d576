// What the tests of the report ask of the page.

window.shown = (selector) =>
  [...document.querySelectorAll(selector)].filter((element) => element.checkVisibility());

window.drawn = () =>
  new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));

// Number of pixels of the map by colour, as "r,g,b".
window.colours = () => {
  const map = shown("canvas.map")[0];
  const { data } = map.getContext("2d").getImageData(0, 0, map.width, map.height);
  const counts = {};
  for (let i = 0; i < data.length; i += 4) {
    const key = `${data[i]},${data[i + 1]},${data[i + 2]}`;
    counts[key] = (counts[key] ?? 0) + 1;
  }
  return counts;
};

window.colourOf = (name) => {
  const style = getComputedStyle(document.documentElement);
  const hex = style.getPropertyValue(`--${name}`).trim();
  return [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16)).join(",");
};

window.pixelsOf = (name) => drawn().then(() => colours()[colourOf(name)] ?? 0);

window.choose = (selector, value) => {
  const [element] = shown(selector);
  element.value = value;
  element.dispatchEvent(new Event("change", { bubbles: true }));
};

window.press = (key) =>
  shown("canvas.map")[0].dispatchEvent(new KeyboardEvent("keydown", { key }));

// Whether a touch with so many fingers comes to an element.
window.touch = (selector, fingers) => {
  const [target] = shown(selector);
  let reached = false;
  const listen = () => { reached = true; };
  target.addEventListener("touchstart", listen);
  const touches = Array.from({ length: fingers }, (_, identifier) =>
    new Touch({ identifier, target, clientX: 50 * identifier, clientY: 50 }));
  target.dispatchEvent(new TouchEvent("touchstart", { touches, bubbles: true, cancelable: true }));
  target.removeEventListener("touchstart", listen);
  return reached;
};

window.middleOf = (selector) => {
  const [element] = shown(selector);
  element.scrollIntoView({ behavior: "instant", block: "center" });
  const box = element.getBoundingClientRect();
  return [box.x + box.width / 2, box.y + box.height / 2];
};

// Height over width of the 3D view's units; 1 is true to scale.
window.heightScale = () => {
  const { aspectratio, xaxis, zaxis } = shown(".scene3d")[0].layout.scene;
  const scale = (side, { range }) => side / (range[1] - range[0]);
  return scale(aspectratio.z, zaxis) / scale(aspectratio.x, xaxis);
};

window.unnamedControls = () =>
  shown("button, select, input")
    .filter((e) => !(e.textContent.trim() || e.ariaLabel || e.labels?.length))
    .map((e) => e.outerHTML);

// Texts whose contrast with what they stand on is below 4.5 to 1 (WCAG AA).
window.faintTexts = () => {
  const numbers = (colour) => colour.match(/[\d.]+/g).map(Number);
  const linear = (byte) => {
    const share = byte / 255;
    return share <= 0.04045 ? share / 12.92 : ((share + 0.055) / 1.055) ** 2.4;
  };
  const luminance = ([r, g, b]) =>
    0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
  const behind = (element) => {
    for (let e = element; e; e = e.parentElement) {
      const colour = getComputedStyle(e).backgroundColor;
      if (colour.startsWith("rgb") && (numbers(colour)[3] ?? 1) === 1) return numbers(colour);
    }
    return [255, 255, 255];
  };
  const hasText = (e) => [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim());
  return shown("body *")
    .filter((e) => hasText(e) && !e.closest(".scene3d, script, style, option"))
    .map((e) => {
      const levels = [numbers(getComputedStyle(e).color), behind(e)].map(luminance);
      const ratio = (Math.max(...levels) + 0.05) / (Math.min(...levels) + 0.05);
      return { ratio, text: e.textContent.trim().slice(0, 40) };
    })
    .filter(({ ratio }) => ratio < 4.5);
};
