// What the poles' map draws, from the ground up.

const RASTER_LEVELS = 40;
const RASTER_COLOURS = [null, "top-other", "top-ground", "top-vegetation", "top-building", "top-road", "top-bridge"];
const SIGMAS_DRAWN = 1;
const RAYS_AT_ONCE = 50;

function drawPolesMap(map) {
  const { context, layers, colour } = map;
  context.globalAlpha = 1;
  context.fillStyle = colour("ground");
  context.fillRect(0, 0, map.width, map.height);
  if (layers.raster && map.rasterImage) drawRaster(map);
  if (layers.lidar) drawEdgePoints(map);
  if (layers.dropped) drawRays(map, 0);
  if (layers.rays) drawRays(map, 1);
  if (layers.cameras) drawCameras(map);
  if (layers.poles) drawPoles(map);
  drawScaleBar(map);
  drawUp(map);
}

// Kind of each pixel, read back from the grey levels of the picture.
function rasterKinds(image, rows, columns) {
  const canvas = document.createElement("canvas");
  canvas.width = columns;
  canvas.height = rows;
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(image, 0, 0);
  const { data } = context.getImageData(0, 0, columns, rows);
  const kinds = new Uint8Array(rows * columns);
  for (let i = 0; i < kinds.length; i++) kinds[i] = Math.round(data[4 * i] / RASTER_LEVELS);
  return kinds;
}

function colouredRaster(kinds, { rows, columns }, colour) {
  const canvas = document.createElement("canvas");
  canvas.width = columns;
  canvas.height = rows;
  const context = canvas.getContext("2d");
  const image = context.createImageData(columns, rows);
  const palette = RASTER_COLOURS.map((name) => (name === null ? [0, 0, 0, 0] : [...channels(colour(name)), 255]));
  for (let i = 0; i < kinds.length; i++) image.data.set(palette[kinds[i]], 4 * i);
  context.putImageData(image, 0, 0);
  return canvas;
}

function drawRaster(map) {
  const { west_m, north_m, rows, columns, cell_size_m } = map.site.raster;
  const [left, top] = map.toScreen(west_m, north_m);
  const size = cell_size_m * map.scale;
  map.context.imageSmoothingEnabled = size < 1;
  map.context.drawImage(map.rasterImage, left, top, columns * size, rows * size);
  map.context.imageSmoothingEnabled = true;
}

function drawEdgePoints(map) {
  const { context } = map;
  const { x: xs, y: ys } = map.site.edges;
  const side = Math.round(Math.min(Math.max(map.scale * 0.3, 1), 4));
  const drawn = new Uint8Array(map.width * map.height);
  context.fillStyle = map.colour("lidar-edge");
  for (let i = 0; i < xs.length; i++) {
    const [x, y] = map.toScreen(xs[i], ys[i]).map(Math.floor);
    // Seen from afar, many points share a pixel.
    if (x < 0 || y < 0 || x >= map.width || y >= map.height || drawn[y * map.width + x]) continue;
    drawn[y * map.width + x] = 1;
    context.fillRect(x - (side >> 1), y - (side >> 1), side, side);
  }
}

// Rays of one kind; with a pole chosen, its own are strong and the others faint.
function drawRays(map, kept) {
  const { context, state, site } = map;
  const { rays, pole, kept: keeps } = site.sightings;
  const own = state.pole === null ? -1 : state.pole + 1;
  const draw = (wanted, alpha, width) => {
    context.globalAlpha = alpha;
    context.lineWidth = width;
    let started = 0;
    context.beginPath();
    for (let i = 0; i < pole.length; i++) {
      if (keeps[i] !== kept || !wanted(i)) continue;
      context.moveTo(...map.toScreen(rays[4 * i], rays[4 * i + 1]));
      context.lineTo(...map.toScreen(rays[4 * i + 2], rays[4 * i + 3]));
      // A path of thousands of lines takes much longer than many short ones.
      if (++started % RAYS_AT_ONCE) continue;
      context.stroke();
      context.beginPath();
    }
    context.stroke();
  };
  context.strokeStyle = map.colour(kept ? "ray" : "rejected");
  if (!kept) context.setLineDash([3, 3]);
  if (own < 0) draw(() => true, Math.min(0.75, 0.12 + 0.06 * map.scale), 1);
  else {
    draw((i) => pole[i] !== own, 0.12, 1);
    draw((i) => pole[i] === own, 1, 1.75);
  }
  context.setLineDash([]);
  context.globalAlpha = 1;
}

