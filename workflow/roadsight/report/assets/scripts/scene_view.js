// The cloud, the sensors and what they see in three dimensions, by plotly.js.

const LONGEST_SIDE = 2;
const SURROUNDINGS = 1.2;
const FIELD_OF_VIEW = Math.PI / 4;
const HIGHEST_SHADE_M = 12;
const VIEW_M = 12;
const SYMBOLS = ["circle", "square", "diamond"];

class SceneView {
  constructor(element, site, state) {
    Object.assign(this, { element, site, state });
    this.layers = { cloud: true, targets: true, sensors: true, returns: false };
    this.options = { colour: "height", size: 1.5, stretch: 1, camera: "oblique" };
    this.angle = roadAngle(site);
    this.drawn = false;
    this.active = false;
    element.addEventListener("wheel", (event) => {
      if (!this.active && !event.ctrlKey) event.stopPropagation();
    }, { capture: true });
    element.addEventListener("pointerdown", () => { this.active = true; }, { capture: true });
    element.addEventListener("pointerleave", () => { this.active = false; });
    // One finger moves the page; two turn the view.
    for (const kind of ["touchstart", "touchmove"]) {
      element.addEventListener(kind, (event) => {
        if (event.touches.length === 1) event.stopPropagation();
      }, { capture: true, passive: true });
    }
  }

  open() {
    if (this.drawn) return;
    this.drawn = true;
    this.cloud ??= this.readCloud();
    this.element.replaceChildren();
    this.draw();
    this.element.on("plotly_click", ({ points }) => {
      const number = points[0]?.customdata;
      if (Number.isInteger(number)) this.state.chooseSensor(number);
    });
  }

  // Browsers keep few drawing contexts, so a hidden site gives its own back.
  close() {
    if (!this.drawn) return;
    this.drawn = false;
    Plotly.purge(this.element);
    this.element.replaceChildren();
  }

  // A still for paper, which shows no drawing contexts.
  print() {
    this.open();
    this.draw();
    const scene = this.element._fullLayout?.scene?._scene;
    if (!scene) return;
    this.element.querySelector(".still")?.remove();
    const still = Object.assign(new Image(), { className: "still", alt: "3D view", src: scene.toImage("png") });
    this.element.append(still);
  }

  readCloud() {
    const { cloud } = this.site.layers;
    const points = unpackPoints(cloud);
    const unknown = 255;
    const heights = Float32Array.from(unpack(cloud.height), (step) => (step === unknown ? 0 : step * cloud.height_step_m));
    const bytes = cloud.colour && unpack(cloud.colour);
    const colours = bytes && Array.from(heights, (_, i) => `rgb(${bytes[3 * i]},${bytes[3 * i + 1]},${bytes[3 * i + 2]})`);
    return { ...points, heights, colours, intensity: cloud.intensity && unpack(cloud.intensity) };
  }

  draw() {
    if (!this.drawn) return;
    const colour = themeColours();
    this.ranges = this.sceneRanges();
    const config = { displaylogo: false, responsive: true, modeBarButtons: [["toImage"]] };
    Plotly.react(this.element, this.traces(colour), this.layout(colour), config);
  }

  sceneRanges() {
    const { x, y, z } = this.cloud;
    const plan = this.state.plan;
    const range = (values, key) => {
      let low = Infinity, high = -Infinity;
      for (const value of values) { low = Math.min(low, value); high = Math.max(high, value); }
      for (const sensor of plan?.sensors ?? []) { low = Math.min(low, sensor[key]); high = Math.max(high, sensor[key] + 1); }
      return low < high ? [low, high] : [low - 1 || -1, high + 1 || 1];
    };
    return { x: range(x, "x"), y: range(y, "y"), z: range(z, "z") };
  }

