// A strip of images, and the chosen one with what was projected onto it and found in it.

class ImageStrip {
  constructor(section, images, poles, state) {
    Object.assign(this, { images, poles, state });
    this.canvas = section.querySelector("canvas.photo");
    if (!this.canvas) return;
    this.context = this.canvas.getContext("2d");
    this.caption = section.querySelector("[data-photo-text]");
    this.buttons = [...section.querySelectorAll("[data-photo]")];
    this.layers = { lidar: true, edges: true, axes: true };
    this.pictures = images.map(({ jpeg }) => (jpeg === null ? null : new Image()));
    this.pictures.forEach((picture, i) => this.load(picture, i));
    this.canvas.addEventListener("click", (event) => this.click(event));
    this.canvas.addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.draw()).observe(this.canvas.parentElement);
  }

  load(picture, i) {
    if (!picture) return;
    picture.alt = "";
    picture.addEventListener("load", () => {
      if (i === this.state.image) this.draw();
    });
    picture.src = `data:image/jpeg;base64,${this.images[i].jpeg}`;
    this.buttons[i].prepend(picture);
  }

  key(event) {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!step || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    this.state.showImage((this.state.image + step + this.images.length) % this.images.length);
  }

  show(scrolls) {
    if (!this.canvas) return;
    const image = this.images[this.state.image];
    this.buttons.forEach((button, i) => button.setAttribute("aria-pressed", i === this.state.image));
    const button = this.buttons[this.state.image];
    const strip = button.parentElement;
    strip.scrollLeft = button.offsetLeft - strip.offsetLeft - (strip.clientWidth - button.offsetWidth) / 2;
    this.caption.textContent = imageText(image);
    this.canvas.setAttribute("aria-label", `Image ${image.image} with overlays. Left and right arrow keys show the neighbours.`);
    if (scrolls) this.canvas.scrollIntoView({ block: "nearest" });
    this.draw();
  }

  draw() {
    const image = this.images[this.state.image];
    const width = this.canvas.parentElement.clientWidth;
    if (!image || width === 0) return;
    const ratio = window.devicePixelRatio || 1;
    const height = (width * image.height_px) / image.width_px;
    this.canvas.style.height = `${height}px`;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    this.scale = width / image.width_px;
    this.context.setTransform(ratio * this.scale, 0, 0, ratio * this.scale, 0, 0);
    const picture = this.pictures[this.state.image];
    this.context.fillStyle = "#2a3138";
    this.context.fillRect(0, 0, image.width_px, image.height_px);
    if (picture?.complete && picture.naturalWidth) this.context.drawImage(picture, 0, 0, image.width_px, image.height_px);
    if (this.layers.edges) this.points(image, image.edges, "photo-image");
    if (this.layers.lidar) this.points(image, image.lidar, "photo-lidar");
    if (this.layers.axes) image.axes.forEach((axis) => this.axis(axis));
  }

  points({ steps_per_px }, points, name) {
    const { context } = this;
    const zoom = this.canvas.width / this.images[this.state.image].width_px;
    const side = Math.max(2, Math.round(1.8 * zoom));
    const place = (value) => Math.round((value / steps_per_px) * zoom - side / 2);
    context.save();
    context.resetTransform();
    context.fillStyle = this.state.map.colour(name);
    for (let i = 0; i < points.length; i += 2) context.fillRect(place(points[i]), place(points[i + 1]), side, side);
    context.restore();
  }

  axis({ line: [u0, v0, u1, v1], kept, pole }) {
    const { context, state } = this;
    const colour = state.map.colour;
    const chosen = pole >= 0 && pole === state.pole;
    context.lineCap = "round";
    for (const [width, style] of [[4.5, "#10151b"], [chosen ? 3.5 : 2.2, colour(chosen ? "photo-chosen" : kept ? "photo-pole" : "photo-dropped")]]) {
      context.strokeStyle = style;
      context.lineWidth = width;
      context.setLineDash(kept ? [] : [5, 5]);
      context.beginPath();
      context.moveTo(u0, v0);
      context.lineTo(u1, v1);
      context.stroke();
    }
    context.setLineDash([]);
  }

  click(event) {
    const image = this.images[this.state.image];
    const [u, v] = [event.offsetX / this.scale, event.offsetY / this.scale];
    const apart = ({ line: [u0, v0, u1, v1] }) => {
      const length = (u1 - u0) ** 2 + (v1 - v0) ** 2;
      const share = Math.min(Math.max(((u - u0) * (u1 - u0) + (v - v0) * (v1 - v0)) / (length || 1), 0), 1);
      return Math.hypot(u - u0 - share * (u1 - u0), v - v0 - share * (v1 - v0));
    };
    const hit = image.axes.filter(({ pole }) => pole >= 0).sort((a, b) => apart(a) - apart(b))[0];
    if (hit && apart(hit) < 10) this.state.choosePole(hit.pole);
  }
}

const sideways = (value, unit) => `${formatNumber(Math.abs(value), 2)}${unit} to the ${value < 0 ? "left" : "right"}`;

function imageText(image) {
  const facts = [`${image.image}: ${STATE_TEXTS[image.state]}${image.reason ? ` (${image.reason})` : ""}`];
  if (image.residual_px !== null) facts.push(`residual ${formatNumber(image.residual_px, 1)} px`);
  if (image.yaw_deg !== null) facts.push(`turned ${sideways(image.yaw_deg, "°")}`);
  if (image.lateral_m !== null) facts.push(`moved ${sideways(image.lateral_m, " m")}`);
  facts.push(`${formatNumber(image.station_m ?? 0)} m along route ${image.route}`);
  const dropped = image.axes.filter(({ kept }) => !kept).map(({ reason }) => reason || "no reason given");
  facts.push(`${counted(image.axes.length - dropped.length, "pole")} kept${dropped.length ? `, ${dropped.length} left out (${[...new Set(dropped)].join(", ")})` : ""}`);
  return `${facts.join(" · ")}.`;
}
