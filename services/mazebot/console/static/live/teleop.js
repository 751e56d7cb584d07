// Driving by hand: with the joystick, or with keys that are held.

const REPEAT_MS = 100;
const MAX_LINEAR_M_S = 0.3;
const MAX_ANGULAR_RAD_S = 1.5;
const KEY_LINEAR_M_S = 0.2;
const KEY_ANGULAR_RAD_S = 1.0;
const KEYS = {
  w: [1, 0], arrowup: [1, 0],
  s: [-1, 0], arrowdown: [-1, 0],
  a: [0, 1], arrowleft: [0, 1],
  d: [0, -1], arrowright: [0, -1],
};

/** Sends what the user commands as long as it is commanded: `{do: "drive"}`, and `{do: "stop"}` once. */
export class Teleop {
  #link;
  #pad;
  #knob;
  #held = new Set();
  #stick = null;
  #timer = 0;

  constructor(link, pad) {
    this.#link = link;
    this.#pad = pad;
    this.#knob = pad.querySelector("span");
    addEventListener("keydown", (event) => this.#press(event));
    addEventListener("keyup", (event) => this.#release(event));
    addEventListener("blur", () => this.stop());
    addEventListener("pagehide", () => this.stop());
    document.addEventListener("visibilitychange", () => {
      if (document.hidden) {
        this.stop();
      }
    });
    document.addEventListener("focusin", (event) => {
      if (takesKeys(event.target)) {
        this.stop();
      }
    });
    pad.addEventListener("pointerdown", (event) => {
      pad.setPointerCapture(event.pointerId);
      this.#steer(event);
    });
    pad.addEventListener("pointermove", (event) => {
      if (this.#stick) {
        this.#steer(event);
      }
    });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
      pad.addEventListener(name, () => {
        if (this.#stick) {
          this.stop();
        }
      });
    }
  }

  #press(event) {
    const key = event.key.toLowerCase();
    // The plan takes arrows itself while something is aimed at.
    if (event.defaultPrevented || !(key in KEYS) || event.ctrlKey || event.altKey || event.metaKey || takesKeys(event.target)) {
      return;
    }
    event.preventDefault();
    this.#held.add(key);
    this.#begin();
  }

  #release(event) {
    const key = event.key.toLowerCase();
    if (this.#held.delete(key)) {
      if (this.#held.size === 0 && !this.#stick) {
        this.stop();
      } else {
        this.#send();
      }
    }
  }

  #steer(event) {
    const box = this.#pad.getBoundingClientRect();
    const radius = box.width / 2;
    let x = (event.clientX - box.left - radius) / radius;
    let y = (event.clientY - box.top - radius) / radius;
    const length = Math.hypot(x, y);
    if (length > 1) {
      x /= length;
      y /= length;
    }
    this.#stick = [-y, -x];
    this.#knob.style.transform = `translate(${0.6 * x * radius}px, ${0.6 * y * radius}px)`;
    this.#begin();
  }

  #velocity() {
    if (this.#stick) {
      return [MAX_LINEAR_M_S * this.#stick[0], MAX_ANGULAR_RAD_S * this.#stick[1]];
    }
    let [linear, angular] = [0, 0];
    for (const key of this.#held) {
      linear += KEYS[key][0];
      angular += KEYS[key][1];
    }
    return [KEY_LINEAR_M_S * Math.sign(linear), KEY_ANGULAR_RAD_S * Math.sign(angular)];
  }

  #begin() {
    this.#pad.classList.add("drives");
    if (!this.#timer) {
      this.#timer = setInterval(() => this.#send(), REPEAT_MS);
      this.#send();
    }
  }

  #send() {
    const [linear, angular] = this.#velocity();
    this.#link.send({ do: "drive", linear_m_s: linear, angular_rad_s: angular });
  }

  /** Let go of everything: the robot stops. */
  stop() {
    this.#held.clear();
    this.#stick = null;
    this.#knob.style.transform = "";
    this.#pad.classList.remove("drives");
    if (this.#timer) {
      clearInterval(this.#timer);
      this.#timer = 0;
      this.#link.send({ do: "stop" });
    }
  }
}

/** Whether an element has its own use for letters and arrows. */
function takesKeys(element) {
  return element instanceof Element && element.closest("input, select, textarea, [id=log], [id=rerun]") !== null;
}
