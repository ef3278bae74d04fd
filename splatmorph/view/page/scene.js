// The scene as Python packed it: JSON beside a deflated block of tables.

const ARRAY_TYPES = { f4: Uint32Array, u4: Uint32Array, u2: Uint16Array, u1: Uint8Array, i2: Int16Array, i1: Int8Array };

// Undoes Table.folded: columns of differences, the low bytes of a column before its high bytes.
function unfolded(bytes, at, [type, rows, columns, delta, stride, times]) {
  const values = new ARRAY_TYPES[type](rows * columns);
  const width = values.BYTES_PER_ELEMENT;
  for (let column = 0; column < columns; column++, at += rows * width) {
    let last = 0;
    for (let row = 0; row < rows; row++) {
      let value = 0;
      for (let plane = 0; plane < width; plane++) value |= bytes[at + plane * rows + row] << (8 * plane);
      last = delta ? (last + value) | 0 : value;
      values[row * columns + column] = last;
    }
  }
  for (let time = 0; time < times; time++) {
    for (let start = 0; start < values.length; start += columns) {
      for (let i = start + stride; i < start + columns; i++) values[i] += values[i - stride];
    }
  }
  return type === "f4" ? new Float32Array(values.buffer) : values;
}

async function inflated(text, size, progress) {
  const binary = atob(text);
  const packed = Uint8Array.from({ length: binary.length }, (_, i) => binary.charCodeAt(i));
  const reader = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate")).getReader();
  const block = new Uint8Array(size);
  for (let at = 0; ;) {
    const { done, value } = await reader.read();
    if (done) return block;
    block.set(value, at);
    progress((at += value.length) / size);
  }
}

async function readScene(progress) {
  const scene = JSON.parse(document.getElementById("scene").textContent);
  const holder = document.getElementById("payload");
  const text = holder.textContent;
  holder.remove();
  return unpacked(scene, text, progress);
}

async function unpacked(scene, text, progress) {
  const sizeOf = ([type, rows, columns]) => rows * columns * ARRAY_TYPES[type].BYTES_PER_ELEMENT;
  const tables = Object.entries(scene.tables);
  const block = await inflated(text, tables.reduce((sum, [, facts]) => sum + sizeOf(facts), 0), progress);
  let at = 0;
  for (const [name, facts] of tables) {
    scene[name] = unfolded(block, at, facts);
    at += sizeOf(facts);
  }
  return withLegs(scene);
}

// A leg is a window on the splats: those of its source, then those of its target. One splat alone
// is a leg that goes nowhere.
function withLegs(scene) {
  const counts = scene.splats.map((side) => side.count);
  scene.count = counts.reduce((sum, count) => sum + count, 0);
  scene.last = scene.legs.length;
  if (!scene.last) scene.legs = [{ knots: [], moveScale: [0, 0, 0], deformScale: 0, base: null, frame: null, landmarks: { names: [], source: [], target: [] } }];
  let first = 0;
  scene.legs.forEach((leg, i) => {
    const [source, target] = [counts[i], counts[i + 1] ?? 0];
    leg.base ??= [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]];
    Object.assign(leg, { index: i, first, sourceCount: source, count: source + target });
    for (const name of ["moves", "deforms", "others", "otherShades", "densities"]) leg[name] = scene[name + i] ?? new Uint8Array(0);
    first += source;
  });
  return scene;
}

function legAt(scene, t) {
  const index = Math.min(Math.floor(t), scene.legs.length - 1);
  return { leg: scene.legs[index], t: t - index };
}

// The Lagrange polynomials of the knots at t: a position at t is the weighted sum of the
// positions at the knots, and the weights are the same for all splats.
function knotWeights(knots, t) {
  return knots.map((here, j) =>
    knots.reduce((product, there, m) => (m === j ? product : product * (t - there) / (here - there)), 1));
}

// Every splat is stored at its own end and as moves from there; the knot of that end carries none.
function moveWeights(leg, t) {
  const weights = knotWeights(leg.knots, t);
  return { source: weights.slice(1), target: weights.slice(0, -1) };
}

// How much of each half there is, and how far it has gone to the other end.
function halvesAt(part, t) {
  const weights = part === "morph" ? [1 - t, t] : [Number(part === "source"), Number(part === "target")];
  return { weights, gone: [t, 1 - t] };
}

// What a ramp makes of the 256 stored opacities at each weight, a row a weight: opacity, growth.
function rampRows(scene, ramp) {
  const size = scene.rampSteps * 256;
  const rows = new Float32Array(2 * size);
  for (let i = 0; i < size; i++) {
    rows[2 * i] = scene.fades[ramp * size + i] / 65535;
    rows[2 * i + 1] = scene.growths[ramp * size + i] * scene.growthStep;
  }
  return rows;
}

// Weights of the halves by lead, a row a half: as `exponents` of the agreement in Python.
function leadWeights(weights) {
  return weights.map((weight) => {
    const swing = (4 * weight * (1 - weight)) ** 2, odds = Math.log(weight / (1 - weight));
    return Float64Array.from({ length: 256 }, (_, lead) =>
      weight <= 0 || weight >= 1 ? weight : 1 / (1 + Math.exp(-odds - swing * Math.log(lead / (256 - lead)))));
  });
}

const densityOf = (scene, byte) => scene.densest * (byte / 255) ** 2;

function stackExponent(weight, density) {
  return density > 0 ? -Math.log(1 - weight * (1 - Math.exp(-density))) / density : weight;
}
