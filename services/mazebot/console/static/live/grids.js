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

/** A wall's cells reach so far beyond it, in cells. */
const FRINGE_CELLS = 1.5;
const OCCUPIED = 65;

/**
 * A grid as `{canvas, head, cells, origin: [x, y, yaw], width_m, height_m}`; the picture's top row has
 * the largest y. `walls`: polygons in m that are drawn by themselves; their cells look as those beside.
 */
export function gridPicture(kind, head, data, walls = []) {
  const { columns, rows } = head;
  const all = new Uint8Array(data);
  const cells = walls.length ? withoutWalls(head, all, walls) : all;
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
    head,
    cells: all,
    origin: head.origin,
    width_m: columns * head.resolution_m,
    height_m: rows * head.resolution_m,
  };
}

/** The value of a grid at a place in the map, -1 to 100; null outside. */
export function valueAt(grid, x, y) {
  const [left, bottom, yaw] = grid.origin;
  const [dx, dy] = [x - left, y - bottom];
  const column = Math.floor((Math.cos(yaw) * dx + Math.sin(yaw) * dy) / grid.head.resolution_m);
  const row = Math.floor((Math.cos(yaw) * dy - Math.sin(yaw) * dx) / grid.head.resolution_m);
  if (column < 0 || row < 0 || column >= grid.head.columns || row >= grid.head.rows) {
    return null;
  }
  return (grid.cells[row * grid.head.columns + column] << 24) >> 24;
}

/** The cells with those of walls replaced by the nearest others. */
function withoutWalls(head, all, walls) {
  const { columns, rows, resolution_m: cellM, origin } = head;
  const canvas = document.createElement("canvas");
  canvas.width = columns;
  canvas.height = rows;
  const context = canvas.getContext("2d");
  context.setTransform(1 / cellM, 0, 0, 1 / cellM, 0, 0);
  context.rotate(-origin[2]);
  context.translate(-origin[0], -origin[1]);
  context.lineWidth = 2 * FRINGE_CELLS * cellM;
  for (const wall of walls) {
    context.beginPath();
    wall.forEach(([x, y], index) => (index ? context.lineTo(x, y) : context.moveTo(x, y)));
    context.closePath();
    context.fill();
    context.stroke();
  }
  const covered = context.getImageData(0, 0, columns, rows).data;
  const cells = all.slice();
  let open = [];
  for (let index = 0; index < cells.length; index += 1) {
    if (covered[4 * index + 3] && all[index] >= OCCUPIED && all[index] <= 100) {
      open.push(index);
    }
  }
  const isOpen = new Uint8Array(cells.length);
  for (const index of open) {
    isOpen[index] = 1;
  }
  while (open.length) {
    const done = [];
    const left = [];
    for (const index of open) {
      const column = index % columns;
      const beside = [
        column > 0 ? index - 1 : -1,
        column < columns - 1 ? index + 1 : -1,
        index - columns,
        index + columns,
      ].find((one) => one >= 0 && one < cells.length && !isOpen[one]);
      if (beside === undefined) {
        left.push(index);
      } else {
        cells[index] = cells[beside];
        done.push(index);
      }
    }
    for (const index of done) {
      isOpen[index] = 0;
    }
    if (done.length === 0) {
      break;
    }
    open = left;
  }
  return cells;
}
