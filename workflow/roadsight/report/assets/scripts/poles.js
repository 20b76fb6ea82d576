// The poles of one site: the pole and the image shown, and everything that follows them.

class PolesPart {
  constructor(section, tooltip) {
    this.section = section;
    this.content = readPoles(JSON.parse(this.find(".poles-data").textContent));
    this.pole = null;
    this.image = 0;
    this.map = new PolesMap(this.find(".poles-map"), this.content, this, tooltip);
    this.strip = new ImageStrip(section, this.content.images, this.content.poles, this);
    this.listen();
    this.showPole();
    if (this.content.images.length) this.strip.show(false);
  }

  find(selector) {
    return this.section.querySelector(selector);
  }

  all(selector) {
    return [...this.section.querySelectorAll(selector)];
  }

  choosePole(number, reveals = true) {
    this.pole = number;
    if (number !== null && reveals) this.map.reveal(this.content.poles[number]);
    this.showPole();
    this.redraw();
  }

  showImage(number, scrolls = true) {
    this.image = number;
    this.strip.show(scrolls);
    this.map.draw();
  }

  redraw() {
    this.map.draw();
    if (this.content.images.length) this.strip.draw();
  }

  showPole() {
    for (const row of this.all("[data-pole-row]")) mark(row, Number(row.dataset.poleRow) === this.pole);
    const note = this.find("[data-pole-text]");
    note.replaceChildren();
    if (this.pole === null) {
      note.textContent = "All poles. Click one to see which images saw it.";
      return;
    }
    note.append(`${poleText(this.content, this.pole)}`, ...this.hazardLines(), document.createElement("br"));
    note.append(this.button("Show all poles", () => this.choosePole(null)), this.imagesOf(this.pole));
  }

  hazardLines() {
    const row = this.content.hazardOf.get(this.content.poles[this.pole].id);
    const offset = row?.offset_m;
    return typeof offset === "number" ? [`\n${formatNumber(offset, 2)} m from the road edge`] : [];
  }

  // Images that saw a pole: buttons for the embedded ones, names for the others.
  imagesOf(number) {
    const list = document.createElement("ul");
    list.className = "seen-in";
    for (const camera of this.content.poles[number].cameras) {
      const item = document.createElement("li");
      const name = this.content.cameras.images[camera];
      const shown = this.content.cameras.shown[camera];
      if (shown < 0) item.textContent = name;
      else item.append(this.thumbnail(name, shown));
      list.append(item);
    }
    return list;
  }

  thumbnail(name, shown) {
    const button = this.button(name, () => this.showImage(shown));
    button.className = "thumb";
    const picture = this.strip.pictures[shown];
    if (picture) button.prepend(Object.assign(new Image(), { src: picture.src, alt: "" }));
    return button;
  }

  button(text, action) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = text;
    button.addEventListener("click", action);
    return button;
  }

  listen() {
    this.section.addEventListener("change", ({ target }) => {
      const { polesLayer, photoLayer } = target.dataset;
      if (polesLayer !== undefined) this.map.layers[polesLayer] = target.checked;
      if (photoLayer !== undefined) this.strip.layers[photoLayer] = target.checked;
      if (polesLayer !== undefined || photoLayer !== undefined) this.redraw();
    });
    this.section.addEventListener("click", ({ target }) => {
      const { choosePole, photo, sortBy } = target.closest("button")?.dataset ?? {};
      if (choosePole !== undefined) this.choosePole(this.pole === Number(choosePole) ? null : Number(choosePole));
      if (photo !== undefined) this.showImage(Number(photo), false);
      if (sortBy !== undefined) sortTable(target.closest("table"), Number(sortBy));
    });
  }

  pause() {}

  resume() {
    this.redraw();
  }

  recolour() {
    this.map.recolour();
    this.redraw();
  }

  print() {
    this.map.recolour();
    this.map.paintAll();
  }
}

// Rows by the values of a column; the other way round when it is sorted so already. Empty ones last.
function sortTable(table, column) {
  const heads = [...table.tHead.rows[0].cells];
  const down = heads[column].getAttribute("aria-sort") === "ascending";
  heads.forEach((head) => head.removeAttribute("aria-sort"));
  heads[column].setAttribute("aria-sort", down ? "descending" : "ascending");
  const value = (row) => row.cells[column].dataset.value ?? "";
  const compare = (a, b) => {
    const [x, y] = [value(a), value(b)];
    if (x === "" || y === "") return (x === "") - (y === "");
    const order = Number.isNaN(Number(x)) || Number.isNaN(Number(y)) ? x.localeCompare(y, "en", { numeric: true }) : x - y;
    return down ? -order : order;
  };
  const body = table.tBodies[0];
  body.append(...[...body.rows].sort(compare));
}
