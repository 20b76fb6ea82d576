// A picture that opens in a larger view: by a click or a key, closed by Escape or another click.

import { button, el } from "./dom.js";

// picture: canvas, image or SVG; name: what it shows; larger(): the same again, to be shown large.
export function enlargeable(picture, name, larger = () => copyOf(picture)) {
  return button(picture, () => {
    const dialog = el("dialog", { className: "large", "aria-label": name, onclose: () => dialog.remove() });
    const close = button("Close", () => dialog.close());
    const shown = larger();
    shown.addEventListener("click", () => dialog.close());
    dialog.append(el("div", { className: "row" }, el("b", { className: "wide" }, name), close), shown);
    document.body.append(dialog);
    dialog.showModal();
  }, { className: "enlarge", title: "Larger", "aria-label": `${name}: larger`, "data-do": "enlarge" });
}

function copyOf(picture) {
  const copy = picture.cloneNode(true);
  if (picture instanceof HTMLCanvasElement) copy.getContext("2d").drawImage(picture, 0, 0);
  return copy;
}
