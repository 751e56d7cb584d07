// The websocket to the console: frames come in, what the user wants goes out.

const RETRY_MS = 1000;
const ANSWER_MS = 15000;

/** A connection that is opened again whenever it is lost. */
export class Link {
  #socket = null;
  #waiting = new Map();
  #number = 0;
  #onFrame;
  #onState;

  /** `onFrame(kind, content, data)`: data is an ArrayBuffer or null; `onState(isOpen)`. */
  constructor(onFrame, onState) {
    this.#onFrame = onFrame;
    this.#onState = onState;
    this.#open();
  }

  get isOpen() {
    return this.#socket !== null && this.#socket.readyState === WebSocket.OPEN;
  }

  #open() {
    const address = new URL("/live/feed", location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    socket.addEventListener("open", () => this.#onState(true));
    socket.addEventListener("message", (event) => this.#take(event.data));
    socket.addEventListener("close", () => {
      this.#onState(false);
      for (const settle of this.#waiting.values()) {
        settle({ said: "", error: "lost the connection to the console" });
      }
      this.#waiting.clear();
      setTimeout(() => this.#open(), RETRY_MS);
    });
  }

  #take(data) {
    if (typeof data === "string") {
      const { kind, content } = JSON.parse(data);
      if (kind === "answer") {
        this.#answered(content);
      } else {
        this.#onFrame(kind, content, null);
      }
      return;
    }
    const length = new DataView(data).getUint32(0, true);
    const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    this.#onFrame(head.kind, head, data.slice(4 + length));
  }

  #answered(answer) {
    const settle = this.#waiting.get(answer.id);
    this.#waiting.delete(answer.id);
    if (settle) {
      settle(answer);
    } else if (answer.error) {
      this.#onFrame("error", answer, null);
    }
  }

  /** Send without waiting for an answer; false where there is no connection. */
  send(action) {
    if (!this.isOpen) {
      return false;
    }
    this.#number += 1;
    this.#socket.send(JSON.stringify({ id: this.#number, action }));
    return true;
  }

  /** Send, and wait for `{said, error}`. */
  ask(action) {
    return new Promise((resolve) => {
      if (!this.send(action)) {
        resolve({ said: "", error: "not connected to the console" });
        return;
      }
      const id = this.#number;
      const timer = setTimeout(() => {
        this.#waiting.delete(id);
        resolve({ said: "", error: "the console did not respond in time" });
      }, ANSWER_MS);
      this.#waiting.set(id, (answer) => {
        clearTimeout(timer);
        resolve(answer);
      });
    });
  }
}
