// The rig in space: camera, mirrors and walls where the views look through them, bands, their images, and the light.

import { css, el, onPage, redrawer, sharp } from "./common.js";

// As it is turned at first.
const TURN = [-0.5, 0.45];

export class Space {
  constructor() {
    this.canvas = el("canvas", {
      tabIndex: 0,
      role: "img",
      "aria-label":
        "The rig in space: camera, mirror, walls, tube and light. Arrow keys turn it, plus and minus change its size, 0 takes both back.",
    });
    this.element = el("div", { class: "space" }, this.canvas);
    Object.assign(this, { setUp: null, light: null, turn: TURN, zoom: 1 });
    this.redraw = redrawer(() => this.draw(), this.element);
    let held = null;
    this.canvas.addEventListener("pointerdown", (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      held = { x: event.clientX, y: event.clientY, turn: [...this.turn] };
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (!held) return;
      this.turn = [held.turn[0] + (event.clientX - held.x) * 0.008, held.turn[1] + (event.clientY - held.y) * 0.008];
      this.redraw();
    });
    this.canvas.addEventListener("pointerup", () => (held = null));
    this.canvas.addEventListener("pointercancel", () => (held = null));
    this.canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.grow(Math.exp(-event.deltaY * 0.0015));
      },
      { passive: false },
    );
    this.canvas.addEventListener("keydown", (event) => {
      const turns = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
      if (turns[event.key]) this.turn = this.turn.map((v, i) => v + turns[event.key][i]);
      else if (event.key === "+" || event.key === "=") this.grow(1.3);
      else if (event.key === "-") this.grow(1 / 1.3);
      else if (event.key === "0") Object.assign(this, { turn: TURN, zoom: 1 });
      else return;
      event.preventDefault();
      event.stopPropagation();
      this.redraw();
    });
  }

  grow(factor) {
    this.zoom = Math.min(30, Math.max(0.3, this.zoom * factor));
    this.redraw();
  }

  set(setUp, light) {
    Object.assign(this, { setUp, light });
    this.redraw();
  }

  draw() {
    const { context, width, height } = sharp(this.canvas);
    context.fillStyle = css("--panel");
    context.fillRect(0, 0, width, height);
    context.font = "12px system-ui, sans-serif";
    context.fillStyle = css("--quiet");
    if (!this.setUp) {
      context.fillText("no rig, no scene", 10, 20);
      return;
    }
    const places = (this.light?.places ?? []).filter(Boolean);
    const corners = this.setUp.surfaces.flatMap((surface) => surface.corners);
    const near = places.length ? places : corners;
    if (!near.length) return;
    const middle = [0, 1, 2].map((k) => near.reduce((sum, p) => sum + p[k], 0) / near.length);
    // Turned about the tube, and as large as what stands around it; the camera is far away, and light leads there.
    const [a, b] = this.turn;
    const [ca, sa, cb, sb] = [Math.cos(a), Math.sin(a), Math.cos(b), Math.sin(b)];
    const turned = (p) => {
      const [x, y, z] = p.map((v, k) => v - middle[k]);
      const [x1, z1] = [ca * x + sa * z, -sa * x + ca * z];
      return [x1, cb * y + sb * z1];
    };
    const ends = [...corners, ...places].map(turned);
    const [low, high] = [Math.min, Math.max].map((of) => [0, 1].map((k) => of(...ends.map((p) => p[k]))));
    const fit = Math.min((width - 40) / Math.max(1, high[0] - low[0]), (height - 60) / Math.max(1, high[1] - low[1]));
    const scale = fit * this.zoom;
    const about = this.zoom > 1.01 ? [0, 0] : [0, 1].map((k) => (low[k] + high[k]) / 2);
    const at = (p) => turned(p).map((v, k) => [width, height][k] / 2 + (v - about[k]) * scale);
    const path = (points, close = false) => {
      context.beginPath();
      points.forEach((p, i) => (i ? context.lineTo(...at(p)) : context.moveTo(...at(p))));
      if (close) context.closePath();
    };
    for (const surface of this.setUp.surfaces) {
      if (surface.corners.length < 3) continue;
      path(surface.corners, true);
      context.globalAlpha = surface.mirror ? 0.32 : 0.12;
      context.fillStyle = css(surface.mirror ? "--gap" : "--m3");
      context.fill();
      context.globalAlpha = 1;
      context.strokeStyle = css("--quiet");
      context.lineWidth = surface.mirror ? 2 : 1;
      context.stroke();
      context.fillStyle = css("--quiet");
      // At the corner that is farthest out, where the least is drawn.
      const out = (p) => Math.hypot(...turned(p).map((v, k) => v - (low[k] + high[k]) / 2));
      const [x, y] = at(surface.corners.reduce((p, q) => (out(p) > out(q) ? p : q)));
      context.textAlign = x > width / 2 ? "right" : "left";
      context.fillText(surface.name.replaceAll("_", " "), x, y < height / 2 ? y - 5 : y + 14);
      context.textAlign = "left";
    }
    for (const ray of this.light?.light ?? []) {
      path(ray.points);
      context.strokeStyle = css(onPage(ray.band));
      context.globalAlpha = 0.55;
      context.lineWidth = 1;
      context.stroke();
      context.globalAlpha = 1;
    }
    const tube = (points, alpha) => {
      const known = points.map((p, i) => [p, i]).filter(([p]) => p);
      if (!known.length) return;
      context.globalAlpha = alpha;
      path(known.map(([p]) => p));
      context.strokeStyle = css("--ink");
      context.lineWidth = Math.max(2, this.setUp.tube_mm * scale);
      context.lineCap = "round";
      context.stroke();
      for (const [p, i] of known) {
        context.fillStyle = css(onPage(i));
        context.beginPath();
        context.arc(...at(p), Math.max(4.5, this.setUp.tube_mm * scale * 0.9), 0, 7);
        context.fill();
        if (alpha === 1) {
          const [x, y] = at(p);
          context.fillStyle = css("--ink");
          context.fillText(this.setUp.bands[i]?.name ?? "", x + 10, y + 4);
        }
      }
      context.globalAlpha = 1;
    };
    for (const image of this.light?.images ?? []) tube(image.points, 0.3);
    tube(this.light?.places ?? [], 1);
    context.fillStyle = css("--quiet");
    context.fillText("towards the camera: along the light", 8, height - 8);
  }
}
