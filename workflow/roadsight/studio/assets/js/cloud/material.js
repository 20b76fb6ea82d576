// How a point becomes a pixel: position within its tile's box, colour by what is asked for.

import { BufferGeometry, GLSL3, InterleavedBuffer, InterleavedBufferAttribute, Points, ShaderMaterial } from "../vendor.js";

export const COLOURS = { height: "Height", ground: "Ground", intensity: "Intensity", class: "Class" };
const MODES = Object.keys(COLOURS);
const WORDS = 6;

// LAS 1.4 classes that have a colour of their own.
export const CLASSES = {
  1: ["Unclassified", "#9aa3ad"], 2: ["Ground", "#a9825a"], 3: ["Low vegetation", "#a5d06b"],
  4: ["Medium vegetation", "#5fae4b"], 5: ["High vegetation", "#2c7a3a"], 6: ["Building", "#d9705f"],
  7: ["Low noise", "#ff00ff"], 9: ["Water", "#4aa3df"], 11: ["Road", "#6e7f92"], 14: ["Wire", "#e8c547"],
  15: ["Tower", "#c77dff"], 17: ["Bridge", "#38bdf8"], 18: ["High noise", "#ff00ff"],
};
export const GROUND = { ground: ["Ground", "#b08d62"], above: ["Above ground", "#4f8fd6"] };
export const HIGHEST_M = 12;
const STOPS = ["#5d7196", "#2a86a8", "#3fb67a", "#c6d84a", "#f2a03d", "#d9423a"];
export const HEIGHT_STOPS = STOPS;

const vec = (hex) => `vec3(${[1, 3, 5].map((i) => (parseInt(hex.slice(i, i + 2), 16) / 255).toFixed(4)).join(",")})`;

const VERTEX = `
in vec3 a_extra;
uniform float u_mode, u_size, u_least, u_most, u_scale;
out vec3 v_colour;
vec3 ramp(float t) {
  vec3 stops[${STOPS.length}] = vec3[](${STOPS.map(vec).join(",")});
  float at = clamp(t, 0.0, 1.0) * ${(STOPS.length - 1).toFixed(1)};
  int low = int(min(floor(at), ${(STOPS.length - 2).toFixed(1)}));
  return mix(stops[low], stops[low + 1], at - float(low));
}
vec3 classed(int c) {
  ${Object.entries(CLASSES).map(([c, [, hex]]) => `if (c == ${c}) return ${vec(hex)};`).join("\n  ")}
  return vec3(0.72, 0.75, 0.78);
}
void main() {
  vec4 seen = modelViewMatrix * vec4(position, 1.0);
  gl_Position = projectionMatrix * seen;
  float spread = projectionMatrix[3][3] == 1.0 ? u_scale : u_scale / max(-seen.z, 0.1);
  gl_PointSize = clamp(u_size * spread, u_least, u_most);
  float height = a_extra.x > 32767.0 ? a_extra.x - 65536.0 : a_extra.x;
  float cls = floor(a_extra.y / 256.0), light = (a_extra.y - 256.0 * cls) / 255.0;
  float ground = mod(a_extra.z, 256.0);
  if (u_mode < 0.5) v_colour = ramp(height / ${(100 * HIGHEST_M).toFixed(1)}) * (0.5 + 0.6 * sqrt(light));
  else if (u_mode < 1.5) v_colour = (ground > 0.5 ? ${vec(GROUND.ground[1])} : ${vec(GROUND.above[1])}) * (0.55 + 0.5 * sqrt(light));
  else if (u_mode < 2.5) v_colour = vec3(0.12 + 0.86 * sqrt(light));
  else v_colour = classed(int(cls)) * (0.55 + 0.5 * sqrt(light));
}`;

const FRAGMENT = `
in vec3 v_colour;
out vec4 colour;
void main() { colour = vec4(v_colour, 1.0); }`;

export function pointMaterial() {
  return new ShaderMaterial({
    glslVersion: GLSL3, vertexShader: VERTEX, fragmentShader: FRAGMENT,
    uniforms: Object.fromEntries(Object.entries({ u_mode: 0, u_size: 0.11, u_least: 1, u_most: 6, u_scale: 1 })
      .map(([name, value]) => [name, { value }])),
  });
}

export const modeNumber = (name) => MODES.indexOf(name);

// Points of one chunk, placed in its tile's box: x, y, z as shares of the box.
export function chunkPoints(bytes, box, material) {
  const buffer = new InterleavedBuffer(new Uint16Array(bytes), WORDS);
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new InterleavedBufferAttribute(buffer, 3, 0, true));
  geometry.setAttribute("a_extra", new InterleavedBufferAttribute(buffer, 3, 3, false));
  const points = new Points(geometry, material);
  points.position.set(box[0], box[1], box[2]);
  points.scale.set(...[0, 1, 2].map((k) => Math.max(box[k + 3] - box[k], 1e-6)));
  points.updateMatrixWorld();
  points.matrixAutoUpdate = false;
  points.frustumCulled = false;
  points.userData.count = buffer.count;
  return points;
}
