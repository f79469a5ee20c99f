// A picture with what is drawn over it: zoom, shift, clicks, and a cross that the keyboard moves.

import { el, redrawer, sharp } from "./common.js";

const STILL_PX = 4;

export class Stage {
  /** paint(context, px): draws in pixels of the picture, px is the width of one on the screen. */
  constructor(label, { paint, click, grab }) {
    this.canvas = el("canvas", { tabIndex: 0, role: "img", "aria-label": label });
    this.element = el("div", { class: "stage" }, this.canvas);
    Object.assign(this, { paint, click, grab, picture: null, size: [4, 3], zoom: 1, middle: null, cross: null });
    this.redraw = redrawer(() => this.draw(), this.element);
    this.listen();
  }

  show(picture, size) {
    this.picture?.close?.();
    this.picture = picture;
    if (size[0] !== this.size[0] || size[1] !== this.size[1]) {
      this.size = size;
      this.reset();
    }
    this.redraw();
  }

  reset() {
    [this.zoom, this.middle, this.cross] = [1, null, null];
    this.redraw();
  }

  /** Scale and shift from the picture's pixels to the screen's. */
  place() {
    const { clientWidth: w, clientHeight: h } = this.canvas;
    const scale = Math.min(w / this.size[0], h / this.size[1]) * this.zoom || 1;
    const [mx, my] = this.middle ?? [this.size[0] / 2 - 0.5, this.size[1] / 2 - 0.5];
    return { scale, left: w / 2 - (mx + 0.5) * scale, top: h / 2 - (my + 0.5) * scale };
  }

  pixel(event) {
    const box = this.canvas.getBoundingClientRect();
    const { scale, left, top } = this.place();
    return [(event.clientX - box.left - left) / scale - 0.5, (event.clientY - box.top - top) / scale - 0.5];
  }

  zoomAt([x, y], factor) {
    const before = this.place();
    this.zoom = Math.min(40, Math.max(1, this.zoom * factor));
    const [mx, my] = this.middle ?? [this.size[0] / 2 - 0.5, this.size[1] / 2 - 0.5];
    const share = 1 - before.scale / this.place().scale;
    this.middle = this.zoom === 1 ? null : [mx + (x - mx) * share, my + (y - my) * share];
    this.redraw();
  }

  draw() {
    const { context, width, height } = sharp(this.canvas);
    // A finger scrolls the page, unless there is something to move here.
    this.canvas.style.touchAction = this.zoom > 1 || this.grab ? "none" : "pan-y";
    context.fillStyle = "#101316";
    context.fillRect(0, 0, width, height);
    const { scale, left, top } = this.place();
    context.save();
    context.translate(left, top);
    context.scale(scale, scale);
    if (this.picture) {
      context.imageSmoothingEnabled = scale < 2;
      context.drawImage(this.picture, 0, 0, this.size[0], this.size[1]);
    }
    // Pixel (0, 0) is the middle of the first one.
    context.translate(0.5, 0.5);
    this.paint(context, 1 / scale);
    if (this.cross) {
      const [x, y] = this.cross;
      for (const [colour, wide] of [
        ["#000", 4],
        ["#fff", 2],
      ]) {
        context.strokeStyle = colour;
        context.lineWidth = wide / scale;
        context.beginPath();
        for (const [dx, dy] of [
          [1, 0],
          [-1, 0],
          [0, 1],
          [0, -1],
        ]) {
          context.moveTo(x + (dx * 4) / scale, y + (dy * 4) / scale);
          context.lineTo(x + (dx * 14) / scale, y + (dy * 14) / scale);
        }
        context.stroke();
      }
    }
    context.restore();
  }

  listen() {
    const { canvas } = this;
    let held = null;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      const at = this.pixel(event);
      const drag = this.grab?.(at, 9 / this.place().scale) ?? null;
      held = {
        x: event.clientX,
        y: event.clientY,
        middle: this.middle ?? [this.size[0] / 2 - 0.5, this.size[1] / 2 - 0.5],
        drag,
        moved: false,
      };
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!held) return;
      const [dx, dy] = [event.clientX - held.x, event.clientY - held.y];
      held.moved ||= Math.hypot(dx, dy) > STILL_PX;
      if (!held.moved) return;
      if (held.drag) {
        held.drag(this.pixel(event));
      } else if (this.zoom > 1) {
        const { scale } = this.place();
        this.middle = [held.middle[0] - dx / scale, held.middle[1] - dy / scale];
      }
      this.redraw();
    });
    canvas.addEventListener("pointerup", (event) => {
      if (held && !held.moved && !held.drag) {
        this.cross = null;
        this.click?.(this.pixel(event));
      }
      held = null;
    });
    canvas.addEventListener("pointercancel", () => (held = null));
    canvas.addEventListener("dblclick", () => this.click || this.reset());
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.zoomAt(this.pixel(event), Math.exp(-event.deltaY * 0.0015));
      },
      { passive: false },
    );
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  key(event) {
    const ways = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const middle = this.cross ?? this.middle ?? [Math.round(this.size[0] / 2), Math.round(this.size[1] / 2)];
    if (event.shiftKey && ways[event.key]) {
      const step = event.ctrlKey || event.altKey ? 20 : 1;
      const [dx, dy] = ways[event.key];
      const inside = (v, size) => Math.min(size - 1, Math.max(0, Math.round(v)));
      this.cross = [inside(middle[0] + dx * step, this.size[0]), inside(middle[1] + dy * step, this.size[1])];
      if (this.zoom > 1) this.middle = [...this.cross];
    } else if (event.key === "Enter" && this.cross && this.click) {
      this.click(this.cross);
    } else if (event.key === "+" || event.key === "=") {
      this.zoomAt(middle, 1.5);
    } else if (event.key === "-") {
      this.zoomAt(middle, 1 / 1.5);
    } else if (event.key === "0") {
      this.reset();
    } else {
      return;
    }
    event.preventDefault();
    event.stopPropagation();
    this.redraw();
  }
}

/** A closed line. */
export function outline(context, points, colour, width, dash = []) {
  if (!points?.length) return;
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.setLineDash(dash);
  context.beginPath();
  points.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
  context.closePath();
  context.stroke();
  context.setLineDash([]);
}

/** Text with a rim, readable on anything; never below 12 px on the screen. */
export function label(context, text, [x, y], colour, px) {
  context.font = `600 ${13 * px}px system-ui, sans-serif`;
  context.lineWidth = 3.5 * px;
  context.strokeStyle = "rgba(0,0,0,.8)";
  context.lineJoin = "round";
  context.strokeText(text, x, y);
  context.fillStyle = colour;
  context.fillText(text, x, y);
}
