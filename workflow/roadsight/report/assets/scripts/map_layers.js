// What the map draws, from the ground up.

const FLAT_SHADE = 180;
const FACING_PX = 19;

function drawMap(map) {
  const { context, layers, colour } = map;
  const { plan } = map.state;
  context.globalAlpha = 1;
  context.fillStyle = colour("ground");
  context.fillRect(0, 0, map.width, map.height);
  const picture = map.site.below[map.below];
  if (picture) drawPicture(map, picture, picture.image);
  else if (map.below === "relief") drawPicture(map, map.site.relief, map.reliefImage);
  if (layers.pavement) drawPavement(map);
  if (layers.unexamined) drawUnexamined(map);
  if (layers.edges) drawEdges(map);
  if (layers.candidates && map.site.candidates) drawCandidates(map);
  if (plan) {
    if (layers.targets) drawTargets(map, plan);
    if (layers.sensors && map.state.sensor !== null) drawSights(map, plan, map.state.sensor);
    if (layers.obstacles) drawObstacles(map, plan);
    if (layers.sensors) drawSensors(map, plan);
  }
  if (map.marked) drawMarked(map);
  drawScaleBar(map);
  drawUp(map);
}

// Relief as shadow and light over whatever lies below, so that it works on any background.
function shadeImage(relief, shadow, sunlit) {
  const canvas = document.createElement("canvas");
  canvas.width = relief.columns;
  canvas.height = relief.rows;
  const context = canvas.getContext("2d");
  const image = context.createImageData(relief.columns, relief.rows);
  const [dark, light] = [shadow, sunlit].map(channels);
  relief.shade.forEach((shade, i) => {
    if (shade === 0) return;
    const lit = shade >= FLAT_SHADE;
    const strength = lit ? (shade - FLAT_SHADE) / (255 - FLAT_SHADE) : (FLAT_SHADE - shade) / FLAT_SHADE;
    image.data.set([...(lit ? light : dark), 170 * strength], 4 * i);
  });
  context.putImageData(image, 0, 0);
  return canvas;
}

