// Small helpers for building pages.

export function el(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name in element && name !== "list" && name !== "form") element[name] = value;
    else if (value !== null && value !== undefined && value !== false) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return element;
}

export const button = (text, onclick, attributes = {}) => el("button", { type: "button", onclick, ...attributes }, text);

// Buttons of which one is pressed.
export function choice(options, value, onchange, label) {
  const group = el("span", { className: "group", role: "group", "aria-label": label });
  const press = (name) => [...group.children].forEach((one) => one.setAttribute("aria-pressed", one.dataset.value === name));
  for (const [name, text] of Object.entries(options)) {
    group.append(button(text, () => { press(name); onchange(name); }, { "data-value": name }));
  }
  for (const one of group.children) one.dataset.value = one.getAttribute("data-value") ?? one.dataset.value;
  press(value);
  group.press = press;
  return group;
}

// What a field of the server's schemas asks of an input: its type and range. In patterns of inputs a
// hyphen that ends a set of characters is escaped.
export function limits({ type, minimum, exclusiveMinimum, maximum, exclusiveMaximum, minLength, maxLength, pattern }) {
  if (type === "string") {
    return { type: "text", required: Boolean(minLength || pattern), ...(maxLength && { maxLength }), ...(pattern && { pattern: pattern.replaceAll("-]", "\\-]") }) };
  }
  return { type: "number", step: type === "integer" ? "1" : "any", min: minimum ?? exclusiveMinimum ?? "", max: maximum ?? exclusiveMaximum ?? "" };
}

export const fieldInput = (field, attributes = {}) => el("input", { ...limits(field), ...attributes });
export const fieldLabel = ({ description }) => description[0].toUpperCase() + description.slice(1);

export function select(options, value, onchange, attributes = {}) {
  const list = el("select", { onchange: () => onchange(list.value), ...attributes });
  list.append(...Object.entries(options).map(([name, text]) => el("option", { value: name }, text)));
  list.value = value;
  return list;
}

export function note(text, kind = "good", seconds = kind === "good" ? 5 : 15) {
  const place = document.getElementById("notes");
  const box = el("div", { className: `note ${kind}` }, el("span", {}, text));
  box.append(button("Close", () => box.remove()));
  place.append(box);
  while (place.children.length > 4) place.firstChild.remove();
  setTimeout(() => box.remove(), 1000 * seconds);
}

export const failed = (error) => { if (error.name !== "AbortError") note(error.message, "bad"); };

export function ask(title, text, yes = "OK") {
  return new Promise((resolve) => {
    const dialog = el("dialog", { onclose: () => { resolve(dialog.returnValue === "yes"); dialog.remove(); } });
    const end = (value) => button(value === "yes" ? yes : "Cancel", () => dialog.close(value), { className: value === "yes" ? "primary" : "" });
    dialog.append(el("h1", {}, title), el("p", {}, text), el("div", { className: "row" }, end("yes"), end("no")));
    document.body.append(dialog);
    dialog.showModal();
  });
}

export function showKeys(keys) {
  const dialog = el("dialog", { "aria-label": "Keys", onclose: () => dialog.remove() });
  const rows = Object.entries(keys).flatMap(([key, text]) => [
    el("dt", {}, ...key.split(" ").map((part) => el("kbd", {}, part))), el("dd", {}, text),
  ]);
  dialog.append(el("h1", {}, "Keys"), el("dl", { className: "keys" }, rows), button("Close", () => dialog.close(), { className: "primary" }));
  document.body.append(dialog);
  dialog.showModal();
}

// Colours of the style sheet, as they are in the present theme.
export function themeColour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

export const typing = (event) => /^(INPUT|TEXTAREA|SELECT)$/.test(event.target.tagName ?? "") && event.target.type !== "range";

export const digits = (value, places) => (Number.isFinite(value) ? value.toFixed(places) : "–");
