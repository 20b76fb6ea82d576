// Pinhole cameras as the workflow has them: x right, y down, z forward; heading clockwise from
// north, pitch upwards, roll with the right side up; pixel centres at whole numbers.

const RADIANS = Math.PI / 180;

const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

// Rows: right, down, forward.
function axes({ heading_deg, pitch_deg, roll_deg }) {
  const [h, p, r] = [heading_deg, pitch_deg, roll_deg].map((angle) => angle * RADIANS);
  const forward = [Math.sin(h) * Math.cos(p), Math.cos(h) * Math.cos(p), Math.sin(p)];
  const level = [Math.cos(h), -Math.sin(h), 0];
  const down = cross(forward, level);
  const mix = (a, b, s, t) => a.map((value, k) => s * value + t * b[k]);
  return [mix(level, down, Math.cos(r), -Math.sin(r)), mix(level, down, Math.sin(r), Math.cos(r)), forward];
}

// Function of a place: its pixel and depth, null behind the camera, of a principal point.
export function projector(pose, [cx, cy]) {
  const [right, down, forward] = axes(pose);
  return (x, y, z) => {
    const [a, b, c] = [x - pose.x, y - pose.y, z - pose.z];
    const depth = forward[0] * a + forward[1] * b + forward[2] * c;
    if (depth <= 0.1) return null;
    return [
      cx + (pose.focal_px * (right[0] * a + right[1] * b)) / depth + (pose.focal_px * right[2] * c) / depth,
      cy + (pose.focal_px * (down[0] * a + down[1] * b + down[2] * c)) / depth,
      depth,
    ];
  };
}

export const fieldOfView = (focal, width) => (2 * Math.atan2(0.5 * width, focal)) / RADIANS;
export const focalOf = (degrees, width) => (0.5 * width) / Math.tan(0.5 * degrees * RADIANS);
const wrap = (angle) => ((((angle + 180) % 360) + 360) % 360) - 180;

// How a pose differs from another one, along its view: metres ahead, right, up, then degrees.
export const KNOBS = {
  ahead: ["Ahead", "m", 8, 0.01], right: ["Right", "m", 8, 0.01], up: ["Up", "m", 4, 0.01],
  heading: ["Heading", "°", 15, 0.01], pitch: ["Pitch", "°", 15, 0.01], roll: ["Roll", "°", 8, 0.01],
};

export function knobsOf(pose, base) {
  const [sine, cosine] = [Math.sin(base.heading_deg * RADIANS), Math.cos(base.heading_deg * RADIANS)];
  const [dx, dy] = [pose.x - base.x, pose.y - base.y];
  return {
    ahead: dx * sine + dy * cosine, right: dx * cosine - dy * sine, up: pose.z - base.z,
    heading: wrap(pose.heading_deg - base.heading_deg), pitch: pose.pitch_deg - base.pitch_deg, roll: wrap(pose.roll_deg - base.roll_deg),
  };
}

export function turned(base, knobs, focal_px) {
  const [sine, cosine] = [Math.sin(base.heading_deg * RADIANS), Math.cos(base.heading_deg * RADIANS)];
  return {
    x: base.x + knobs.ahead * sine + knobs.right * cosine,
    y: base.y + knobs.ahead * cosine - knobs.right * sine,
    z: base.z + knobs.up,
    heading_deg: (base.heading_deg + knobs.heading + 360) % 360,
    pitch_deg: Math.max(-89, Math.min(89, base.pitch_deg + knobs.pitch)),
    roll_deg: wrap(base.roll_deg + knobs.roll),
    focal_px,
  };
}