function channels(hex) {
  return [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
}

function drawPicture(map, { west_m, north_m, rows, columns, cell_size_m }, image) {
  if (image instanceof Image && !image.complete) return;
  const [left, top] = map.toScreen(west_m, north_m);
  const size = cell_size_m * map.scale;
  map.context.drawImage(image, left, top, columns * size, rows * size);
}

function trace(map, xy) {
  for (let i = 0; i < xy.length; i += 2) {
    const [x, y] = map.toScreen(xy[i], xy[i + 1]);
    if (i === 0) map.context.moveTo(x, y);
    else map.context.lineTo(x, y);
  }
}

function tracePolygons(map, polygons) {
  map.context.beginPath();
  for (const rings of polygons) {
    for (const ring of rings) {
      trace(map, ring);
      map.context.closePath();
    }
  }
}

// Pavement that no target stands for: the proof says nothing of it.
function drawUnexamined(map) {
  const { context } = map;
  if (!map.site.unexamined.length) return;
  context.save();
  tracePolygons(map, map.site.unexamined);
  context.clip("evenodd");
  context.strokeStyle = map.colour("edge");
  context.lineWidth = 1;
  context.globalAlpha = 0.8;
  context.beginPath();
  for (let x = -map.height; x < map.width; x += 6) {
    context.moveTo(x, map.height);
    context.lineTo(x + map.height, 0);
  }
  context.stroke();
  context.restore();
}

function drawPavement(map) {
  const { context } = map;
  const picture = map.site.below[map.below];
  context.fillStyle = map.colour("pavement");
  context.globalAlpha = picture ? 0.2 : 0.85;
  tracePolygons(map, map.site.pavement);
  context.fill("evenodd");
  context.globalAlpha = 1;
  if (!picture) return;
  context.strokeStyle = map.colour("accent");
  context.lineWidth = 1.5;
  context.stroke();
}

function drawEdges(map) {
  const { context } = map;
  context.lineWidth = 1.75;
  for (const edge of map.site.edges) {
    context.strokeStyle = map.colour(edge.kind === "median" ? "median" : "edge");
    context.setLineDash(edge.source === "automatic" ? [6, 4] : []);
    context.beginPath();
    trace(map, edge.xy);
    context.stroke();
  }
  context.setLineDash([]);
}

function drawCandidates(map) {
  const { context } = map;
  const { xy, round } = map.site.candidates;
  const radius = Math.min(Math.max(map.scale * 0.5, 1.6), 4);
  context.lineWidth = 1.25;
  context.strokeStyle = map.colour("candidate");
  for (let i = 0; i < round.length; i++) {
    const [x, y] = map.toScreen(xy[2 * i], xy[2 * i + 1]);
    context.fillStyle = map.colour(round[i] ? "candidate" : "ground");
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
    context.fill();
    context.stroke();
  }
}

// The class of each target by what colours it; undefined where the plan does not know it.
function targetClasses(plan, by) {
  return { sight: plan?.inSight, lost: plan?.lost }[by];
}

function drawTargets(map, plan) {
  const { context, site, state } = map;
  const { xyz } = site.targets;
  const size = Math.min(Math.max(map.scale * site.cell_size_m * 0.8, 1.6), 12);
  const lit = state.sensor === null ? null : new Set(plan.seen[state.sensor]);
  const spots = Array.from({ length: MOST_SEEN + 1 }, () => []);
  const classes = targetClasses(plan, state.targetsBy);
  plan.times.forEach((times, i) => spots[classes ? classes[i] : bucketOf(times)].push(i));
  spots.reverse().forEach((members, order) => {
    const bucket = MOST_SEEN - order;
    const side = bucket === 0 ? Math.max(size, 4) : size;
    context.fillStyle = map.colour(`seen-${bucket}`);
    for (const i of members) {
      const [x, y] = map.toScreen(xyz[3 * i], xyz[3 * i + 1]);
      if (x < -side || y < -side || x > map.width + side || y > map.height + side) continue;
      context.globalAlpha = lit === null || lit.has(i) ? 1 : 0.22;
      context.fillRect(x - side / 2, y - side / 2, side, side);
    }
  });
  context.globalAlpha = 1;
}

function drawSights(map, plan, number) {
  const { context, site } = map;
  const sensor = plan.sensors[number];
  const [x, y] = map.toScreen(sensor.x, sensor.y);
  context.strokeStyle = map.colour("accent");
  context.lineWidth = 1;
  context.globalAlpha = 0.16;
  context.beginPath();
  for (const target of plan.seen[number]) {
    context.moveTo(x, y);
    context.lineTo(...map.toScreen(site.targets.xyz[3 * target], site.targets.xyz[3 * target + 1]));
  }
  context.stroke();
  context.globalAlpha = 1;
  const { range_m: range, half_view_deg: view } = site.sensors[sensor.sensor] ?? {};
  if (!range) return;
  context.setLineDash([8, 6]);
  context.beginPath();
  if (view) {
    // A limited field of view: the sector that it spans at the horizon; the canvas turns clockwise.
    const [middle, half] = [-sensor.yaw_deg, view[0]].map((angle) => (angle * Math.PI) / 180);
    context.moveTo(x, y);
    context.arc(x, y, range * map.scale, middle - half, middle + half);
    context.closePath();
  } else context.arc(x, y, range * map.scale, 0, 2 * Math.PI);
  context.stroke();
  context.setLineDash([]);
}

// Obstacles by how many targets they hide, and those of targets that nobody sees joined to them.
function drawObstacles(map, plan) {
  const { context, colour } = map;
  const most = Math.max(1, ...plan.obstacles.map(({ targets }) => targets));
  context.lineWidth = 1;
  context.fillStyle = colour("obstacle");
  context.strokeStyle = colour("surface");
  for (const { x, y, targets } of plan.obstacles) {
    symbolPath(context, 2, ...map.toScreen(x, y), 1.2 + 4 * Math.sqrt(targets / most));
    context.fill();
    context.stroke();
  }
  context.lineWidth = 1.5;
  context.strokeStyle = colour("seen-0");
  for (const gap of plan.gaps) {
    if (gap.obstacle_x === null) continue;
    const end = map.toScreen(gap.obstacle_x, gap.obstacle_y);
    context.beginPath();
    context.moveTo(...map.toScreen(gap.x, gap.y));
    context.lineTo(...end);
    context.stroke();
    symbolPath(context, 2, ...end, 4);
    context.stroke();
  }
}

// Symbols tell the models of a plan apart: circle, square, diamond.
function symbolPath(context, model, x, y, radius) {
  context.beginPath();
  if (model === 0) context.arc(x, y, radius, 0, 2 * Math.PI);
  else if (model === 1) context.rect(x - radius * 0.9, y - radius * 0.9, radius * 1.8, radius * 1.8);
  else {
    const r = radius * 1.25;
    context.moveTo(x, y - r);
    for (const [dx, dy] of [[r, 0], [0, r], [-r, 0]]) context.lineTo(x + dx, y + dy);
    context.closePath();
  }
}

function drawSensors(map, plan) {
  plan.sensors.forEach((sensor, n) => {
    if (n !== map.state.sensor) drawSensor(map, plan, n);
  });
  if (map.state.sensor !== null) drawSensor(map, plan, map.state.sensor);
}

function drawSensor(map, plan, n) {
  const { context, colour } = map;
  const sensor = plan.sensors[n];
  const chosen = map.state.sensor === n;
  const [x, y] = map.toScreen(sensor.x, sensor.y);
  const fill = colour(chosen ? "accent" : "sensor");
  const angle = (sensor.yaw_deg * Math.PI) / 180;
  context.fillStyle = fill;
  context.strokeStyle = colour("surface");
  context.lineWidth = 1.5;
  context.beginPath();
  context.moveTo(x + FACING_PX * Math.cos(angle), y - FACING_PX * Math.sin(angle));
  for (const side of [0.45, -0.45]) context.lineTo(x + 10 * Math.cos(angle + side), y - 10 * Math.sin(angle + side));
  context.closePath();
  context.fill();
  symbolPath(context, plan.models[n], x, y, 10);
  context.fill();
  context.stroke();
  context.fillStyle = colour(chosen ? "on-accent" : "surface");
  context.font = `700 11px ${colour("font")}`;
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillText(sensor.number, x, y + 0.5);
}

// What a row of a table marks: a ring around a place, or a line.
function drawMarked(map) {
  const { context, marked } = map;
  for (const [colour, width] of [["surface", 7], ["accent", 3.5]]) {
    context.strokeStyle = map.colour(colour);
    context.lineWidth = width;
    context.beginPath();
    if (marked.length > 2) trace(map, marked);
    else context.arc(...map.toScreen(...marked), 15, 0, 2 * Math.PI);
    context.stroke();
  }
}

function drawScaleBar(map) {
  const { context, colour } = map;
  const most = 130 / map.scale;
  const decade = 10 ** Math.floor(Math.log10(most));
  const length = [5, 2, 1].map((n) => n * decade).find((n) => n <= most);
  const [left, bottom, width] = [16, map.height - 16, length * map.scale];
  const text = length >= 1000 ? `${formatNumber(length / 1000)} km` : `${formatNumber(length, length < 1 ? 1 : 0)} m`;
  plate(map, left - 8, bottom - 24, Math.max(width, 40) + 16, 32);
  context.strokeStyle = context.fillStyle = colour("ink");
  context.lineWidth = 1.5;
  context.beginPath();
  context.moveTo(left, bottom - 5);
  context.lineTo(left, bottom);
  context.lineTo(left + width, bottom);
  context.lineTo(left + width, bottom - 5);
  context.stroke();
  context.font = `12px ${colour("font")}`;
  context.textAlign = "left";
  context.textBaseline = "alphabetic";
  context.fillText(text, left, bottom - 8);
}

function drawUp(map) {
  const { context, colour } = map;
  plate(map, 8, 8, 26, 38);
  context.fillStyle = colour("ink");
  context.beginPath();
  context.moveTo(21, 12);
  context.lineTo(27, 28);
  context.lineTo(21, 24);
  context.lineTo(15, 28);
  context.closePath();
  context.fill();
  context.font = `700 11px ${colour("font")}`;
  context.textAlign = "center";
  context.textBaseline = "alphabetic";
  context.fillText(map.canvas.dataset.up, 21, 41);
}

function plate(map, x, y, width, height) {
  map.context.fillStyle = map.colour("surface");
  map.context.globalAlpha = 0.85;
  map.context.beginPath();
  map.context.roundRect(x, y, width, height, 5);
  map.context.fill();
  map.context.globalAlpha = 1;
}
