// The map of scene and placement. What it draws is in map_layers.js.

const MARKED_PX_PER_M = 6;

class MapView extends PlanCanvas {
  constructor(canvas, site, state, tooltip) {
    super(canvas, site, state, tooltip);
    this.layers = { pavement: true, unexamined: true, edges: true, candidates: true, targets: true, obstacles: true, sensors: true };
    this.below = "orthophoto" in site.below ? "orthophoto" : "relief";
    for (const { image } of Object.values(site.below)) image.addEventListener("load", () => this.draw());
    this.marked = null;
    this.recolour();
  }

  recolour() {
    super.recolour();
    this.reliefImage = shadeImage(this.site.relief, this.colour("shadow"), this.colour("sunlit"));
  }

  paint() {
    drawMap(this);
  }

  pick(px, py) {
    return pick(this, px, py);
  }

  // The middle of what a row marks, or the chosen sensor.
  get chosenPlace() {
    const middle = this.marked && 2 * Math.floor(this.marked.length / 4);
    if (this.marked) return [this.marked[middle], this.marked[middle + 1]];
    const sensor = this.state.plan?.sensors[this.state.sensor];
    return sensor ? [sensor.x, sensor.y] : null;
  }

  revealMarked() {
    const [x, y] = this.chosenPlace;
    this.reveal({ x, y }, this.marked.length > 2 ? this.fitted : Math.max(MARKED_PX_PER_M, this.fitted));
  }

  choose(found) {
    this.state.chooseSensor(found === null || this.state.sensor === found.index ? null : found.index);
  }
}

// What lies under the pointer: sensors before obstacles, targets and candidates.
function pick(map, px, py) {
  const { site, state, layers } = map;
  const plan = state.plan;
  const kinds = [
    ["sensor", layers.sensors && plan, () => plan.sensors.length, (i) => [plan.sensors[i].x, plan.sensors[i].y], (i) => sensorText(plan.sensors[i])],
    ["obstacle", layers.obstacles && plan, () => plan.obstacles.length, (i) => [plan.obstacles[i].x, plan.obstacles[i].y], (i) => obstacleText(plan.obstacles[i])],
    ["target", layers.targets && plan, () => site.targets.names.length, (i) => [site.targets.xyz[3 * i], site.targets.xyz[3 * i + 1]], (i) => targetText(site, plan, i)],
    ["candidate", layers.candidates && site.candidates, () => site.candidates.heights.length, (i) => [site.candidates.xy[2 * i], site.candidates.xy[2 * i + 1]], (i) => candidateText(site.candidates, i)],
  ];
  for (const [kind, shown, count, place, text] of kinds) {
    const index = shown ? map.nearest(px, py, count(), place) : -1;
    if (index >= 0) return { chosen: kind === "sensor", index, text: text(index) };
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
