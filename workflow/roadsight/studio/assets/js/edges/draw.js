// The drawing over the cloud: shapes, splines, candidates, what one snaps to.

import { themeColour } from "../dom.js";
import { LAYERS, itemsOf, pointsOf } from "./shapes.js";

const COLOURS = { zones: "zone", mounts: "mount", add: "area", remove: "zone" };
const NEAR_PX = 2;
const KIND_COLOURS = { edge: "edge", median: "median", line: "other" };

// state: editor, preview (answer of the server), area (rings), references, shown (layers).
export function drawAll(context, view, state) {
  const halo = themeColour("halo");
  const line = (points, colour, width = 2, dash = [], closed = false) => {
    for (const [style, extra] of [[halo, 2.5], [colour, 0]]) {
      context.setLineDash(extra ? [] : dash);
      context.lineWidth = width + extra;
      context.strokeStyle = style;
      trace(context, points, closed);
      context.stroke();
    }
    context.setLineDash([]);
  };
  const flat = (values, width) => pixels(view, values, width);
  if (state.shown.reference) for (const xyz of state.references.lines) line(flat(xyz, 3), themeColour("reference"), 1, [5, 4]);
  if (state.shown.area) for (const ring of state.preview?.area ?? state.area) line(flat(ring, 3), themeColour("area"), 1.5, [], true);
  drawPolygons(context, view, state, line);
  for (const { name, xyz } of state.preview?.edges ?? []) {
    const edge = state.editor.now.edges.find((one) => one.name === name);
    if (edge) line(flat(xyz, 3), themeColour(KIND_COLOURS[edge.kind]), 2.5);
  }
  if (state.shown.candidates && state.preview) drawCandidates(context, view, state.preview);
  drawHandles(context, view, state, halo);
  drawPointer(context, view, state);
}

// Pixels of flat coordinates.
function pixels(view, values, width) {
  const found = [];
  for (let i = 0; i < values.length; i += width) found.push(view.project(values[i], values[i + 1], width > 2 ? values[i + 2] : 0));
  return found;
}

// Pixels of a shape's points; in 3D on the terrain, once the server has said where that is.
function pixelsOf(view, { editor, preview }, layer, number) {
  if (view.mode === "plan") return pixels(view, pointsOf(itemsOf(editor.now, layer)[number], layer).flat(), 2);
  return pixels(view, preview?.lifted[layer][number] ?? [], 3);
}

// A path through pixels; points that are too near to see are left out.
function trace(context, points, closed) {
  context.beginPath();
  let pen = null;
  points.forEach((point, number) => {
    if (!point) pen = null;
    else if (!pen) { context.moveTo(...point); pen = point; }
    else if (number === points.length - 1 || Math.abs(point[0] - pen[0]) + Math.abs(point[1] - pen[1]) > NEAR_PX) {
      context.lineTo(...point);
      pen = point;
    }
  });
  if (closed) context.closePath();
}

function drawPolygons(context, view, state, line) {
  for (const layer of ["zones", "add", "remove"]) {
    const colour = themeColour(COLOURS[layer]);
    for (const number of itemsOf(state.editor.now, layer).keys()) {
      const points = pixelsOf(view, state, layer, number);
      trace(context, points, true);
      context.globalAlpha = 0.22;
      context.fillStyle = colour;
      context.fill();
      context.globalAlpha = 1;
      line(points, colour, 2, layer === "remove" ? [6, 4] : [], true);
    }
  }
}

function drawCandidates(context, view, { positions, forbidden }) {
  const [free, not] = ["candidate", "forbidden"].map(themeColour);
  const halo = themeColour("halo");
  for (let i = 0; i < forbidden.length; i++) {
    const [x, y, z, yaw] = positions.slice(4 * i, 4 * i + 4);
    const point = view.project(x, y, z);
    if (!point) continue;
    const facing = view.project(x + Math.cos((yaw * Math.PI) / 180), y + Math.sin((yaw * Math.PI) / 180), z);
    context.strokeStyle = context.fillStyle = forbidden[i] ? not : free;
    context.lineWidth = 1.5;
    context.beginPath();
    if (forbidden[i]) {
      context.moveTo(point[0] - 3, point[1] - 3); context.lineTo(point[0] + 3, point[1] + 3);
      context.moveTo(point[0] + 3, point[1] - 3); context.lineTo(point[0] - 3, point[1] + 3);
      context.stroke();
      continue;
    }
    if (facing) {
      const length = Math.hypot(facing[0] - point[0], facing[1] - point[1]) || 1;
      context.moveTo(...point);
      context.lineTo(point[0] + (9 * (facing[0] - point[0])) / length, point[1] + (9 * (facing[1] - point[1])) / length);
      context.stroke();
    }
    context.beginPath();
    context.arc(...point, 3.2, 0, 7);
    context.fill();
    context.lineWidth = 1;
    context.strokeStyle = halo;
    context.stroke();
  }
}

function drawHandles(context, view, state, halo) {
  const { editor } = state;
  for (const layer of Object.keys(LAYERS)) {
    itemsOf(editor.now, layer).forEach((item, number) => {
      const chosen = editor.chosen?.layer === layer && editor.chosen.item === number;
      const colour = themeColour(chosen ? "chosen" : layer === "edges" ? KIND_COLOURS[item.kind] : COLOURS[layer]);
      const places = pixelsOf(view, state, layer, number);
      places.forEach((point, vertex) => {
        if (!point) return;
        const held = chosen && editor.chosen.vertex === vertex;
        const size = held ? 6 : chosen ? 4.5 : 3.5;
        context.beginPath();
        if (layer === "mounts") context.arc(...point, size + 1.5, 0, 7);
        else context.rect(point[0] - size, point[1] - size, 2 * size, 2 * size);
        context.fillStyle = held ? colour : halo;
        context.strokeStyle = colour;
        context.lineWidth = 2;
        context.fill();
        context.stroke();
      });
      if (chosen && item.name) label(context, places[0], item.name, colour, halo);
    });
  }
}

function label(context, point, text, colour, halo) {
  if (!point) return;
  context.font = "600 12px sans-serif";
  context.lineWidth = 3;
  context.strokeStyle = halo;
  context.fillStyle = colour;
  context.strokeText(text, point[0] + 9, point[1] - 8);
  context.fillText(text, point[0] + 9, point[1] - 8);
}

// Where a click would go: on what it snaps to, and the cross for drawing by keys.
function drawPointer(context, view, { editor }) {
  if (editor.tool === "select" || view.mode !== "plan") return;
  const colour = themeColour("chosen");
  const layer = Object.keys(LAYERS).find((name) => LAYERS[name].tool === editor.tool);
  const pixel = editor.hover ?? view.size.map((side) => side / 2);
  const place = view.project(...editor.place(pixel, layer));
  context.strokeStyle = colour;
  context.lineWidth = 1.5;
  if (editor.drawing && editor.chosen) {
    const points = pointsOf(itemsOf(editor.now, layer)[editor.chosen.item], layer);
    context.setLineDash([4, 4]);
    trace(context, [view.project(...points.at(-1)), place], false);
    context.stroke();
    context.setLineDash([]);
  }
  context.beginPath();
  context.arc(...place, 5, 0, 7);
  if (!editor.hover) {
    context.moveTo(place[0] - 12, place[1]); context.lineTo(place[0] + 12, place[1]);
    context.moveTo(place[0], place[1] - 12); context.lineTo(place[0], place[1] + 12);
  }
  context.stroke();
}
