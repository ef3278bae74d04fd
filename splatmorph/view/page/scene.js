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

// Opacity at t of the 256 stored opacities: row 0 for the source's splats, row 1 for the target's.
function opacityRows(scene, ramp, part, t) {
  const rows = new Float32Array(512);
  const fade = { source: part === "morph" ? 1 - t : Number(part === "source"), target: part === "morph" ? t : Number(part === "target") };
  [fade.source, fade.target].forEach((weight, side) => {
    const steps = scene.rampSteps - 1;
    const at = weight * steps;
    const low = Math.min(Math.floor(at), steps - 1);
    const start = ramp * scene.rampSteps * 256 + low * 256;
    for (let a = 0; a < 256; a++) {
      const first = scene.ramps[start + a];
      rows[side * 256 + a] = (first + (at - low) * (scene.ramps[start + 256 + a] - first)) / 65535;
    }
  });
  return rows;
}
