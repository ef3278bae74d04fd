// Landmarks, their paths and names, drawn over the splats.

const pointAt = (knots, weights) => [0, 1, 2].map((axis) => weights.reduce((sum, w, k) => sum + w * knots[k][axis], 0));

class LandmarkOverlay {
  constructor(canvas, tip, scene) {
    Object.assign(this, { canvas, tip, scene, points: [], numbered: false });
  }

  draw(world, ratio, { t, part, marks }) {
    const { canvas } = this;
    canvas.width = Math.round(world.width);
    canvas.height = Math.round(world.height);
    this.points = [];
    if (!marks) return this.point(null);
    const pen = canvas.getContext("2d");
    const style = getComputedStyle(document.body);
    const { leg, t: local } = legAt(this.scene, t);
    const view = movedView(world, leg.frame, local);
    const now = knotWeights(leg.knots, local);
    const stops = Array.from({ length: 17 }, (_, i) => knotWeights(leg.knots, i / 16));
    const sides = part === "morph" ? ["source", "target"] : [part];
    pen.font = `${10 * ratio}px sans-serif`;
    sides.forEach((side, layer) => {
      pen.strokeStyle = pen.fillStyle = style.getPropertyValue(`--${side}`);
      leg.landmarks[side].forEach((landmark, i) => {
        pen.globalAlpha = 0.45;
        pen.lineWidth = 1.1 * ratio;
        pen.beginPath();
        for (const weights of stops) pen.lineTo(...project(view, pointAt(landmark, weights)).slice(0, 2));
        pen.stroke();
        const [x, y, z] = project(view, pointAt(landmark, now));
        if (z <= 0) return;
        pen.globalAlpha = 1;
        pen.beginPath();
        // The target's on top, smaller: a landmark that is met shows as a dot with a rim.
        pen.arc(x, y, (layer ? 1.9 : 3.4) * ratio, 0, 2 * Math.PI);
        pen.fill();
        if (this.numbered && layer === sides.length - 1) pen.fillText(String(i + 1), x + 4 * ratio, y - 3 * ratio);
        this.points.push({ x: x / ratio, y: y / ratio, name: leg.landmarks.names[i] });
      });
    });
  }

  // The name of the landmark under the pointer, if any.
  point(pointer) {
    const near = pointer && this.points
      .map((p) => ({ ...p, far: Math.hypot(p.x - pointer.x, p.y - pointer.y) }))
      .filter((p) => p.far < pointer.reach).sort((a, b) => a.far - b.far)[0];
    this.tip.hidden = !near;
    if (near) {
      this.tip.textContent = near.name;
      this.tip.style.transform = `translate(${Math.min(near.x + 12, innerWidth - this.tip.offsetWidth - 8)}px, ${Math.max(near.y - 12, 0)}px)`;
    }
  }
}
