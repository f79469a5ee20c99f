// Curves over time on one canvas: many points, gaps where nothing was measured, a cursor that steps from frame to
// frame.

import { css, el, fixed, redrawer, sharp } from "./common.js";

const LEFT = 54;
const BOTTOM = 20;
const TOP = 20;
const RIGHT = 8;
// Seconds: some frames of a fast camera.
const NEAREST_S = 0.05;

/** A round number near a tenth, a fifth or a half of a power of ten. */
function step(range, count) {
  const rough = range / Math.max(1, count);
  const power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((n) => n * power).find((n) => n >= rough) ?? 10 * power;
}

const digits = (value, by) => fixed(value, Math.max(0, Math.min(6, -Math.floor(Math.log10(by) + 1e-9))));

/** Bars where frames were lost: from the one before to the one after. */
export const lostBars = (x, gap) =>
  x.flatMap((x1, i) => (gap[i] > 0 ? [{ x0: x[i - 1] ?? x1, x1, colour: "--gap" }] : []));

export class Plot {
  /**
   * lines: [{ x: [], y: [], sd?: [], lost?: [], colour, name, dash? }], where frames are lost before a point the line
   * is broken; marks: [{ x: [], colour, shape }] at the lower edge; bars: [{ x0, x1, colour }] behind the lines; each
   * colour by its name on the page; shared: { from, to, cursor, whole? } in seconds, which several plots have in common.
   */
  constructor(label, unit, shared, picked) {
    this.canvas = el("canvas", { tabIndex: 0, role: "img", "aria-label": label });
    this.element = el("div", { class: "plot" }, this.canvas);
    Object.assign(this, { label, unit, shared, picked, lines: [], marks: [], bars: [] });
    shared.plots ??= [];
    shared.plots.push(this);
    this.redraw = redrawer(() => this.draw(), this.element);
    this.listen();
  }

  set(lines, marks = [], bars = []) {
    Object.assign(this, { lines, marks, bars });
    this.redraw();
  }

  range() {
    let [low, high] = [Infinity, -Infinity];
    const { from, to } = this.shared;
    for (const { x, y, sd } of this.lines) {
      for (let i = 0; i < x.length; i += 1) {
        if (y[i] === null || x[i] < from || x[i] > to) continue;
        const off = Math.min(sd?.[i] ?? 0, 20);
        low = Math.min(low, y[i] - off);
        high = Math.max(high, y[i] + off);
      }
    }
    if (!(low <= high)) return null;
    const margin = (high - low) * 0.06 || Math.abs(high) * 0.1 || 0.5;
    return [low - margin, high + margin];
  }

  draw() {
    const { context, width, height } = sharp(this.canvas);
    const { from, to, cursor } = this.shared;
    const range = this.range();
    const [low, high] = range ?? [0, 1];
    const [w, h] = [width - LEFT - RIGHT, height - TOP - BOTTOM];
    if (w < 20 || h < 20 || !(to > from)) return;
    const px = (t) => LEFT + ((t - from) / (to - from)) * w;
    const py = (v) => TOP + h - ((v - low) / (high - low)) * h;
    Object.assign(this, { px });
    context.fillStyle = css("--ground");
    context.fillRect(0, 0, width, height);
    context.font = "12px system-ui, sans-serif";
    context.lineWidth = 1;
    context.strokeStyle = css("--line");
    context.fillStyle = css("--quiet");
    context.textAlign = "right";
    const count = Math.max(2, h / 32);
    const labels = (by) => Math.floor(high / by) - Math.ceil(low / by) + 1;
    const wide = step(high - low, count);
    // One number is no scale.
    const by = labels(wide) > 1 ? wide : step(high - low, 2 * count);
    for (let v = Math.ceil(low / by) * by; range && v <= high; v += by) {
      context.globalAlpha = 0.5;
      context.beginPath();
      context.moveTo(LEFT, py(v));
      context.lineTo(LEFT + w, py(v));
      context.stroke();
      context.globalAlpha = 1;
      context.fillText(digits(v, by), LEFT - 6, py(v) + 4);
    }
    const along = step(to - from, w / 90);
    context.textAlign = "center";
    for (let t = Math.ceil(from / along) * along; t <= to; t += along)
      if (px(t) < width - 22) context.fillText(`${digits(t, along)} s`, px(t), height - 5);
    context.textAlign = "left";
    context.save();
    context.beginPath();
    context.rect(LEFT, 0, w, height - BOTTOM + 1);
    context.clip();
    for (const { x0, x1, colour } of this.bars) {
      context.fillStyle = css(colour);
      context.globalAlpha = 0.25;
      context.fillRect(px(x0) - 1, TOP, Math.max(2, px(x1) - px(x0)), h);
      context.globalAlpha = 1;
    }
    this.lines.forEach((line) => this.line(context, line, px, py));
    for (const { x, colour, shape } of this.marks) {
      context.fillStyle = css(colour);
      context.strokeStyle = context.fillStyle;
      for (const t of x) {
        if (t < from || t > to) continue;
        const at = px(t);
        context.beginPath();
        if (shape === "cross") {
          context.lineWidth = 2;
          context.moveTo(at - 4, TOP + 4);
          context.lineTo(at + 4, TOP + 12);
          context.moveTo(at + 4, TOP + 4);
          context.lineTo(at - 4, TOP + 12);
          context.stroke();
        } else {
          context.fillRect(at - 1.2, TOP + h - 9, 2.4, 9);
        }
      }
    }
    if (cursor !== null && cursor !== undefined) {
      context.strokeStyle = css("--accent");
      context.lineWidth = 1.5;
      context.beginPath();
      context.moveTo(px(cursor), TOP);
      context.lineTo(px(cursor), TOP + h);
      context.stroke();
    }
    context.restore();
    context.fillStyle = css("--ink");
    context.fillText(this.unit, LEFT, TOP - 6);
    if (!range && this.lines.length) {
      context.fillStyle = css("--quiet");
      context.textAlign = "center";
      context.fillText("nothing was measured here", LEFT + w / 2, TOP + h / 2);
    }
  }

