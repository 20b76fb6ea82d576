// A map on a canvas: moving, zooming, pointing. What it draws is in map_layers.js.

const MAP_MARGIN_PX = 34;

class MapView {
  constructor(canvas, site, state, tooltip) {
    Object.assign(this, { canvas, site, state, tooltip });
    this.context = canvas.getContext("2d");
    this.layers = { relief: true, pavement: true, edges: true, candidates: true, targets: true, obstacles: true, sensors: true };
    this.active = false;
    this.listen();
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.recolour();
  }

  recolour() {
    this.colour = themeColours();
    this.reliefImage = shadeImage(this.site.relief, this.colour("shadow"), this.colour("sunlit"));
    this.draw();
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas;
    if (clientWidth === 0) return;
    this.ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(clientWidth * this.ratio);
    this.canvas.height = Math.round(clientHeight * this.ratio);
    const fitted = this.width === undefined || this.showsAll;
    this.width = clientWidth;
    this.height = clientHeight;
    if (fitted) this.fit();
    this.draw();
  }

  fit() {
    const { west, south, east, north } = this.site.extent;
    const wide = (this.width - 2 * MAP_MARGIN_PX) / Math.max(east - west, 1);
    const high = (this.height - 2 * MAP_MARGIN_PX) / Math.max(north - south, 1);
    this.scale = Math.min(wide, high);
    this.fitted = this.scale;
    this.centre = [(west + east) / 2, (south + north) / 2];
    this.showsAll = true;
    this.draw();
  }

  toScreen(x, y) {
    return [this.width / 2 + (x - this.centre[0]) * this.scale, this.height / 2 - (y - this.centre[1]) * this.scale];
  }

  toGround(px, py) {
    return [this.centre[0] + (px - this.width / 2) / this.scale, this.centre[1] - (py - this.height / 2) / this.scale];
  }

  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const [x, y] = this.toGround(px, py);
    this.showsAll = false;
    this.scale = Math.min(Math.max(this.scale * factor, this.fitted / 4), Math.max(400, this.fitted));
    this.centre = [x - (px - this.width / 2) / this.scale, y + (py - this.height / 2) / this.scale];
    this.draw();
  }

  move(dx, dy) {
    this.showsAll = false;
    this.centre = [this.centre[0] - dx / this.scale, this.centre[1] + dy / this.scale];
    this.draw();
  }

  draw() {
    if (this.pending || this.width === undefined) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = 0;
      this.context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
      drawMap(this);
    });
  }

  listen() {
    const { canvas } = this;
    let last = null, travelled = 0;
    canvas.addEventListener("pointerdown", (event) => {
      this.active = true;
      last = [event.clientX, event.clientY];
      travelled = 0;
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (last) {
        const [dx, dy] = [event.clientX - last[0], event.clientY - last[1]];
        travelled += Math.abs(dx) + Math.abs(dy);
        last = [event.clientX, event.clientY];
        this.move(dx, dy);
      } else this.point(event);
    });
    canvas.addEventListener("pointerup", (event) => {
      last = null;
      if (travelled < 4) this.click(event);
    });
    canvas.addEventListener("pointerleave", () => {
      this.active = false;
      this.tooltip.hide();
    });
    canvas.addEventListener("wheel", (event) => {
      if (!this.active && !event.ctrlKey) return;
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * 0.0015), event.offsetX, event.offsetY);
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  key(event) {
    const step = 60;
    const actions = {
      ArrowLeft: () => this.move(step, 0), ArrowRight: () => this.move(-step, 0),
      ArrowUp: () => this.move(0, step), ArrowDown: () => this.move(0, -step),
      "+": () => this.zoom(1.4), "=": () => this.zoom(1.4), "-": () => this.zoom(1 / 1.4),
      0: () => this.fit(), Escape: () => this.state.chooseSensor(null),
    };
    if (!actions[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    actions[event.key]();
  }

  point(event) {
    const found = pick(this, event.offsetX, event.offsetY);
    this.canvas.style.cursor = found?.kind === "sensor" ? "pointer" : "";
    if (found) this.tooltip.show(found.text, event.clientX, event.clientY);
    else this.tooltip.hide();
  }

  click(event) {
    const found = pick(this, event.offsetX, event.offsetY);
    if (found?.kind === "sensor") this.state.chooseSensor(this.state.sensor === found.index ? null : found.index);
  }
}

const PICK_RADIUS_PX = 11;

// What lies under the pointer: sensors before obstacles, targets and candidates.
function pick(map, px, py) {
  const { site, state, layers } = map;
  const plan = state.plan;
  const nearest = (count, place) => {
    let best = -1, least = PICK_RADIUS_PX;
    for (let i = 0; i < count; i++) {
      const [x, y] = map.toScreen(...place(i));
      const distance = Math.hypot(x - px, y - py);
      if (distance < least) [best, least] = [i, distance];
    }
    return best;
  };
  const kinds = [
    ["sensor", layers.sensors && plan, () => plan.sensors.length, (i) => [plan.sensors[i].x, plan.sensors[i].y], (i) => sensorText(plan.sensors[i])],
    ["obstacle", layers.obstacles && plan, () => plan.obstacles.length, (i) => [plan.obstacles[i].x, plan.obstacles[i].y], (i) => obstacleText(plan.obstacles[i])],
    ["target", layers.targets && plan, () => site.targets.names.length, (i) => [site.targets.xyz[3 * i], site.targets.xyz[3 * i + 1]], (i) => targetText(site, plan, i)],
    ["candidate", layers.candidates && site.candidates, () => site.candidates.heights.length, (i) => [site.candidates.xy[2 * i], site.candidates.xy[2 * i + 1]], (i) => candidateText(site.candidates, i)],
  ];
  for (const [kind, shown, count, place, text] of kinds) {
    const index = shown ? nearest(count(), place) : -1;
    if (index >= 0) return { kind, index, text: text(index) };
  }
  return null;
}

const sensorText = (sensor) =>
  `Sensor ${sensor.number}: ${sensor.sensor}, ${formatNumber(sensor.height_m, 2)} m above ground\nsees ${counted(sensor.targets, "target")}, ${formatNumber(sensor.only)} only by it`;

const obstacleText = ({ kind, height_m, targets, sensors }) =>
  `Obstacle: ${kind}${height_m === null ? "" : `, ${formatNumber(height_m, 1)} m above ground`}\nhides ${counted(targets, "target")} from ${counted(sensors, "sensor")}`;

function targetText(site, plan, index) {
  const gap = plan.gaps.find((entry) => entry.target === site.targets.names[index]);
  const by = plan.sensors.filter((_, n) => plan.seen[n].includes(index)).map((sensor) => sensor.number);
  const seen = by.length ? `seen by ${by.length === 1 ? "sensor" : "sensors"} ${by.join(", ")}` : "seen by no chosen sensor";
  return `Target ${site.targets.names[index]}\n${seen}${gap ? `\n${gap.reason}` : ""}`;
}

function candidateText(candidates, i) {
  const [low, high] = [candidates.lowest[i], candidates.highest[i]].map((height) => formatNumber(height, 2));
  const range = candidates.heights[i] === 1 ? `${low} m` : `${low} to ${high} m`;
  const round = candidates.round[i] ? `\nadded in round ${candidates.round[i]}, near a gap` : "";
  return `Candidate position: ${counted(candidates.heights[i], "height")}, ${range}${round}`;
}
