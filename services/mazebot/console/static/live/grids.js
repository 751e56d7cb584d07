// Occupancy grids as pictures, in RViz's colours.

const UNKNOWN = [112, 137, 134];

/** RGBA of each value, 256 x 4, as RViz's `map` palette. */
function mapPalette() {
  const palette = new Uint8ClampedArray(1024);
  for (let value = 0; value <= 100; value += 1) {
    const grey = 255 - Math.floor((255 * value) / 100);
    palette.set([grey, grey, grey, 255], 4 * value);
  }
  for (let value = 101; value < 256; value += 1) {
    palette.set([...UNKNOWN, 255], 4 * value);
  }
  return palette;
}

/** As RViz's `costmap` palette: free is clear, 99 inscribed is cyan, 100 lethal is purple. */
function costmapPalette() {
  const palette = new Uint8ClampedArray(1024);
  for (let value = 1; value <= 98; value += 1) {
    const red = Math.floor((255 * value) / 100);
    palette.set([red, 0, 255 - red, 150], 4 * value);
  }
  palette.set([0, 255, 255, 170], 4 * 99);
  palette.set([255, 0, 255, 190], 4 * 100);
  return palette;
}

const PALETTES = {
  map: mapPalette(),
  global_costmap: costmapPalette(),
  local_costmap: costmapPalette(),
};

/** A grid as `{canvas, origin: [x, y, yaw], width_m, height_m}`; its top row has the largest y. */
export function gridPicture(kind, head, data) {
  const { columns, rows } = head;
  const cells = new Uint8Array(data);
  const canvas = document.createElement("canvas");
  canvas.width = columns;
  canvas.height = rows;
  const context = canvas.getContext("2d");
  const picture = context.createImageData(columns, rows);
  const palette = new Uint32Array(PALETTES[kind].buffer);
  const pixels = new Uint32Array(picture.data.buffer);
  for (let row = 0; row < rows; row += 1) {
    const target = (rows - 1 - row) * columns;
    for (let column = 0; column < columns; column += 1) {
      pixels[target + column] = palette[cells[row * columns + column]];
    }
  }
  context.putImageData(picture, 0, 0);
  return {
    canvas,
    origin: head.origin,
    width_m: columns * head.resolution_m,
    height_m: rows * head.resolution_m,
  };
}