  line(context, line, px, py) {
    const { dash } = line;
    const colour = css(line.colour);
    const pieces = this.pieces(line, px);
    if (line.sd) {
      context.fillStyle = colour;
      context.globalAlpha = 0.28;
      for (const piece of pieces) {
        context.beginPath();
        piece.forEach(([t, low, high, sd], k) => context[k ? "lineTo" : "moveTo"](t, py(high + sd)));
        for (const [t, low, , sd] of [...piece].reverse()) context.lineTo(t, py(low - sd));
        context.fill();
      }
      context.globalAlpha = 1;
    }
    context.strokeStyle = colour;
    context.lineWidth = 1.4;
    context.setLineDash(dash ?? []);
    context.beginPath();
    for (const piece of pieces) {
      const [[first, low]] = piece;
      context.moveTo(first - (piece.length > 1 ? 0 : 1), py(low));
      for (const [t, least, most, , rises] of piece) {
        context.lineTo(t, py(rises ? least : most));
        if (least !== most) context.lineTo(t, py(rises ? most : least));
      }
      if (piece.length === 1) context.lineTo(first + 1, py(low));
    }
    context.stroke();
    context.setLineDash([]);
  }

  /** What was measured without a gap: on the screen from left to right, least and most of what falls on one pixel,
   * its σ. */
  pieces({ x, y, sd, lost }, px) {
    const { from, to } = this.shared;
    const pieces = [];
    let piece = null;
    for (let i = 0; i < x.length; i += 1) {
      // One point beyond either end: the curve goes on.
      if ((x[i + 1] ?? Infinity) < from || (x[i - 1] ?? -Infinity) > to) continue;
      if (y[i] === null) {
        piece = null;
        continue;
      }
      if (lost?.[i]) piece = null;
      const t = Math.round(px(x[i]) * 2) / 2;
      const last = piece?.at(-1);
      if (last && last[0] === t) {
        last[1] = Math.min(last[1], y[i]);
        last[2] = Math.max(last[2], y[i]);
        last[3] = Math.max(last[3], sd?.[i] ?? 0);
        last[4] = y[i] === last[2];
      } else if (piece) {
        piece.push([t, y[i], y[i], sd?.[i] ?? 0, true]);
      } else {
        piece = [[t, y[i], y[i], sd?.[i] ?? 0, true]];
        pieces.push(piece);
      }
    }
    return pieces;
  }

  all() {
    this.shared.plots.forEach((plot) => plot.redraw());
  }

  time(event) {
    const box = this.canvas.getBoundingClientRect();
    const { from, to } = this.shared;
    return from + ((event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT)) * (to - from);
  }

  listen() {
    const { canvas, shared } = this;
    let held = null;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      held = { x: event.clientX, y: event.clientY, from: shared.from, to: shared.to, moved: false };
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!held || !this.picked) return;
      held.moved ||= Math.hypot(event.clientX - held.x, event.clientY - held.y) > 4;
      if (!held.moved) return;
      const shift = ((event.clientX - held.x) / (canvas.clientWidth - LEFT - RIGHT)) * (held.to - held.from);
      const [first, last] = shared.whole ?? [-Infinity, Infinity];
      const from = Math.max(first, Math.min(last - (held.to - held.from), held.from - shift));
      [shared.from, shared.to] = [from, from + held.to - held.from];
      this.all();
    });
    // The page is scrolled by touch.
    canvas.addEventListener("pointercancel", () => (held = null));
    canvas.addEventListener("pointerup", (event) => {
      if (held && !held.moved) this.picked?.(this.time(event));
      held = null;
    });
    canvas.addEventListener(
      "wheel",
      (event) => {
        if (!this.picked) return;
        event.preventDefault();
        this.zoom(this.time(event), Math.exp(event.deltaY * 0.0015));
      },
      { passive: false },
    );
    canvas.addEventListener("dblclick", () => this.whole());
    canvas.addEventListener("keydown", (event) => {
      if (!this.picked) return;
      const middle = shared.cursor ?? (shared.from + shared.to) / 2;
      if (event.key === "+" || event.key === "=") this.zoom(middle, 1 / 1.5);
      else if (event.key === "-") this.zoom(middle, 1.5);
      else if (event.key === "0") this.whole();
      else return;
      event.preventDefault();
    });
  }

  zoom(at, factor) {
    const { shared } = this;
    if (factor < 1 && shared.to - shared.from < NEAREST_S) return;
    [shared.from, shared.to] = [at - (at - shared.from) * factor, at + (shared.to - at) * factor];
    const [first, last] = shared.whole ?? [-Infinity, Infinity];
    [shared.from, shared.to] = [Math.max(first, shared.from), Math.min(last, shared.to)];
    this.all();
  }

  whole() {
    if (this.shared.whole) [this.shared.from, this.shared.to] = this.shared.whole;
    this.all();
  }
}
