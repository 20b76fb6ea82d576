// Content of a site as typed arrays, and the page's colours.

const ARRAYS = { u1: Uint8Array, u2: Uint16Array, u4: Uint32Array, f4: Float32Array };
const MOST_SEEN = 4;

function unpack(packed) {
  const text = atob(packed.data);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return new ARRAYS[packed.dtype](bytes.buffer);
}

function unpackPoints(packed) {
  const integers = unpack(packed.xyz);
  const axes = [0, 1, 2].map(() => new Float32Array(integers.length / 3));
  for (let i = 0; i < integers.length; i++) {
    const axis = i % 3;
    axes[axis][(i - axis) / 3] = packed.offset_m[axis] + packed.step_m[axis] * integers[i];
  }
  return { x: axes[0], y: axes[1], z: axes[2] };
}

function readPicture({ address, ...place }) {
  const image = new Image();
  image.src = address;
  return { ...place, image };
}

function readPlan(plan, targets) {
  const seen = plan.seen.map(unpack);
  const times = new Uint16Array(targets);
  for (const row of seen) for (const target of row) times[target]++;
  const names = [...new Set(plan.sensors.map((sensor) => sensor.sensor))].sort();
  const models = plan.sensors.map((sensor) => names.indexOf(sensor.sensor) % 3);
  const inSight = plan.in_sight ? unpack(plan.in_sight) : null;
  const lost = plan.lost ? unpack(plan.lost) : null;
  return { ...plan, seen, times, models, inSight, lost };
}

function readSite(content) {
  const { layers } = content;
  const targets = layers.targets && { names: layers.targets.names, xyz: unpack(layers.targets.xyz) };
  const site = {
    layers,
    sensors: content.sensors,
    cell_size_m: content.cell_size_m,
    place: content.place,
    below: Object.fromEntries(Object.entries(layers.below ?? {}).map(([name, picture]) => [name, readPicture(picture)])),
    relief: { ...layers.relief, shade: unpack(layers.relief.shade) },
    pavement: layers.pavement.map((rings) => rings.map(unpack)),
    unexamined: (layers.unexamined ?? []).map((rings) => rings.map(unpack)),
    edges: layers.edges.map((edge) => ({ ...edge, xy: unpack(edge.xy) })),
    candidates: layers.candidates && {
      xy: unpack(layers.candidates.xy),
      heights: unpack(layers.candidates.heights),
      lowest: unpack(layers.candidates.lowest_m),
      highest: unpack(layers.candidates.highest_m),
      round: unpack(layers.candidates.round),
    },
    targets: targets ?? { names: [], xyz: new Float32Array(0) },
  };
  site.plans = content.plans.map((plan) => readPlan(plan, site.targets.names.length));
  site.extent = extentOf(site);
  return site;
}

// Box around the road, or around the terrain where no road was found.
function extentOf(site) {
  const box = { west: Infinity, south: Infinity, east: -Infinity, north: -Infinity };
  const include = (x, y) => {
    box.west = Math.min(box.west, x);
    box.east = Math.max(box.east, x);
    box.south = Math.min(box.south, y);
    box.north = Math.max(box.north, y);
  };
  for (const line of [...site.pavement.flat(), ...site.edges.map((edge) => edge.xy)]) {
    for (let i = 0; i < line.length; i += 2) include(line[i], line[i + 1]);
  }
  if (box.west > box.east) {
    const { west_m, north_m, rows, columns, cell_size_m } = site.relief;
    include(west_m, north_m);
    include(west_m + columns * cell_size_m, north_m - rows * cell_size_m);
  }
  return box;
}

// Angle of the road's long axis, counter-clockwise from east, from the pavement's outline.
function roadAngle(site) {
  const points = site.pavement.flat();
  let n = 0, sx = 0, sy = 0, sxx = 0, sxy = 0, syy = 0;
  for (const ring of points) {
    for (let i = 0; i < ring.length; i += 2) {
      const x = ring[i], y = ring[i + 1];
      n++; sx += x; sy += y; sxx += x * x; sxy += x * y; syy += y * y;
    }
  }
  if (n === 0) return 0;
  return Math.atan2(2 * (sxy - sx * sy / n), sxx - sx * sx / n - (syy - sy * sy / n)) / 2;
}

function themeColours() {
  const style = getComputedStyle(document.documentElement);
  return (name) => style.getPropertyValue(`--${name}`).trim();
}

const bucketOf = (times) => Math.min(times, MOST_SEEN);
const formatNumber = (value, decimals = 0) =>
  value.toLocaleString("en", { minimumFractionDigits: decimals, maximumFractionDigits: decimals });
const counted = (count, noun) => `${formatNumber(count)} ${noun}${count === 1 ? "" : "s"}`;
