// Which parts of the cloud are wanted, fetched and kept: tiles times levels of detail.

import { getBytes, siteUrl } from "../api.js";
import { Box3, Frustum, Matrix4, Vector3 } from "../vendor.js";
import { chunkPoints } from "./material.js";

const FETCHES = 4;
export const COARSEST_PX = 1.7;

export class Tiles {
  // about: answer of the server; onload: called when more can be drawn.
  constructor(stem, about, scene, material, onload) {
    Object.assign(this, { stem, about, scene, material, onload });
    this.mostPoints = 5_000_000;
    this.coarsestPx = COARSEST_PX;
    this.chunks = new Map();
    this.fetching = new Map();
    this.loaded = 0;
    this.tiles = about.tiles.map(({ points, box }, number) => ({
      number, points, box, bounds: new Box3(new Vector3(...box.slice(0, 3)), new Vector3(...box.slice(3))),
    }));
  }

  // Chunks to draw, coarse ones first; fetches those that are missing.
  update(camera, pixelsPerMetre) {
    const frustum = new Frustum().setFromProjectionMatrix(new Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse));
    const seen = this.tiles.filter((tile) => frustum.intersectsBox(tile.bounds));
    for (const tile of seen) tile.scale = pixelsPerMetre(tile.bounds);
    this.wanted = this.choose(seen);
    this.fetch();
    const ready = this.wanted.map(({ key }) => this.chunks.get(key)).filter((chunk) => chunk?.points);
    return ready.map((chunk) => { chunk.used = performance.now(); return chunk.points; });
  }

  // Levels of each tile that its size on the screen calls for, coarse and near ones first, up to the
  // number of points that memory allows.
  choose(seen) {
    const cells = this.about.cells_m;
    const wanted = [];
    for (const tile of seen) {
      for (let level = 0; level < cells.length; level++) {
        if (level > 0 && cells[level - 1] * tile.scale < this.coarsestPx) break;
        wanted.push({ key: `${tile.number}/${level}`, tile, level });
      }
    }
    wanted.sort((a, b) => a.level - b.level || b.tile.scale - a.tile.scale);
    let points = 0;
    return wanted.filter(({ key, tile, level }) => {
      const count = this.chunks.get(key)?.count ?? this.guess(tile, level);
      if (points + count > this.mostPoints) return false;
      points += count;
      return true;
    });
  }

  // Points of a chunk that was not fetched yet: by the area of its cells, at most what is left.
  guess(tile, level) {
    const [west, south, , east, north] = tile.box;
    const cell = this.about.cells_m[level];
    let left = tile.points;
    for (let coarser = 0; coarser < level; coarser++) left -= this.chunks.get(`${tile.number}/${coarser}`)?.count ?? 0;
    return cell > 0 ? Math.min(left, 1 + (2 * (east - west) * (north - south)) / cell ** 2) : left;
  }

  fetch() {
    if (this.outdated) return; // its tiles are others by now
    const keys = new Set(this.wanted.map(({ key }) => key));
    for (const [key, abort] of this.fetching) if (!keys.has(key)) abort.abort();
    for (const { key, tile } of this.wanted) {
      if (this.fetching.size >= FETCHES) return;
      if (!this.chunks.has(key) && !this.fetching.has(key)) this.load(key, tile);
    }
  }

  async load(key, tile) {
    const abort = new AbortController();
    this.fetching.set(key, abort);
    try {
      const bytes = await getBytes(siteUrl(this.stem, `cloud/${key}?version=${this.about.version}`), { signal: abort.signal });
      if (this.closed) return;
      const count = bytes.byteLength / this.about.bytes_per_point;
      const points = count ? chunkPoints(bytes, tile.box, this.material) : null;
      if (points) { points.visible = false; this.scene.add(points); }
      this.chunks.set(key, { points, count, used: performance.now() });
      this.loaded += count;
      this.forget();
      this.onload();
    } catch (error) {
      if (error.name !== "AbortError") {
        this.chunks.set(key, { points: null, count: 0, used: 0 });
        if (!this.outdated) this.onerror?.(error);
        this.outdated ||= error.status === 409;
      }
    } finally {
      this.fetching.delete(key);
      if (!this.closed) this.fetch();
    }
  }

  // Give back the memory of what was not drawn for longest.
  forget() {
    if (this.loaded <= 1.6 * this.mostPoints) return;
    const keys = new Set(this.wanted.map(({ key }) => key));
    const old = [...this.chunks].filter(([key, { points }]) => points && !keys.has(key)).sort((a, b) => a[1].used - b[1].used);
    for (const [key, { points, count }] of old) {
      if (this.loaded <= this.mostPoints) return;
      this.scene.remove(points);
      points.geometry.dispose();
      this.chunks.delete(key);
      this.loaded -= count;
    }
  }

  get complete() {
    return this.wanted !== undefined && this.wanted.every(({ key }) => this.chunks.has(key));
  }

  close() {
    this.closed = true;
    for (const abort of this.fetching.values()) abort.abort();
    for (const { points } of this.chunks.values()) points?.geometry.dispose();
  }
}
