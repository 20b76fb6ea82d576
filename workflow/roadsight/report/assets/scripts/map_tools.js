// What people do on any map: read coordinates, measure, look the place up in an online map.

const RULER_PX = 4;

// Longitude and latitude of a place, by the polynomials that the page brings along.
function lonLat(place, x, y) {
  if (!place.lon_lat) return null;
  const u = (x - place.centre_m[0]) / place.span_m, v = (y - place.centre_m[1]) / place.span_m;
  const terms = [1, u, v, u * u, u * v, v * v];
  return place.lon_lat.map((row) => row.reduce((sum, factor, i) => sum + factor * terms[i], 0));
}

function coordinatesText(place, x, y) {
  const [east, north] = [x, y].map((value, i) => formatNumber(place.origin[i] + value / place.unit_m, 2));
  const degrees = lonLat(place, x, y);
  const native = degrees ? `E ${east}, N ${north} ${place.unit}` : `x ${east}, y ${north} ${place.unit}`;
  if (!degrees) return native;
  const [lon, lat] = degrees;
  const side = (value, letters) => `${formatNumber(Math.abs(value), 6)}\u00b0 ${letters[value < 0 ? 1 : 0]}`;
  // A line may end between the two pairs, not within one.
  return [native, `${side(lat, "NS")}, ${side(lon, "EW")}`].map((pair) => pair.replaceAll(" ", "\u00a0")).join(" \u00b7 ");
}

function onlineMap(place, x, y) {
  const degrees = lonLat(place, x, y);
  if (!degrees) return null;
  const [lon, lat] = degrees.map((value) => value.toFixed(6));
  return `https://www.openstreetmap.org/?mlat=${lat}&mlon=${lon}#map=19/${lat}/${lon}`;
}

// A line of clicked places with its length so far; the last place follows the pointer.
class Ruler {
  constructor(place) {
    Object.assign(this, { place, points: [], pointer: null, ended: false });
  }

  add(at) {
    if (this.ended) Object.assign(this, { points: [], ended: false });
    this.points.push(at);
  }

  get line() {
    return this.ended || !this.pointer ? this.points : [...this.points, this.pointer];
  }

  get text() {
    const { line } = this;
    if (line.length < 2) return "Click two places or more; Escape ends the line.";
    const lengths = line.slice(1).map(([x, y], i) => Math.hypot(x - line[i][0], y - line[i][1]));
    const total = lengths.reduce((sum, length) => sum + length, 0);
    const { unit, unit_m } = this.place;
    const native = unit_m === 1 ? "" : ` = ${formatNumber(total / unit_m, 2)} ${unit}`;
    const last = lengths.length > 1 ? ` (last part ${formatNumber(lengths.at(-1), 2)} m)` : "";
    return `${formatNumber(total, 2)} m${native}${last}`;
  }

  paint(map) {
    const { context } = map;
    const places = this.line.map(([x, y]) => map.toScreen(x, y));
    if (!places.length) return;
    for (const [colour, width] of [["surface", 5], ["accent", 2.5]]) {
      context.strokeStyle = map.colour(colour);
      context.lineWidth = width;
      context.beginPath();
      places.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
      context.stroke();
    }
    context.fillStyle = map.colour("accent");
    for (const [x, y] of places) {
      context.beginPath();
      context.arc(x, y, RULER_PX, 0, 2 * Math.PI);
      context.fill();
    }
  }
}
