// The plan on its canvas: draws the scene when something has changed; zoom, pan and follow.

import { COLORS, LAYERS, arrow } from "./layers.js";

const MIN_SCALE = 4;
const MAX_SCALE = 600;
const CLICK_PX = 6;
const HEADING_PX = 12;
/** Where a key moves the aim, in steps to the right and up. */
const AIM_KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
const TURN_KEYS = { ",": 1, ".": -1 };
const AIM_STEP_M = 0.1;
const FINE_STEP_M = 0.02;
const TURN_STEP_RAD = Math.PI / 12;

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

  constructor(canvas, scene, onPick) {
    this.canvas = canvas;
    this.#scene = scene;
    this.#context = canvas.getContext("2d");
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
    new ResizeObserver(() => this.#resize()).observe(canvas);
    canvas.addEventListener("pointerdown", (event) => this.#down(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    canvas.addEventListener("pointerup", (event) => this.#up(event));
    canvas.addEventListener("pointercancel", (event) => this.#forget(event));
    canvas.addEventListener("keydown", (event) => this.#key(event));
    canvas.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    // A user's own script may ask where a place is on the screen.
    canvas.pixelOf = (x, y) => {
      const box = canvas.getBoundingClientRect();
      const [px, py] = this.at(x, y);
      return [box.left + px, box.top + py];
    };
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

  #resize() {
    const ratio = devicePixelRatio || 1;
    const [width, height] = this.size;
    this.canvas.width = Math.max(1, Math.round(width * ratio));
    this.canvas.height = Math.max(1, Math.round(height * ratio));
    this.#context.setTransform(ratio, 0, 0, ratio, 0, 0);
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
    const robot = this.#scene.robot();
    if (this.follows && robot) {
      this.center = [robot[0], robot[1]];
    }
    const context = this.#context;
    const [width, height] = this.size;
    context.clearRect(0, 0, width, height);
    const style = getComputedStyle(this.canvas);
    context.fillStyle = style.getPropertyValue("--raised");
    context.fillRect(0, 0, width, height);
    const pen = {
      context,
      scale: this.scale,
      at: (x, y) => this.at(x, y),
      font: (px, bold = false) => `${bold ? "bold " : ""}${px}px ${style.fontFamily}`,
    };
    for (const [key, , , , draw] of LAYERS) {
      if (this.layers[key]) {
        draw(pen, this.#scene);
      }
    }
    this.route.forEach((pose, index) => arrow(pen, pose, COLORS.goal, String(index + 1)));
    this.waypoints.forEach((pose, index) => arrow(pen, pose, COLORS.marker, String(index + 1)));
    if (this.#aim) {
      arrow(pen, this.#aim.pose, COLORS.estimate);
    }
    if (moves) {
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
