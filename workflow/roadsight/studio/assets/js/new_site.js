// A cloud of this machine becomes a site: what was found, assumed, to be doubted; then its file is written.

import { send } from "./api.js";
import { button, el, note } from "./dom.js";

// onwritten: called with the name of the new site.
export function newSite(onwritten) {
  const path = el("input", { type: "text", required: true, placeholder: "/path/to/cloud.laz", "data-do": "cloud-path" });
  const name = el("input", { type: "text", maxLength: 100, placeholder: "as the file", "data-do": "cloud-name" });
  const told = el("div", { role: "status" });
  const write = button("Write the site file", () => call(true), { className: "primary", disabled: true, "data-do": "write-site" });
  const look = el("button", { type: "submit", "data-do": "look-cloud" }, "Look at it");
  const given = {};
  const dialog = el("dialog", { className: "form", "aria-label": "Add a cloud", onclose: () => dialog.remove() });

  async function call(written) {
    look.disabled = write.disabled = true;
    if (!written) told.replaceChildren(el("p", { className: "muted" }, "Reading the cloud…"));
    try {
      const values = Object.fromEntries(Object.entries(given).filter(([, value]) => value));
      const answer = await send("POST", "clouds", { path: path.value, site: name.value, given: values, write: written });
      if (!dialog.isConnected) return;
      if (!answer.written) told.replaceChildren(...answerParts(answer, given));
      write.disabled = answer.written;
      if (!answer.written) return;
      dialog.close();
      note(`Wrote ${answer.file}.`);
      onwritten(answer.site);
    } catch (error) {
      told.replaceChildren(el("p", { className: "message bad", role: "alert" }, error.message));
    } finally {
      look.disabled = false;
    }
  }

  path.oninput = name.oninput = () => { write.disabled = true; };
  dialog.append(el("form", { onsubmit: (event) => { event.preventDefault(); call(false); } },
    el("h1", {}, "Add a cloud"), el("p", {}, "A LAS or LAZ file on this machine. It is read where it lies; nothing is copied."),
    el("label", { className: "field" }, el("span", {}, "File"), path), el("label", { className: "field" }, el("span", {}, "Name of the site"), name), told,
    el("div", { className: "row" }, look, write, button("Cancel", () => dialog.close()))));
  document.body.append(dialog);
  dialog.showModal();
  path.focus();
}

function answerParts({ file, found, assumed, doubts, missing, text }, given) {
  const part = (title, sentences, kind = "") => (sentences.length ? [el("h2", {}, title), el("ul", { className: `told ${kind}` }, sentences.map((one) => el("li", {}, one)))] : []);
  const fill = Object.entries(missing).map(([key, comment]) => el("label", { className: "field" }, el("span", {}, `${key}: ${comment}`),
    el("input", { type: "text", value: given[key] ?? "", "data-do": `given-${key}`, oninput: ({ target }) => { given[key] = target.value.trim(); } })));
  return [...part("Found", found), ...part("Assumed", Object.entries(assumed).map(([key, comment]) => `${key}: ${comment}`)), ...part("To doubt", doubts, "doubt"),
    ...(fill.length ? [el("h2", {}, "To fill in, now or in the file"), ...fill] : []), el("details", {}, el("summary", {}, file), el("pre", { className: "log", tabIndex: 0 }, text))];
}