// Cameras point along their heading; rejected ones are hollow and crossed, unused ones hollow.
function drawCameras(map) {
  const { context, site, state } = map;
  const { xy, heading, state: states } = site.cameras;
  const size = Math.min(Math.max(map.scale * 0.8, 2), 8);
  context.lineWidth = 1.25;
  for (let i = 0; i < states.length; i++) {
    const [x, y] = map.toScreen(xy[2 * i], xy[2 * i + 1]);
    if (x < -size || y < -size || x > map.width + size || y > map.height + size) continue;
    const angle = (heading[i] * Math.PI) / 180;
    const good = states[i] === STATES.accepted;
    const colour = map.colour(good ? "camera" : states[i] === STATES.rejected ? "rejected" : "candidate");
    context.fillStyle = good ? colour : map.colour("surface");
    context.strokeStyle = good ? map.colour("surface") : colour;
    context.beginPath();
    for (const [reach, turn] of [[1.6, 0], [1.2, 2.5], [1.2, -2.5]]) {
      context.lineTo(x + reach * size * Math.sin(angle + turn), y - reach * size * Math.cos(angle + turn));
    }
    context.closePath();
    context.fill();
    context.stroke();
    if (site.cameras.shown[i] >= 0 && site.cameras.shown[i] === state.image) ring(map, x, y, size * 2.2);
  }
}

function ring(map, x, y, radius) {
  const { context } = map;
  context.strokeStyle = map.colour("accent");
  context.lineWidth = 2;
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.stroke();
  context.lineWidth = 1.25;
}

function drawPoles(map) {
  const { site, state } = map;
  site.poles.forEach((_, i) => {
    if (i !== state.pole) drawPole(map, i);
  });
  if (state.pole !== null) drawPole(map, state.pole);
}

// Colour of a pole by name: its hazard where that layer is on.
function poleColour({ layers, site }, pole) {
  if (!layers.rated) return "pole";
  const rating = site.hazardOf.get(pole.id)?.rating;
  return `rated-${["high", "medium", "low"].includes(rating) ? rating : "unknown"}`;
}

function drawPole(map, i) {
  const { context, colour } = map;
  const pole = map.site.poles[i];
  const chosen = map.state.pole === i;
  const [x, y] = map.toScreen(pole.x, pole.y);
  const reach = (pole.sigma_major_m ?? 0) * map.scale + 12;
  if (x < -reach || y < -reach || x > map.width + reach || y > map.height + reach) return;
  const fill = colour(chosen ? "accent" : poleColour(map, pole));
  if (pole.sigma_major_m !== null && pole.sigma_major_m * map.scale > 2) {
    const angle = ((pole.sigma_azimuth_deg ?? 0) - 90) * Math.PI / 180;
    const radii = [pole.sigma_major_m, pole.sigma_minor_m ?? 0].map((sigma) => SIGMAS_DRAWN * sigma * map.scale);
    context.beginPath();
    context.ellipse(x, y, ...radii, angle, 0, 2 * Math.PI);
    context.fillStyle = fill;
    context.globalAlpha = 0.22;
    context.fill();
    context.globalAlpha = 1;
    context.strokeStyle = fill;
    context.lineWidth = 1.25;
    context.stroke();
  }
  context.fillStyle = fill;
  context.strokeStyle = colour("surface");
  context.lineWidth = map.scale < 1 ? 0.75 : 1.5;
  context.beginPath();
  context.arc(x, y, chosen ? 6 : Math.min(Math.max(4 * map.scale, 2.4), 4.5), 0, 2 * Math.PI);
  context.fill();
  context.stroke();
}
