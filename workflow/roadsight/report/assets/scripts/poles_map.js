// The map of the poles job. What it draws is in poles_layers.js.

class PolesMap extends PlanCanvas {
  constructor(canvas, site, state, tooltip) {
    super(canvas, site, state, tooltip);
    this.layers = { raster: true, lidar: true, cameras: true, rays: true, dropped: false, poles: true, rated: false };
    this.kinds = null;
    this.recolour();
    if (site.raster) this.loadRaster(site.raster);
  }

  loadRaster({ png, rows, columns }) {
    const image = new Image();
    image.addEventListener("load", () => {
      this.kinds = rasterKinds(image, rows, columns);
      this.recolour();
    });
    image.src = `data:image/png;base64,${png}`;
  }

  recolour() {
    super.recolour();
    if (this.kinds) this.rasterImage = colouredRaster(this.kinds, this.site.raster, this.colour);
  }

  paint() {
    drawPolesMap(this);
  }

  pick(px, py) {
    const { poles, cameras } = this.site;
    const pole = this.layers.poles ? this.nearest(px, py, poles.length, (i) => [poles[i].x, poles[i].y]) : -1;
    if (pole >= 0) return { chosen: true, pole, text: poleText(this.site, pole) };
    const at = (i) => [cameras.xy[2 * i], cameras.xy[2 * i + 1]];
    const camera = this.layers.cameras ? this.nearest(px, py, cameras.state.length, at) : -1;
    if (camera >= 0) return { chosen: cameras.shown[camera] >= 0, camera, text: cameraText(cameras, camera) };
    return null;
  }

  get chosenPlace() {
    const pole = this.site.poles[this.state.pole];
    return pole ? [pole.x, pole.y] : null;
  }

  choose(found) {
    if (found?.camera !== undefined) this.state.showImage(this.site.cameras.shown[found.camera]);
    else this.state.choosePole(found === null || this.state.pole === found.pole ? null : found.pole, false);
  }
}

const STATE_TEXTS = ["aligned", "rejected", "not used"];

function cameraText(cameras, i) {
  const state = STATE_TEXTS[cameras.state[i]];
  const reason = cameras.reasons[cameras.reason[i]];
  const residual = cameras.residual[i] >= 0 ? `\nresidual ${formatNumber(cameras.residual[i], 1)} px` : "";
  const click = cameras.shown[i] >= 0 ? "\nclick to see it" : "";
  return `Image ${cameras.images[i]}: ${state}${reason ? `\n${reason}` : ""}${residual}${click}`;
}

function poleText(site, i) {
  const pole = site.poles[i];
  const lines = [`${pole.kind[0].toUpperCase()}${pole.kind.slice(1)} ${pole.id}, seen in ${counted(pole.images, "image")}`];
  if (pole.sigma_major_m !== null) lines.push(`sigma ${formatNumber(pole.sigma_major_m, 2)} m by ${formatNumber(pole.sigma_minor_m ?? 0, 2)} m`);
  const error = site.errorOf.get(pole.id);
  if (error?.geodesic_m !== undefined && error.geodesic_m !== null) lines.push(`${formatNumber(error.geodesic_m, 2)} m from the known pole`);
  const rating = site.hazardOf.get(pole.id)?.rating;
  if (pole.decided) lines.push(`${pole.decided} by a person`);
  if (rating !== undefined && rating !== null) lines.push(`hazard: ${rating}`);
  return lines.join("\n");
}