  layout(colour) {
    const hidden = (range) => ({ range, autorange: false, visible: false, showspikes: false });
    const { x, y, z } = this.ranges;
    return {
      margin: { l: 0, r: 0, t: 0, b: 0 }, showlegend: false, uirevision: "keep",
      paper_bgcolor: "rgba(0,0,0,0)", font: { family: colour("font"), color: colour("ink") },
      hoverlabel: {
        bgcolor: colour("ink"), bordercolor: colour("ink"),
        font: { family: colour("font"), size: 12, color: colour("paper") },
      },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("muted"), activecolor: colour("accent") },
      scene: {
        xaxis: hidden(x), yaxis: hidden(y), zaxis: hidden(z),
        aspectmode: "manual", aspectratio: this.sides(),
        camera: this.camera(this.options.camera), dragmode: "turntable",
      },
    };
  }

  // Sides of the box in plotly's units: true to scale, unless heights are stretched.
  sides() {
    const [x, y, z] = ["x", "y", "z"].map((axis) => this.ranges[axis][1] - this.ranges[axis][0]);
    const unit = LONGEST_SIDE / Math.max(x, y);
    return { x: x * unit, y: y * unit, z: z * unit * this.options.stretch };
  }

  // Cameras look across the road, its long axis from left to right, from where all of it is seen.
  camera(kind) {
    const elevation = { oblique: 0.6, side: 0.14, top: Math.PI / 2 - 0.001 }[kind];
    const unit = LONGEST_SIDE / Math.max(...["x", "y"].map((axis) => this.ranges[axis][1] - this.ranges[axis][0]));
    const { along, depth, middle } = this.footprint();
    const high = depth * Math.sin(elevation) + (this.sides().z / unit) * Math.cos(elevation);
    const wide = along * (this.element.clientHeight / this.element.clientWidth);
    const away = Math.max(wide, high) / (2 * Math.tan(FIELD_OF_VIEW / 2));
    const distance = unit * (away + 0.4 * depth * Math.cos(elevation));
    const across = this.angle - Math.PI / 2;
    const center = { x: middle[0] * unit, y: middle[1] * unit, z: 0 };
    return {
      eye: {
        x: center.x + distance * Math.cos(across) * Math.cos(elevation),
        y: center.y + distance * Math.sin(across) * Math.cos(elevation),
        z: distance * Math.sin(elevation),
      },
      up: { x: 0, y: 0, z: 1 },
      center,
    };
  }

  // Extent of the road and its surroundings along and across it, and its middle from that of the
  // box, in metres; of the whole cloud where there is no road.
  footprint() {
    const lines = [...this.site.pavement.flat(), ...this.site.edges.map((edge) => edge.xy)];
    const [cosine, sine] = [Math.cos(this.angle), Math.sin(this.angle)];
    const low = [Infinity, Infinity], high = [-Infinity, -Infinity];
    const include = (x, y) => [x * cosine + y * sine, y * cosine - x * sine].forEach((value, k) => {
      low[k] = Math.min(low[k], value);
      high[k] = Math.max(high[k], value);
    });
    for (const line of lines) for (let i = 0; i < line.length; i += 2) include(line[i], line[i + 1]);
    if (lines.length === 0) this.cloud.x.forEach((x, i) => include(x, this.cloud.y[i]));
    const [u, v] = [0, 1].map((k) => (low[k] + high[k]) / 2);
    const box = ["x", "y"].map((axis) => (this.ranges[axis][0] + this.ranges[axis][1]) / 2);
    return {
      along: SURROUNDINGS * (high[0] - low[0]), depth: SURROUNDINGS * (high[1] - low[1]),
      middle: [u * cosine - v * sine - box[0], u * sine + v * cosine - box[1]],
    };
  }

  setCamera(kind) {
    this.options.camera = kind;
    if (this.drawn) Plotly.relayout(this.element, { "scene.camera": this.camera(kind) });
  }

  traces(colour) {
    const { plan } = this.state;
    const base = { type: "scatter3d", mode: "markers", hoverinfo: "skip" };
    const traces = [{ ...base, ...this.cloudMarkers(colour), visible: this.layers.cloud }];
    if (!plan) return traces;
    traces.push(
      this.targetTrace(base, plan, colour, (times) => times > 0),
      this.targetTrace(base, plan, colour, (times) => times === 0),
      ...this.sensorTraces(base, plan, colour),
      this.sightTrace(base, plan, colour),
      this.returnsTrace(base, plan, colour),
    );
    return traces;
  }

  cloudMarkers(colour) {
    const { x, y, z, heights, intensity, colours } = this.cloud;
    const ramp = (...colours) => colours.map((stop, i) => [i / (colours.length - 1), stop]);
    const markers = {
      height: { color: heights, cmin: 0, cmax: HIGHEST_SHADE_M, colorscale: ramp(colour("cloud-low"), colour("cloud-mid"), colour("cloud-high")) },
      intensity: { color: intensity, cmin: 0, cmax: 255, colorscale: ramp("#1a1f24", "#f2f4f6") },
      colour: { color: colours },
    };
    return { x, y, z, marker: { size: this.options.size, opacity: 1, line: { width: 0 }, ...markers[this.options.colour] } };
  }

  targetTrace(base, plan, colour, wanted) {
    const { xyz } = this.site.targets;
    const members = [...plan.times.keys()].filter((i) => wanted(plan.times[i]));
    const unseen = members.length > 0 && plan.times[members[0]] === 0;
    const lit = this.state.sensor === null ? null : new Set(plan.seen[this.state.sensor]);
    const shown = unseen || !lit ? members : members.filter((i) => lit.has(i));
    return {
      ...base, visible: this.layers.targets,
      x: shown.map((i) => xyz[3 * i]), y: shown.map((i) => xyz[3 * i + 1]), z: shown.map((i) => xyz[3 * i + 2] + 0.3),
      hoverinfo: "text", hovertext: shown.map((i) => `Target ${escapeText(this.site.targets.names[i])}: seen by ${plan.times[i]}`),
      marker: {
        size: unseen ? 5 : 3, symbol: unseen ? "square" : "circle", line: { width: 0 }, opacity: 1,
        color: shown.map((i) => colour(`seen-${bucketOf(plan.times[i])}`)),
      },
    };
  }

  sensorTraces(base, plan, colour) {
    const { sensors } = plan;
    const fill = sensors.map((_, n) => colour(n === this.state.sensor ? "accent" : "ink"));
    const poles = { x: [], y: [], z: [] };
    for (const { x, y, z, height_m } of sensors) {
      poles.x.push(x, x, null);
      poles.y.push(y, y, null);
      poles.z.push(z - height_m, z, null);
    }
    const visible = this.layers.sensors;
    return [
      { ...base, ...poles, visible, mode: "lines", line: { color: colour("ink"), width: 3 } },
      { ...base, ...this.viewLines(sensors), visible, mode: "lines", opacity: 0.6, line: { color: colour("accent"), width: 2 } },
      {
        ...base, visible, mode: "markers+text", hoverinfo: "text",
        x: sensors.map((s) => s.x), y: sensors.map((s) => s.y), z: sensors.map((s) => s.z),
        text: sensors.map((s) => String(s.number)), textposition: "top center",
        textfont: { size: 14, color: colour("ink"), weight: 700 },
        hovertext: sensors.map((s) => escapeText(sensorText(s)).replaceAll("\n", "<br>")),
        customdata: sensors.map((_, n) => n),
        marker: { size: 7, symbol: plan.models.map((model) => SYMBOLS[model]), color: fill, line: { color: colour("surface"), width: 1 } },
      },
    ];
  }

  // Pyramids that show where sensors with a limited field of view look.
  viewLines(sensors) {
    const lines = { x: [], y: [], z: [] };
    const draw = (...points) => [...points, null].forEach((p) => ["x", "y", "z"].forEach((axis, k) => lines[axis].push(p && p[k])));
    for (const sensor of sensors) {
      const view = this.site.sensors[sensor.sensor]?.half_view_deg;
      if (!view) continue;
      const corners = viewCorners(sensor, view);
      const place = [sensor.x, sensor.y, sensor.z];
      for (const corner of corners) draw(place, corner);
      draw(...corners, corners[0]);
    }
    return lines;
  }

  sightTrace(base, plan, colour) {
    const lines = { x: [], y: [], z: [] };
    const number = this.state.sensor;
    for (const target of number === null ? [] : plan.seen[number]) {
      const sensor = plan.sensors[number];
      ["x", "y", "z"].forEach((axis, k) => lines[axis].push(sensor[axis], this.site.targets.xyz[3 * target + k] + (k === 2 ? 0.3 : 0), null));
    }
    return { ...base, ...lines, visible: this.layers.sensors, mode: "lines", opacity: 0.3, line: { color: colour("accent"), width: 1 } };
  }

  returnsTrace(base, plan, colour) {
    const points = unpackPoints(plan.returns);
    const sensor = unpack(plan.returns.sensor);
    const wanted = [...sensor.keys()].filter((i) => this.state.sensor === null || sensor[i] === this.state.sensor);
    const part = (values) => wanted.map((i) => values[i]);
    return {
      ...base, visible: this.layers.returns, x: part(points.x), y: part(points.y), z: part(points.z),
      marker: { size: 1.8, color: colour("returns"), line: { width: 0 } },
    };
  }
}

