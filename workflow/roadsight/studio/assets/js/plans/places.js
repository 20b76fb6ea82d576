// Places of a plan as lines of text, and those that a what-if means.

const SMALLEST_M = 0.3;
const SHARE = 0.45; // of the way to the next place, so that it alone lies inside

export const standingText = (places) => places.map(({ x, y, kind, height_m: height, candidate }) => [x.toFixed(3), y.toFixed(3), kind, height ?? "", ...(candidate ? [candidate] : [])].join("; ")).join("\n");
export const barredText = (places) => places.map(({ x, y, half_m: half }) => [x.toFixed(3), y.toFixed(3), half.toFixed(2)].join("; ")).join("\n");

// Parts of each line: at semicolons or tabs where it has them, so that commas may be decimal ones.
const fields = (text) => text.split("\n").map((line) => line.trim()).filter(Boolean).map((line) => (
  line.split(/[;\t]/.test(line) ? /[;\t]/ : ",").map((part) => part.trim())));

function number(text, line) {
  const value = Number(text?.replace(",", "."));
  if (!text || !Number.isFinite(value)) throw new Error(`Line ${line + 1} of the places: “${text ?? ""}” is no number.`);
  return value;
}

export const readStanding = (text) => fields(text).map(([x, y, kind = "", height = "", candidate = ""], line) => ({
  x: number(x, line), y: number(y, line), kind, height_m: height === "" ? null : number(height, line), candidate,
}));

export const readBarred = (text) => fields(text).map(([x, y, half], line) => ({ x: number(x, line), y: number(y, line), half_m: number(half, line) }));

// Where sensors stand now, and where the plan's own were left; native coordinates.
export function placesOf({ about, rows }) {
  const { xyz, key, height_m: heights, sensor, name, posed } = about.choices;
  const { origin, unit_m: unit } = about.frame;
  const native = (row) => ({ x: xyz[3 * row] / unit + origin[0], y: xyz[3 * row + 1] / unit + origin[1] });
  const taken = new Set(rows.map((row) => key[row]));
  const left = about.chosen.filter((row, n, all) => !taken.has(key[row]) && all.findIndex((other) => key[other] === key[row]) === n);
  const free = (row) => key.reduce((best, value, other) => (value === key[row] ? best
    : Math.min(best, Math.max(Math.abs(xyz[3 * other] - xyz[3 * row]), Math.abs(xyz[3 * other + 1] - xyz[3 * row + 1])))), Infinity);
  return {
    mandatory: rows.map((row) => ({ ...native(row), kind: about.sensors[sensor[row]].name, height_m: heights[row], candidate: posed[row] ? name[row] : "" })),
    forbidden: left.map((row) => ({ ...native(row), half_m: Math.max(SMALLEST_M, Math.min(SHARE * free(row), 1e3)) })),
  };
}
