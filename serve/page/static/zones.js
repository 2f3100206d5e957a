// The article's zones (2.3, features/vector/zones.py) as a slide goes on: the signs of a sensing element's V_x and V_y
// tell the quadrant around it that the contact is in.
import { number } from "./canvas.js";

// Share of the slide's largest |V| so far within which an output keeps its sign.
const DEAD_BAND = 0.1;
// At least, in V: a frame's noise is 1.1 to 1.4 mV.
const LEAST_V = 0.003;

// Of each sensing element the signs [x, y] of its outputs in this slide, 0 while they are not known.
export class Zones {
  constructor(boards) {
    this.boards = boards;
    // Zones are those of a board that a contact tilts towards itself.
    this.known = boards.every(({ kind }) => (kind ?? "accelerometer") === "accelerometer");
    this.clear();
  }

  clear() {
    this.signs = this.boards.map(() => [0, 0]);
    this.peaks = this.boards.map(() => 0);
  }

  push({ state, subtracted_v }) {
    if (state !== "slide" || !this.known) return this.clear();
    this.boards.forEach((_, n) => {
      const tilt = [subtracted_v[3 * n], subtracted_v[3 * n + 1]];
      this.peaks[n] = Math.max(this.peaks[n], ...tilt.filter(Number.isFinite).map(Math.abs));
      const band = Math.max(LEAST_V, DEAD_BAND * this.peaks[n]);
      tilt.forEach((value, axis) => { if (Math.abs(value) > band) this.signs[n][axis] = Math.sign(value); });
    });
  }

  // The quadrants that are lit, each with its element and the signs of x and y there.
  lit() {
    return this.boards.map((board, n) => ({ board, x: this.signs[n][0], y: this.signs[n][1] })).filter(({ x, y }) => x && y);
  }

  text() {
    const zones = this.lit().map(({ board, x, y }) => `${board.name} ${number(1 + (x > 0) + 2 * (y > 0))}`);
    return zones.length ? `zone: ${zones.join(", ")}` : "";
  }
}