// Corners of a field of view some metres before a sensor: x forward, y left, z up, then rolled with the
// right side up, pitched up and turned left.
function viewCorners({ x, y, z, yaw_deg, pitch_deg = 0, roll_deg = 0 }, view) {
  const [yaw, pitch, roll] = [yaw_deg, pitch_deg, roll_deg].map((angle) => (angle * Math.PI) / 180);
  const [across, upright] = view.map((half) => Math.tan((Math.min(half, 75) * Math.PI) / 180));
  return [[1, 1], [-1, 1], [-1, -1], [1, -1]].map(([side, top]) => {
    const [left, up] = [side * across, top * upright];
    const share = VIEW_M / Math.hypot(1, left, up);
    const l = left * Math.cos(roll) + up * Math.sin(roll);
    const u = up * Math.cos(roll) - left * Math.sin(roll);
    const ahead = Math.cos(pitch) - u * Math.sin(pitch);
    const height = Math.sin(pitch) + u * Math.cos(pitch);
    return [
      x + share * (ahead * Math.cos(yaw) - l * Math.sin(yaw)),
      y + share * (ahead * Math.sin(yaw) + l * Math.cos(yaw)),
      z + share * height,
    ];
  });
}

// Plotly reads a little HTML in its texts.
const escapeText = (text) => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");
