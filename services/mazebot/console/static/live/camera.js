// The camera's picture, with the outlines of the markers that perception has found in it.

const SVG = "http://www.w3.org/2000/svg";
/** A picture and what was found in it have the same time, but one of both may be left out. */
const SAME_S = 0.12;
const MOST_KEPT = 30;

/** The panel with the picture. */
export class Camera {
  #panel;
  #image;
  #outlines;
  #url = "";
  #timeS = null;
  #found = [];

  constructor(panel) {
    this.#panel = panel;
    this.#image = panel.querySelector("img");
    this.#outlines = panel.querySelector("svg");
    this.#image.addEventListener("load", () => {
      const { naturalWidth: width, naturalHeight: height } = this.#image;
      this.#outlines.setAttribute("viewBox", `0 0 ${width} ${height}`);
      this.#draw();
    });
  }

  /** Take one frame in. */
  take(kind, content, data) {
    if (kind === "camera") {
      URL.revokeObjectURL(this.#url);
      this.#url = URL.createObjectURL(new Blob([data], { type: "image/jpeg" }));
      this.#image.src = this.#url;
      this.#timeS = content.time_s;
      this.#panel.classList.add("has-picture");
    } else if (kind === "detections") {
      this.#found = [...this.#found.slice(1 - MOST_KEPT), content];
      this.#draw();
    } else if (kind === "restarted") {
      this.#found = [];
      this.#draw();
    }
  }

  #draw() {
    const apart = (one) => Math.abs(one.time_s - this.#timeS);
    const nearest = this.#found.reduce((best, one) => (best && apart(best) <= apart(one) ? best : one), null);
    const outlines = nearest && this.#timeS !== null && apart(nearest) < SAME_S ? nearest.outlines : [];
    const { naturalWidth: width, naturalHeight: height } = this.#image;
    this.#outlines.replaceChildren(
      ...outlines.flatMap(({ id, corners }) => {
        const points = corners.map(([x, y]) => [x * width, y * height]);
        const outline = document.createElementNS(SVG, "polygon");
        outline.setAttribute("points", points.map((point) => point.join(",")).join(" "));
        const name = document.createElementNS(SVG, "text");
        name.setAttribute("x", Math.max(...points.map(([x]) => x)) + 4);
        name.setAttribute("y", Math.max(16, Math.min(...points.map(([, y]) => y))));
        name.textContent = id;
        return [outline, name];
      }),
    );
  }
}
