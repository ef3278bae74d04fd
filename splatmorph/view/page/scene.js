// The scene as Python packed it: JSON beside a deflated block of arrays.

const ARRAY_TYPES = { f4: Float32Array, u4: Uint32Array, u2: Uint16Array, i2: Int16Array, i1: Int8Array };

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

// Opacity at t of the 256 stored opacities, and the factor on the scale that goes with it:
// row 0 for the source's splats, row 1 for the target's.
function fadeRows(scene, ramp, part, t) {
  const rows = new Float32Array(1024);
  const weights = part === "morph" ? [1 - t, t] : [Number(part === "source"), Number(part === "target")];
  weights.forEach((weight, side) => {
    const at = weight * (scene.rampSteps - 1);
    const low = Math.min(Math.floor(at), scene.rampSteps - 2);
    const start = (ramp * scene.rampSteps + low) * 256;
    const between = (table, a) => table[start + a] + (at - low) * (table[start + 256 + a] - table[start + a]);
    for (let a = 0; a < 256; a++) {
      rows[2 * (side * 256 + a)] = between(scene.fades, a) / 65535;
      rows[2 * (side * 256 + a) + 1] = Math.exp(between(scene.growths, a) * scene.growthStep);
    }
  });
  return rows;
}
