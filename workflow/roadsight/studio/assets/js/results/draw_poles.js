// Poles with their error ellipses, and rays from the cameras that saw the chosen one.

import { themeColour } from "../dom.js";
import { dot, label } from "./draw.js";

const CORNERS = 36;
const LEAST_ELLIPSE_PX = 4;

export function drawPoles(context, view, poles) {
  const halo = themeColour("halo");
  poles.about.poles.forEach((pole, number) => {
    const state = poles.stateOf(pole);
    const colour = themeColour(`pole-${state}`);
    const z = pole.z ?? 0;
    const [x, y] = poles.placeOf(pole);
    const point = view.project(x, y, z);
    if (!point) return;
    const chosen = number === poles.chosen;
    if (chosen) drawRays(context, view, pole, z);
    drawEllipse(context, view, pole, z, colour, chosen);
    if (state === "move") drawShift(context, view.project(...pole.base, z), point, colour);
    const solid = state !== "withheld" && state !== "reject";
    dot(context, point, chosen ? 8 : 5, solid ? colour : halo, solid ? halo : colour, chosen ? 3 : 2);
    if (state === "reject") cross(context, point, colour);
    if (chosen) label(context, point, pole.id, colour, halo);
  });
}

// 1-sigma ellipse around where the pole was computed.
function drawEllipse(context, view, { base, sigma_major_m: major, sigma_minor_m: minor, sigma_azimuth_deg: azimuth }, z, colour, chosen) {
  if (![major, minor, azimuth].every(Number.isFinite)) return;
  const angle = (azimuth * Math.PI) / 180;
  context.beginPath();
  for (let n = 0; n <= CORNERS; n++) {
    const turn = (2 * Math.PI * n) / CORNERS;
    const [a, b] = [major * Math.cos(turn), minor * Math.sin(turn)];
    const point = view.project(base[0] + a * Math.sin(angle) + b * Math.cos(angle), base[1] + a * Math.cos(angle) - b * Math.sin(angle), z);
    if (!point) return;
    context.lineTo(...point);
  }
  if (!chosen && view.mode === "plan" && major * view.camera.zoom < LEAST_ELLIPSE_PX) return;
  context.strokeStyle = colour;
  context.lineWidth = chosen ? 2.5 : 1.2;
  context.stroke();
}

function drawRays(context, view, { base, seen }, z) {
  context.strokeStyle = themeColour("chosen");
  context.lineWidth = 1.2;
  for (const { x, y } of seen) {
    const [from, to] = [view.project(x, y, z), view.project(...base, z)];
    if (!from || !to) continue;
    context.beginPath();
    context.moveTo(...from);
    context.lineTo(...to);
    context.stroke();
    dot(context, from, 3, themeColour("chosen"), themeColour("halo"), 1);
  }
}

function drawShift(context, from, to, colour) {
  if (!from) return;
  context.setLineDash([5, 4]);
  context.strokeStyle = colour;
  context.lineWidth = 1.5;
  context.beginPath();
  context.moveTo(...from);
  context.lineTo(...to);
  context.stroke();
  context.setLineDash([]);
}

function cross(context, [x, y], colour) {
  context.strokeStyle = colour;
  context.lineWidth = 2;
  context.beginPath();
  context.moveTo(x - 6, y - 6); context.lineTo(x + 6, y + 6);
  context.moveTo(x + 6, y - 6); context.lineTo(x - 6, y + 6);
  context.stroke();
}
