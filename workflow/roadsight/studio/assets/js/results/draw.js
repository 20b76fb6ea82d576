// Sensors, targets, candidates and obstacles; poles, ellipses and rays, over the cloud.

import { themeColour } from "../dom.js";

const FACING_M = 3;

export function dot(context, point, radius, fill, line, width = 1.5) {
  context.beginPath();
  context.arc(...point, radius, 0, 7);
  context.fillStyle = fill;
  context.fill();
  context.lineWidth = width;
  context.strokeStyle = line;
  context.stroke();
}

export function label(context, [x, y], text, colour, halo) {
  context.font = "600 12px sans-serif";
  context.lineWidth = 3;
  context.strokeStyle = halo;
  context.fillStyle = colour;
  context.strokeText(text, x + 9, y - 7);
  context.fillText(text, x + 9, y - 7);
}

const inside = ([x, y], [width, height]) => x > -20 && y > -20 && x < width + 20 && y < height + 20;

export function drawLayout(context, view, what) {
  drawTargets(context, view, what);
  if (what.shown.candidates || what.moving || what.adding) drawCandidates(context, view, what);
  if (what.shown.obstacles) drawObstacles(context, view, what);
  drawSensors(context, view, what);
}

function drawTargets(context, view, { about, coverage }) {
  const colours = [0, 1, 2, 3, 4].map((n) => themeColour(`seen-${n}`));
  const size = Math.max(2, Math.min(5, 0.45 * (view.mode === "plan" ? view.camera.zoom : 6)));
  coverage.times.forEach((times, n) => {
    const point = view.project(about.targets[3 * n], about.targets[3 * n + 1], about.targets[3 * n + 2]);
    if (!point || !inside(point, view.size)) return;
    const missing = coverage.needs[n] > 0;
    const wide = missing ? size + 1.5 : size;
    context.fillStyle = colours[missing ? 0 : Math.min(times, 4)];
    context.fillRect(point[0] - wide / 2, point[1] - wide / 2, wide, wide);
  });
}

function drawCandidates(context, view, { about, kind, moving, sensors, chosen }) {
  const { xyz, sensor } = about.choices;
  const wanted = moving ? sensor[sensors[chosen].row] : kind;
  const [colour, halo] = ["candidate", "halo"].map(themeColour);
  const drawn = new Set();
  for (let row = 0; row < sensor.length; row++) {
    if (sensor[row] !== wanted) continue;
    const point = view.project(xyz[3 * row], xyz[3 * row + 1], xyz[3 * row + 2]);
    if (!point || !inside(point, view.size)) continue;
    const cell = `${Math.round(point[0])} ${Math.round(point[1])}`;
    if (drawn.has(cell)) continue;
    drawn.add(cell);
    dot(context, point, 2.6, colour, halo, 1);
  }
}

function drawObstacles(context, view, { about }) {
  const [colour, halo] = ["mount", "halo"].map(themeColour);
  for (const { x, y, z, targets } of about.obstacles) {
    const point = view.project(x, y, z);
    if (point && inside(point, view.size)) dot(context, point, 2 + Math.min(6, 0.6 * Math.sqrt(targets)), colour, halo);
  }
}

function drawSensors(context, view, { about, sensors, chosen }) {
  const [colour, halo, off] = ["chosen", "halo", "muted"].map(themeColour);
  sensors.forEach(({ row, before, on }, number) => {
    const [x, y, z] = about.choices.xyz.slice(3 * row, 3 * row + 3);
    const point = view.project(x, y, z);
    if (!point) return;
    const foot = view.project(x, y, z - about.choices.height_m[row]);
    const yaw = (about.choices.yaw_deg[row] * Math.PI) / 180;
    const facing = view.project(x + FACING_M * Math.cos(yaw), y + FACING_M * Math.sin(yaw), z);
    context.strokeStyle = on ? colour : off;
    context.lineWidth = 2;
    for (const end of [facing, foot]) {
      if (!end) continue;
      context.beginPath();
      context.moveTo(...point);
      context.lineTo(...end);
      context.stroke();
    }
    if (before !== null && before !== row) drawMove(context, view.project(...about.choices.xyz.slice(3 * before, 3 * before + 3)), point, off);
    dot(context, point, number === chosen ? 9 : 6.5, on ? colour : halo, on ? halo : off, number === chosen ? 3 : 2);
    label(context, point, `${number + 1}${before === null ? " added" : on ? "" : " off"}`, on ? colour : off, halo);
  });
}

function drawMove(context, from, to, colour) {
  if (!from) return;
  context.setLineDash([5, 4]);
  context.strokeStyle = colour;
  context.beginPath();
  context.moveTo(...from);
  context.lineTo(...to);
  context.stroke();
  context.setLineDash([]);
}
