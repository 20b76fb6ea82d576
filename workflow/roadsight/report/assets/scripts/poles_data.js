// Content of a site's poles as typed arrays.

const STATES = { accepted: 0, rejected: 1, unused: 2 };

function readPoles(content) {
  const { layers } = content;
  const { cameras, sightings } = layers;
  const poles = {
    ...content,
    raster: layers.raster,
    edges: unpackPoints(layers.edges),
    cameras: {
      ...cameras,
      xy: unpack(cameras.xy),
      heading: unpack(cameras.heading_deg),
      state: unpack(cameras.state),
      residual: unpack(cameras.residual_px),
      reason: unpack(cameras.reason),
    },
    sightings: {
      rays: unpack(sightings.rays),
      camera: unpack(sightings.camera),
      pole: unpack(sightings.pole),
      kept: unpack(sightings.kept),
    },
    poles: layers.poles,
    images: content.images.map((image) => ({ ...image, lidar: unpack(image.lidar), edges: unpack(image.edges) })),
  };
  const { columns, rows } = content.hazard;
  const hazards = rows.map((row) => Object.fromEntries(row.map((value, i) => [columns[i], value])));
  poles.hazardOf = new Map(hazards.map((row) => [String(row.id ?? row.pole), row]));
  poles.errorOf = new Map(content.errors.map((row) => [String(row.pole), row]));
  poles.extent = polesExtent(poles);
  return poles;
}

// Box around cameras and poles, never empty.
function polesExtent({ cameras, poles, edges }) {
  const xs = [], ys = [];
  for (let i = 0; i < cameras.state.length; i++) {
    xs.push(cameras.xy[2 * i]);
    ys.push(cameras.xy[2 * i + 1]);
  }
  for (const { x, y } of poles) {
    xs.push(x);
    ys.push(y);
  }
  if (xs.length === 0) {
    xs.push(...edges.x);
    ys.push(...edges.y);
  }
  const least = (values) => values.reduce((a, b) => Math.min(a, b), Infinity);
  const most = (values) => values.reduce((a, b) => Math.max(a, b), -Infinity);
  if (xs.length === 0) return { west: 0, south: 0, east: 1, north: 1 };
  return { west: least(xs), south: least(ys), east: most(xs), north: most(ys) };
}
