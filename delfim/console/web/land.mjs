// The world's land for the page's base map, out of Natural Earth's 1:10m coastline (public domain; the package world-atlas).
// Bytes: polygon after polygon, clipped to cells so that a view draws only what it shows; each is the number of its rings, and
// each ring the number of its points and their steps east and north from the point before, in STEP_DEG. Numbers are varints
// with the sign in the lowest bit.

const STEPS = 500; // of a degree: 200 m
const CELL = 5 * STEPS;
const OVERLAP = 100; // of cells, so that no sea shines through between them on a map of the world
const BEND_DEG = 0.0025; // a point that is less far from the line between its neighbours goes
const NORTHMOST = 85 * STEPS; // of the map
const AROUND = 360 * STEPS;

/** The rings of each polygon of a TopoJSON, [longitude, latitude] in degrees. */
function polygons({ arcs, objects, transform: { scale, translate } }) {
  const lines = arcs.map((arc) => {
    let [x, y] = [0, 0];
    return arc.map(([dx, dy]) => [(x += dx) * scale[0] + translate[0], (y += dy) * scale[1] + translate[1]]);
  });
  const ring = (parts) => parts.flatMap((i) => (i < 0 ? lines[~i].toReversed() : lines[i]).slice(1));
  return objects.land.geometries.flatMap((each) => (each.type === "Polygon" ? [each.arcs] : each.arcs)).map((each) => unwrapped(each.map(ring)));
}

/** Rings that cross 180° go on beyond it, one around the pole goes by way of the pole, and a hole is where its ring is. */
function unwrapped(rings) {
  const whole = rings.map((ring) => {
    let turns = 0;
    const points = ring.map(([x, y], i) => {
      const by = i ? x - ring[i - 1][0] : 0;
      turns += by > 180 ? -1 : by < -180 ? 1 : 0;
      return [x + 360 * turns, y];
    });
    const [first, last] = [points[0], points.at(-1)];
    return Math.abs(first[0] - last[0]) < 180 ? points : [...points, [first[0] + 360 * Math.sign(last[0] - first[0]), first[1]], [last[0], -90], [first[0], -90]];
  });
  const middle = (ring) => ring.reduce((sum, [x]) => sum + x, 0) / ring.length;
  const [east, west] = whole[0].reduce(([most, least], [x]) => [Math.max(most, x), Math.min(least, x)], [-Infinity, Infinity]);
  return whole.map((ring) => {
    const back = middle(ring) > east ? -360 : middle(ring) < west ? 360 : 0;
    return ring.map(([x, y]) => [x + back, y]);
  });
}

/** Douglas and Peucker's. */
function simplified(points) {
  const narrow = Math.cos((points[0][1] * Math.PI) / 180);
  const off = ([x, y], [ax, ay], [bx, by]) => {
    const [dx, dy, px, py] = [(bx - ax) * narrow, by - ay, (x - ax) * narrow, y - ay];
    const along = Math.max(0, Math.min(1, (px * dx + py * dy) / (dx * dx + dy * dy || 1)));
    return Math.hypot(px - along * dx, py - along * dy);
  };
  const keep = new Set([0, points.length - 1]);
  const stack = [[0, points.length - 1]];
  while (stack.length) {
    const [from, to] = stack.pop();
    let [worst, most] = [0, BEND_DEG];
    for (let i = from + 1; i < to; i++) {
      const far = off(points[i], points[from], points[to]);
      if (far > most) [worst, most] = [i, far];
    }
    if (worst) {
      keep.add(worst);
      stack.push([from, worst], [worst, to]);
    }
  }
  return points.filter((_, i) => keep.has(i));
}

/** The part of a ring on one side of a line of constant x (axis 0) or y (axis 1). Sutherland and Hodgman's. */
function side(ring, axis, at, sign) {
  const within = (point) => (point[axis] - at) * sign >= 0;
  const cut = [];
  let before = ring.at(-1);
  for (const point of ring) {
    if (within(point) !== within(before)) {
      const part = (at - before[axis]) / (point[axis] - before[axis]);
      const across = Math.round(before[1 - axis] + part * (point[1 - axis] - before[1 - axis]));
      cut.push(axis ? [across, at] : [at, across]);
    }
    if (within(point)) cut.push(point);
    before = point;
  }
  return cut;
}

/** The rings in strips along an axis. */
function* strips(rings, axis) {
  const values = rings[0].map((point) => point[axis]);
  const last = values.reduce((a, b) => Math.max(a, b));
  let [from, rest] = [Math.floor(values.reduce((a, b) => Math.min(a, b)) / CELL) * CELL, rings];
  for (; from <= last; from += CELL) {
    const cut = rest.map((ring) => side(ring, axis, from + CELL + OVERLAP, -1)).filter((ring) => ring.length > 2);
    if (cut.length) yield cut;
    rest = rest.map((ring) => side(ring, axis, from + CELL - OVERLAP, 1)).filter((ring) => ring.length > 2);
  }
}

function* cells(rings) {
  const north = rings.map((ring) => side(ring, 1, -NORTHMOST, 1)).filter((ring) => ring.length > 2);
  for (const strip of north.length ? strips(north, 0) : []) {
    const [east, west] = strip[0].reduce(([most, least], [x]) => [Math.max(most, x), Math.min(least, x)], [-Infinity, Infinity]);
    const back = (east + west > AROUND ? -AROUND : 0) + (east + west < -AROUND ? AROUND : 0);
    yield* strips(strip.map((ring) => ring.map(([x, y]) => [x + back, y])), 1);
  }
}

export function land(topology) {
  const bytes = [];
  const put = (value) => {
    let left = value < 0 ? -2 * value - 1 : 2 * value;
    for (; left > 127; left = Math.floor(left / 128)) bytes.push((left % 128) + 128);
    bytes.push(left);
  };
  let [x, y] = [0, 0];
  for (const polygon of polygons(topology)) {
    const rings = polygon
      .map((ring) => simplified(ring).map(([lon, lat]) => [Math.round(lon * STEPS), Math.round(lat * STEPS)]))
      .map((ring) => ring.filter((point, i) => point[0] !== ring.at(i - 1)[0] || point[1] !== ring.at(i - 1)[1]))
      .filter((ring) => ring.length > 2);
    for (const cell of rings.length ? cells(rings) : []) {
      put(cell.length);
      for (const ring of cell) {
        put(ring.length);
        for (const point of ring) {
          put(point[0] - x);
          put(point[1] - y);
          [x, y] = point;
        }
      }
    }
  }
  return Uint8Array.from(bytes);
}
