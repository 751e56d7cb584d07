// The plan on its canvas: draws the scene when something has changed; zoom, pan and follow.

import { COLORS, FIXED, LAYERS, SLOW, arrow, boxOutline, drawTrailEnds, measured } from "./layers.js";

const MIN_SCALE = 4;
const MAX_SCALE = 600;
const CLICK_PX = 6;
const HEADING_PX = 12;
/** Where a key moves the aim, in steps to the right and up. */
const AIM_KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
const TURN_KEYS = { ",": 1, ".": -1 };
const AIM_STEP_M = 0.1;
const FINE_STEP_M = 0.02;
/** What is kept of the lower layers reaches so far beyond the canvas, in px: it may be moved. */
const MARGIN_PX = 120;
const TURN_STEP_RAD = Math.PI / 12;

/** A drawing of some layers: what it shows, and where. */
function kept() {
  const context = document.createElement("canvas").getContext("2d", { alpha: false });
  return { context, of: "", scale: 0, center: [0, 0] };
}

/** The canvas and its pointer. `onPick(pose, dragged)` is called when a tool has aimed. */
export class Plan {
  #scene;
  #context;
  #pointers = new Map();
  #aim = null;
  #pinch = null;
  #wanted = false;
  #drawnMs = 0;
  #looksElsewhere = false;
  /** The layers that change seldom, and those with the ones that change with each message. */
  #fixed = kept();
  #slow = kept();
  #look = { raised: "", font: "" };
  #widths = new Map();

