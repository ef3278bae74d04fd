// The scene as Python packed it: JSON beside a deflated block of arrays.

const ARRAY_TYPES = { f4: Float32Array, u4: Uint32Array, u1: Uint8Array, u2: Uint16Array, i2: Int16Array, i1: Int8Array };

async function readScene() {
  const scene = JSON.parse(document.getElementById("scene").textContent);
  const holder = document.getElementById("payload");
  const text = atob(holder.textContent);
  holder.remove();
  const packed = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) packed[i] = text.charCodeAt(i);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const buffer = await new Response(stream).arrayBuffer();
  for (const [name, [type, offset, length]] of Object.entries(scene.arrays)) {
    scene[name] = new ARRAY_TYPES[type](buffer, offset, length);
  }
  scene.count = scene.source.count + scene.target.count;
  scene.density = (i) => scene.densest * (scene.densities[i] / 255) ** 2;
  return scene;
}

// The Lagrange polynomials of the knots at t: a position at t is the weighted sum of the
// positions at the knots, and the weights are the same for all splats.
function knotWeights(knots, t) {
  return knots.map((here, j) =>
    knots.reduce((product, there, m) => (m === j ? product : product * (t - there) / (here - there)), 1));
}

// Every splat is stored at its own end and as moves from there; the knot of that end carries none.
function moveWeights(scene, t) {
  const weights = knotWeights(scene.knots, t);
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

function stackExponent(weight, density) {
  return density > 0 ? -Math.log(1 - weight * (1 - Math.exp(-density))) / density : weight;
}
