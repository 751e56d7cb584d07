// The emergency stop, and what keeps the robot from driving as it could.

const $ = (id) => document.getElementById(id);
const BADGES = { slowdown: "warn", stop: "warn", hold: "bad" };

/** Follows the simulator and navigation. */
export class StopLevel {
  #reason = "";
  #causes = [];
  /** Whether the robot is held until a person clears it. */
  get isHeld() {
    return this.#reason !== "";
  }

  /** Take one frame in. */
  take(kind, content) {
    if (kind === "stats") {
      this.#reason = content.emergency_stop;
    } else if (kind === "navigation") {
      this.#causes = content.stop_causes;
    } else if (kind === "restarted") {
      this.#causes = [];
    } else {
      return;
    }
    this.#show();
  }

  #show() {
    // Without navigation the simulator alone says it, and sooner.
    const causes = this.#causes.filter((cause) => cause.level !== "hold");
    if (this.isHeld) {
      causes.unshift({ level: "hold", cause: `emergency stop: ${this.#reason}`, cleared_by: "Clear stop" });
    }
    const level = causes[0]?.level ?? "none";
    const button = $("emergency-stop");
    button.textContent = this.isHeld ? "Clear stop" : "Stop";
    button.setAttribute("aria-pressed", String(this.isHeld));
    button.title = this.isHeld ? "let the robot move again" : "emergency stop: the robot is held at rest until it is cleared";
    $("stop-level").hidden = level === "none";
    $("stop-level").textContent = level;
    $("stop-level").className = `badge ${BADGES[level] ?? ""}`;
    const lines = causes.map(({ level: what, cause, cleared_by: by }) => `${what}: ${cause}; cleared by ${by}`);
    $("stop-level").title = lines.join("\n");
    const list = $("stop-causes");
    if (list.textContent !== lines.join("")) {
      list.replaceChildren(...lines.map((line) => Object.assign(document.createElement("li"), { textContent: line })));
    }
  }
}