  constructor(canvas, scene, onPick) {
    this.canvas = canvas;
    this.#scene = scene;
    this.#context = canvas.getContext("2d", { alpha: false });
    this.onPick = onPick;
    this.isAiming = false;
    this.hasHeading = true;
    this.waypoints = [];
    /** The waypoints that are driven to. */
    this.route = [];
    this.follows = false;
    this.onFollow = () => {};
    this.onAim = () => {};
    this.center = [0, 0];
    this.scale = 60;
    this.layers = Object.fromEntries(LAYERS.map(([key, , , shown]) => [key, shown]));
    /** Of each layer, from 0 to 1. */
    this.opacity = Object.fromEntries(LAYERS.map(([key]) => [key, 1]));
    /** Length and width, in m, of what is to be placed; null: it has no outline. */
    this.outline = null;
    /** One or two places between which is measured. */
    this.measured = [];
    /** The place under the pointer; null: it is elsewhere. */
    this.hover = null;
    this.onHover = () => {};
    new ResizeObserver(() => this.#resize()).observe(canvas);
    canvas.addEventListener("pointerdown", (event) => this.#down(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    canvas.addEventListener("pointerup", (event) => this.#up(event));
    canvas.addEventListener("pointercancel", (event) => this.#forget(event));
    canvas.addEventListener("pointerleave", () => this.#hovers(null));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.#takeLook());
    canvas.addEventListener("keydown", (event) => this.#key(event));
    canvas.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    // A user's own script may ask where a place is on the screen.
    canvas.pixelOf = (x, y) => {
      const box = canvas.getBoundingClientRect();
      const [px, py] = this.at(x, y);
      return [box.left + px, box.top + py];
    };
    this.#takeLook();
    this.#resize();
  }

  /** Pixels of the canvas' box. */
  get size() {
    return [this.canvas.clientWidth, this.canvas.clientHeight];
  }

  /** A place in the map, in pixels of the canvas. */
  at(x, y) {
    const [width, height] = this.size;
    return [width / 2 + (x - this.center[0]) * this.scale, height / 2 - (y - this.center[1]) * this.scale];
  }

  /** A pixel's place in the map. */
  placeOf(px, py) {
    const [width, height] = this.size;
    return [this.center[0] + (px - width / 2) / this.scale, this.center[1] - (py - height / 2) / this.scale];
  }

  #takeLook() {
    const style = getComputedStyle(this.canvas);
    this.#look = { raised: style.getPropertyValue("--raised"), font: style.fontFamily };
    this.#widths.clear();
    this.#fixed.of = this.#slow.of = "";
    this.redraw();
  }

  #resize() {
    const ratio = devicePixelRatio || 1;
    const [width, height] = this.size;
    if (width === 0 || height === 0) {
      // Another view is shown.
      return;
    }
    for (const [context, margin] of [
      [this.#context, 0],
      [this.#fixed.context, MARGIN_PX],
      [this.#slow.context, MARGIN_PX],
    ]) {
      context.canvas.width = Math.max(1, Math.round((width + 2 * margin) * ratio));
      context.canvas.height = Math.max(1, Math.round((height + 2 * margin) * ratio));
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
    }
    this.#fixed.of = this.#slow.of = "";
    if (!this.#looksElsewhere) {
      this.fit();
    }
    this.redraw();
  }

  /** Show the whole world. */
  fit() {
    const [left, bottom, right, top] = this.#scene.bounds();
    const [width, height] = this.size;
    this.center = [(left + right) / 2, (bottom + top) / 2];
    this.scale = this.#bounded(0.94 * Math.min(width / (right - left), height / (top - bottom)));
    this.#looksElsewhere = false;
    this.redraw();
  }

  /** The world has come or changed: show all of it, unless the user has looked elsewhere. */
  worldChanged() {
    if (!this.#looksElsewhere) {
      this.fit();
    }
  }

  /** Zoom around a pixel, by default the middle. */
  zoom(factor, px = this.size[0] / 2, py = this.size[1] / 2) {
    const before = this.placeOf(px, py);
    this.scale = this.#bounded(this.scale * factor);
    const after = this.placeOf(px, py);
    this.center = [this.center[0] + before[0] - after[0], this.center[1] + before[1] - after[1]];
    this.#looksElsewhere = true;
    this.redraw();
  }

  #bounded(scale) {
    return Math.min(MAX_SCALE, Math.max(MIN_SCALE, Number.isFinite(scale) ? scale : 60));
  }

  /** Draw with the browser's next picture. */
  redraw() {
    if (!this.#wanted) {
      this.#wanted = true;
      requestAnimationFrame((nowMs) => this.#draw(nowMs));
    }
  }

  #draw(nowMs) {
    this.#wanted = false;
    const moves = this.#scene.smooth(Math.min(nowMs - this.#drawnMs, 200));
    this.#drawnMs = nowMs;
    const robot = this.#scene.drawnRobot();
    if (this.follows && robot) {
      this.center = [robot[0], robot[1]];
    }
    const context = this.#context;
    const [width, height] = this.size;
    if (width === 0 || height === 0) {
      return;
    }
    const ratio = context.canvas.width / width;
    const [dx, dy] = this.#drawLower(width, height).map((shift) => Math.round(shift * ratio) / ratio);
    context.drawImage(
      this.#slow.context.canvas,
      ...[dx - MARGIN_PX, dy - MARGIN_PX, width + 2 * MARGIN_PX, height + 2 * MARGIN_PX],
    );
    const pen = this.#pen(context, width, height, this.center);
    if (this.layers.trails) {
      context.globalAlpha = this.opacity.trails;
      drawTrailEnds(pen, this.#scene);
    }
    this.#drawLayers(pen, LAYERS.slice(SLOW));
    this.route.forEach((pose, index) => arrow(pen, pose, COLORS.goal, String(index + 1)));
    this.waypoints.forEach((pose, index) => arrow(pen, pose, COLORS.marker, String(index + 1)));
    if (this.outline && (this.#aim || this.hover)) {
      boxOutline(pen, this.#aim?.pose ?? [...this.hover, 0], this.outline, COLORS.estimate);
    }
    if (this.#aim) {
      const [x, y, yaw] = this.#aim.pose;
      arrow(pen, [x, y, this.#aim.dragged ? yaw : null], COLORS.estimate);
    }
    if (this.measured.length) {
      measured(pen, this.measured[0], this.measured[1] ?? this.#aim?.pose.slice(0, 2) ?? this.hover);
    }
    if (moves) {
      this.redraw();
    }
  }

  #pen(context, width, height, center) {
    const [left, top] = [width / 2 - center[0] * this.scale, height / 2 + center[1] * this.scale];
    const { scale } = this;
    return {
      context,
      scale,
      at: (x, y) => [left + x * scale, top - y * scale],
      font: (px, bold = false) => `${bold ? "bold " : ""}${px}px ${this.#look.font}`,
      shows: (key) => this.layers[key],
      widthOf: (text, font) => this.#widthOf(context, text, font),
    };
  }

  /** Measuring a text takes longer than writing it. */
  #widthOf(context, text, font) {
    const key = `${font} ${text}`;
    if (!this.#widths.has(key)) {
      if (this.#widths.size > 1000) {
        this.#widths.clear();
      }
      context.font = font;
      this.#widths.set(key, context.measureText(text).width);
    }
    return this.#widths.get(key);
  }

  #drawLayers(pen, layers) {
    for (const [key, , , , draw] of layers) {
      if (this.layers[key] && this.opacity[key] > 0) {
        pen.context.globalAlpha = this.opacity[key];
        draw(pen, this.#scene);
      }
    }
    pen.context.globalAlpha = 1;
  }

  /** Draw the lower layers, unless they look as they did; returns where they lie now, in px. */
  #drawLower(width, height) {
    const { scale } = this;
    const shift = () => [0, 1].map((axis) => (axis ? 1 : -1) * scale * (this.center[axis] - this.#fixed.center[axis]));
    if (scale !== this.#fixed.scale || shift().some((far) => Math.abs(far) > MARGIN_PX)) {
      Object.assign(this.#fixed, { of: "", scale, center: [...this.center] });
    }
    const looks = (layers) => layers.map(([key]) => (this.layers[key] ? this.opacity[key] : 0)).join(" ");
    const size = [width + 2 * MARGIN_PX, height + 2 * MARGIN_PX];
    const { context } = this.#fixed;
    const fixed = LAYERS.slice(0, FIXED);
    const fixedOf = `${this.#scene.version} ${looks(fixed)}`;
    if (fixedOf !== this.#fixed.of) {
      Object.assign(this.#fixed, { of: fixedOf });
      this.#slow.of = "";
      context.fillStyle = this.#look.raised;
      context.fillRect(0, 0, ...size);
      this.#drawLayers(this.#pen(context, ...size, this.#fixed.center), fixed);
    }
    const slow = LAYERS.slice(FIXED, SLOW);
    const slowOf = `${this.#scene.slowVersion} ${looks(slow)}`;
    if (slowOf !== this.#slow.of) {
      this.#slow.of = slowOf;
      this.#slow.context.drawImage(context.canvas, 0, 0, ...size);
      this.#drawLayers(this.#pen(this.#slow.context, ...size, this.#fixed.center), slow);
    }
    return shift();
  }

  #hovers(place) {
    this.hover = place;
    this.onHover(place);
    if (this.outline || this.measured.length === 1) {
      this.redraw();
    }
  }

  #pixel(event) {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  #down(event) {
    if (event.button !== 0) {
      return;
    }
    this.canvas.setPointerCapture(event.pointerId);
    this.#pointers.set(event.pointerId, this.#pixel(event));
    if (this.#pointers.size === 2) {
      this.#aim = null;
      this.#pinch = this.#spread();
    } else if (this.isAiming && this.#pointers.size === 1) {
      const from = this.#pixel(event);
      this.#aim = { from, dragged: false, pose: [...this.placeOf(...from), 0] };
      this.redraw();
    }
  }

  #move(event) {
    this.#hovers(this.placeOf(...this.#pixel(event)));
    const before = this.#pointers.get(event.pointerId);
    if (!before) {
      return;
    }
    const now = this.#pixel(event);
    this.#pointers.set(event.pointerId, now);
    if (this.#pointers.size === 2 && this.#pinch) {
      const spread = this.#spread();
      this.#pan(spread.middle[0] - this.#pinch.middle[0], spread.middle[1] - this.#pinch.middle[1]);
      this.zoom(spread.length / this.#pinch.length, ...spread.middle);
      this.#pinch = spread;
    } else if (this.#aim) {
      const [dx, dy] = [now[0] - this.#aim.from[0], now[1] - this.#aim.from[1]];
      if (this.hasHeading && Math.hypot(dx, dy) > HEADING_PX) {
        this.#aim.dragged = true;
        this.#aim.pose[2] = Math.atan2(-dy, dx);
        this.redraw();
      }
    } else if (!this.isAiming && this.#pointers.size === 1) {
      this.#pan(now[0] - before[0], now[1] - before[1]);
    }
  }

  #pan(dx, dy) {
    if (Math.hypot(dx, dy) > 0) {
      this.center = [this.center[0] - dx / this.scale, this.center[1] + dy / this.scale];
      this.#looksElsewhere = true;
      if (this.follows && Math.hypot(dx, dy) > CLICK_PX) {
        this.follows = false;
        this.onFollow();
      }
      this.redraw();
    }
  }

  #up(event) {
    const aim = this.#aim;
    this.#forget(event);
    if (aim) {
      this.onPick(aim.pose, aim.dragged);
    }
  }

  #forget(event) {
    this.#pointers.delete(event.pointerId);
    this.#pinch = null;
    this.#aim = null;
    this.redraw();
  }

  /** Aim without a pointer: from the robot's place on. `onAim(pose)` gets the aim. */
  #key(event) {
    const step = AIM_KEYS[event.key];
    const turn = this.hasHeading ? TURN_KEYS[event.key] : 0;
    const picks = event.key === "Enter" || event.key === " ";
    const isOther = event.ctrlKey || event.metaKey || event.altKey;
    if (!this.isAiming || isOther || !(step || turn || picks)) {
      return;
    }
    event.preventDefault();
    if (!this.#aim) {
      const [x, y] = this.#scene.robot() ?? this.center;
      this.#aim = { dragged: false, pose: [x, y, 0] };
    } else if (picks) {
      const { pose, dragged } = this.#aim;
      this.onPick([...pose], dragged);
      return;
    }
    const { pose } = this.#aim;
    if (step) {
      const length = event.shiftKey ? FINE_STEP_M : AIM_STEP_M;
      pose[0] += length * step[0];
      pose[1] += length * step[1];
    } else if (turn) {
      this.#aim.dragged = true;
      pose[2] = Math.atan2(Math.sin(pose[2] + turn * TURN_STEP_RAD), Math.cos(pose[2] + turn * TURN_STEP_RAD));
    }
    this.onAim(pose, this.#aim.dragged);
    this.redraw();
  }

  /** Give up what is being aimed at. */
  giveUp() {
    this.#aim = null;
    this.redraw();
  }

  #spread() {
    const [first, second] = [...this.#pointers.values()];
    return {
      middle: [(first[0] + second[0]) / 2, (first[1] + second[1]) / 2],
      length: Math.max(10, Math.hypot(first[0] - second[0], first[1] - second[1])),
    };
  }

  #wheel(event) {
    event.preventDefault();
    this.zoom(Math.exp(-event.deltaY * 0.0015), ...this.#pixel(event));
  }
}
