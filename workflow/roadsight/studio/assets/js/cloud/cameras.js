// The two ways to look at a cloud: from above without perspective, and from anywhere.

import { MapControls, OrthographicCamera, PerspectiveCamera, Vector3 } from "../vendor.js";

export const FIELD_OF_VIEW_DEG = 50;
const PLAN_HEIGHT_M = 5000;

// Box of the tiles, its longer side, and cameras and controls by mode; onmove: one of them moved.
export function camerasOf(tiles, canvas, onmove) {
  const boxes = tiles.map(({ box }) => box);
  const low = [0, 1, 2].map((k) => Math.min(...boxes.map((box) => box[k])));
  const high = [3, 4, 5].map((k) => Math.max(...boxes.map((box) => box[k])));
  const middle = low.map((value, k) => (value + high[k]) / 2);
  const extent = Math.max(high[0] - low[0], high[1] - low[1], 1);
  const ground = Math.min(low[2] + 0.15 * (high[2] - low[2]), middle[2]);
  const target = new Vector3(middle[0], middle[1], ground);
  const plan = new OrthographicCamera(-1, 1, 1, -1, 0.1, 2 * PLAN_HEIGHT_M);
  plan.up.set(0, 1, 0);
  plan.position.set(target.x, target.y, PLAN_HEIGHT_M);
  const space = new PerspectiveCamera(FIELD_OF_VIEW_DEG, 1, 0.3, 20 * extent + 500);
  space.up.set(0, 0, 1);
  space.position.set(target.x, target.y - 0.55 * extent, ground + 0.35 * extent);
  const cameras = { plan, "3d": space };
  const controls = Object.fromEntries(Object.entries(cameras).map(([mode, camera]) => [mode, controlsOf(mode, camera, canvas, target, onmove)]));
  return { box: { low, high }, extent, cameras, controls };
}

function controlsOf(mode, camera, canvas, target, onmove) {
  const controls = new MapControls(camera, canvas);
  const flat = mode === "plan";
  Object.assign(controls, {
    enableDamping: false, zoomToCursor: true, screenSpacePanning: flat, enableRotate: !flat, maxPolarAngle: (flat ? 1 : 0.495) * Math.PI,
  });
  if (flat) controls.minZoom = 1e-4;
  else controls.minDistance = 1;
  controls.target.copy(target);
  controls.update();
  controls.enabled = false;
  controls.addEventListener("change", onmove);
  return controls;
}
