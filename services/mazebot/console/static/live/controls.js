// Which buttons can act now; the others are off.

const $ = (id) => document.getElementById(id);

/** Follows the stack, the task and the world. */
export class Controls {
  #services = new Set();
  #isActive = false;
  #hasTask = false;
  #isPaused = false;
  #things = 0;
  #docks = 0;
  #isConnected = false;

  /** Take one frame in. */
  take(kind, content) {
    switch (kind) {
      case "stack":
        this.#services = new Set(content.services);
        break;
      case "navigation":
        this.#isActive = content.localization_active && content.navigation_active;
        this.#hasTask = content.state !== "idle";
        break;
      case "feedback":
        this.#isPaused = content.paused;
        break;
      case "action_result":
      case "restarted":
        this.#isPaused = false;
        break;
      case "entities":
        this.#docks = content.docks.length;
        this.#things = content.bodies.length + content.markers.length;
        break;
      default:
        return;
    }
    this.#show();
  }

  /** Whether the console answers. */
  connected(isConnected) {
    this.#isConnected = isConnected;
    this.#show();
  }

  #show() {
    const runs = this.#isConnected && this.#services.size > 0;
    const drives = runs && this.#isActive;
    const can = {
      pause: runs, step: runs, speed: runs, reset: runs,
      "emergency-stop": runs && this.#services.has("physics"),
      cancel: runs && this.#hasTask,
      "pause-task": runs && this.#hasTask && !this.#isPaused,
      "resume-task": runs && this.#hasTask && this.#isPaused,
      "drive-there": drives, undock: drives, spin: drives, "back-up": drives,
      dock: drives && this.#docks > 0,
      "dock-id": this.#docks > 0,
      "clear-costmaps": runs && this.#services.has("navigation"),
      "find-robot": runs && this.#services.has("localization"),
    };
    for (const [id, is] of Object.entries(can)) {
      $(id).disabled = !is;
    }
    const tools = { goal: drives, waypoints: drives, initial_pose: runs, drop_box: runs, remove: runs && this.#things > 0 };
    for (const [name, is] of Object.entries(tools)) {
      document.querySelector(`[data-tool=${name}]`).disabled = !is;
    }
  }
}
