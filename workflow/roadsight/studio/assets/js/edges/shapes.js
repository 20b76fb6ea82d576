// The drawing as one document, and its layers as lists of shapes with points.

export const LAYERS = {
  edges: { title: "Road edges", tool: "edge", least: 2, closed: false },
  zones: { title: "Zones without sensors", tool: "zone", least: 3, closed: true },
  mounts: { title: "Existing poles as mounts", tool: "mount", least: 1, closed: false },
  add: { title: "Added area", tool: "add", least: 3, closed: true },
  remove: { title: "Removed area", tool: "remove", least: 3, closed: true },
};
const INITIAL = { edges: "e", zones: "zone", mounts: "p" };

export const documentOf = ({ edges, zones, mounts }) => ({ edges, zones, mounts, tma: { base: "current", add: [], remove: [] } });

export const itemsOf = (drawing, layer) => (layer === "add" || layer === "remove" ? drawing.tma[layer] : drawing[layer]);

// Points of a shape as a list that may be changed in place (poles have one).
export function pointsOf(item, layer) {
  if (layer === "mounts") return [[item.x, item.y]];
  return layer === "add" || layer === "remove" ? item : item.points;
}

export function setPoint(item, layer, vertex, [x, y]) {
  const place = [round(x), round(y)];
  if (layer === "mounts") [item.x, item.y] = place;
  else pointsOf(item, layer)[vertex] = place;
}

export const round = (value) => Math.round(value * 1e4) / 1e4;

export function newItem(drawing, layer, [x, y]) {
  const place = [round(x), round(y)];
  if (layer === "add" || layer === "remove") return [place];
  const name = freeName(drawing, layer);
  if (layer === "mounts") return { name, x: place[0], y: place[1], height_m: null };
  return layer === "edges" ? { name, kind: "edge", points: [place] } : { name, points: [place] };
}

function freeName(drawing, layer) {
  const names = new Set(drawing[layer].map(({ name }) => name));
  for (let n = 1; ; n++) if (!names.has(`${INITIAL[layer]}${n}`)) return `${INITIAL[layer]}${n}`;
}

// Layers in which two drawings differ, as the server takes them.
export function changedLayers(now, before) {
  const names = ["edges", "zones", "mounts", "tma"].filter((name) => JSON.stringify(now[name]) !== JSON.stringify(before[name]));
  return Object.fromEntries(names.map((name) => [name, now[name]]));
}

// Nearest point of a polyline (flat coordinates, so many numbers a point) to a place.
export function nearestOnLine(flat, width, x, y, best) {
  for (let i = 0; i + width < flat.length; i += width) {
    const [ax, ay, bx, by] = [flat[i], flat[i + 1], flat[i + width], flat[i + width + 1]];
    const length = (bx - ax) ** 2 + (by - ay) ** 2;
    const share = length > 0 ? Math.max(0, Math.min(1, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length)) : 0;
    const place = [ax + share * (bx - ax), ay + share * (by - ay)];
    const distance = Math.hypot(place[0] - x, place[1] - y);
    if (distance < best.distance) Object.assign(best, { distance, place, segment: i / width });
  }
  return best;
}

// A place moved onto what the workflow found, if that is near.
export function snapped([x, y], references, reach) {
  const best = { distance: reach, place: null };
  for (const pole of references.poles ?? []) {
    const distance = Math.hypot(pole.x - x, pole.y - y);
    if (distance < best.distance) Object.assign(best, { distance, place: [pole.x, pole.y] });
  }
  for (const ring of references.rings ?? []) nearestOnLine(ring, 3, x, y, best);
  for (const line of references.lines ?? []) nearestOnLine(line, 3, x, y, best);
  return best.place;
}
