// Rerun's viewer inside a page: its notebook widget, driven without a notebook.

/** The two files of the viewer have the version in their address, so that they can be kept. */
const address = (version) => `/viewer/${encodeURIComponent(version)}/widget.js`;

const AGAIN_MS = 1000;
const SAME_S = 0.002;
/** So often in a row must a moment that was wanted be found shown. */
const STAYS = 5;

export class Viewer {
  #listeners = new Map();
  #box;
  #open = [];
  #ready;
  #isReady;
  #observer;
  #soughtS = null;
  #stays = 0;
  #shownS = null;
  #hasOpened = false;
  #again = 0;
  /** Called with the time shown, in s of simulation time. */
  onTime = () => {};
  /** Called with the id of each recording that has been opened. */
  onOpen = () => {};

  /** Load the viewer of a version into an element. */
  static async start(box, version) {
    // It logs thousands of lines at this level, which would keep the page busy.
    console.debug = () => {};
    keepFocus(box);
    const widget = (await import(address(version))).default;
    return new Viewer(box, widget);
  }

  constructor(box, widget) {
    this.#box = box;
    this.#ready = new Promise((resolve) => { this.#isReady = resolve; });
    const isDark = matchMedia("(prefers-color-scheme: dark)").matches;
    const values = {
      _url: null,
      _width: box.clientWidth,
      _height: box.clientHeight,
      _panel_states: { top: "hidden", blueprint: "hidden", selection: "hidden", time: "collapsed" },
      _fallback_token: null,
      _theme: isDark ? "dark" : "light",
    };
    widget.render({
      el: box,
      model: {
        get: (key) => values[key],
        on: (event, listener) => this.#listeners.set(event, listener),
        send: (event) => this.#receive(event),
      },
    });
    this.#observer = new ResizeObserver(() => this.#fit());
    this.#observer.observe(box);
    for (const kind of ["pointerdown", "keydown"]) {
      box.addEventListener(kind, () => { this.#soughtS = null; }, { capture: true });
    }
  }

  /** Whether the viewer has been asked to open an address. */
  isOpen(url) {
    return Boolean(url) && this.#open.includes(new URL(url, location.href).href);
  }

  /** Show the recording in some files, which are parts of one; what was shown is closed. */
  async open(urls) {
    await this.#ready;
    const wanted = urls.map((url) => new URL(url, location.href).href);
    if (wanted.join() === this.#open.join()) return;
    // A moment of what is closed is none of what is opened.
    this.#soughtS = null;
    this.#hasOpened = false;
    for (const url of this.#open) if (!wanted.includes(url)) this.#send({ type: "close_url", url });
    for (const url of wanted) if (!this.#open.includes(url)) this.#send({ type: "open_url", url });
    this.#open = wanted;
  }

  /** Show a moment of the recording, in s of simulation time. */
  async seek(time_s) {
    await this.#ready;
    this.#soughtS = time_s;
    this.#stays = 0;
    this.#sendTime();
  }

  /** The viewer ignores a time that comes while it opens a recording, however long that takes, and
   * then follows the newest one: sent again until it stays, or the user takes the viewer over. The
   * first moment of a recording is shown at first, whatever was wanted.
   */
  #sendTime() {
    clearTimeout(this.#again);
    if (this.#soughtS === null) return;
    const duration_nanos = String(BigInt(Math.round(this.#soughtS * 1e9)));
    this.#send({ type: "time_ctrl", timeline: "sim_time", duration_nanos, play: false });
    this.#again = setTimeout(() => {
      const isShown = this.#hasOpened && Math.abs(this.#shownS - this.#soughtS) < SAME_S;
      this.#stays = isShown ? this.#stays + 1 : 0;
      if (this.#stays >= STAYS) this.#soughtS = null;
      this.#sendTime();
    }, AGAIN_MS);
  }

  #shows(time_s) {
    this.#shownS = time_s;
    this.onTime(time_s);
  }

  #send(message) {
    this.#listeners.get("msg:custom")?.(message, []);
  }

  #fit() {
    this.#listeners.get("change:_width")?.(null, this.#box.clientWidth);
    this.#listeners.get("change:_height")?.(null, this.#box.clientHeight);
  }

  #receive(event) {
    if (event === "ready") {
      this.#fit();
      this.#isReady();
      return;
    }
    let message;
    try {
      message = typeof event === "string" ? JSON.parse(event) : event;
    } catch {
      return;
    }
    if (message.type === "recording_open") {
      this.#hasOpened = true;
      this.onOpen(message.recording_id);
    }
    if (message.type === "time_update" && Number.isFinite(Number(message.time))) {
      this.#shows(Number(message.time) / 1e9);
    }
  }
}

/** The viewer takes the focus when it starts, and with it the page's keys: it gets it from the user
 * only.
 */
function keepFocus(box) {
  let before = document.activeElement;
  let isWanted = false;
  const wants = () => { isWanted = true; };
  box.addEventListener("pointerdown", wants, { capture: true });
  document.addEventListener("keydown", (event) => {
    if (event.key === "Tab") wants();
  }, { capture: true });
  document.addEventListener("focusin", (event) => {
    if (!box.contains(event.target)) {
      before = event.target;
      isWanted = false;
    } else if (!isWanted) {
      if (before?.isConnected && before !== document.body) before.focus({ preventScroll: true });
      if (box.contains(document.activeElement)) document.activeElement.blur();
    }
  });
}
