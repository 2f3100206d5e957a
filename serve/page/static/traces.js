// Subtracted output of each sensing element over the last seconds, x, y, z: volts in mV, other outputs in their unit.
import { colours, number, prepared, stroke, write } from "./canvas.js";

const WINDOW_S = 30;
const LEFT_PX = 44;
// Room for the mark of an extreme.
const TOP_PX = 14;
const BOTTOM_PX = 22;
const TICK_PX = 60;
const STEP_PX = 20;
// Smallest half range of the axis, about the noise: in mV, and of other outputs in steps of their converter.
const LEAST_MV = 20;
const LEAST_STEPS = 10;
const AXES = ["x", "y", "z"];
// Share of the axis that an extreme is marked from on: below it lies the noise.
const OUTSTANDING = 0.15;

// Keeps the frames of the last WINDOW_S; a clock that runs back starts over.
export class Traces {
  constructor(section, { accelerometers, adc_step_v }) {
    this.rows = [];
    // The elements of a sensor have one unit.
    const volts = inVolts(accelerometers[0]);
    this.scale = volts ? 1000 : 1;
    // A converter's step of 0 is not known.
    const step = adc_step_v || 1;
    this.least = volts ? LEAST_MV : LEAST_STEPS * step;
    this.digits = volts ? 0 : digitsOf(step);
    this.panels = accelerometers.map((board) => panel(section, board));
    const legend = document.createElement("span");
    legend.textContent = "▾ ▴ extremes of a slide";
    section.querySelector("figcaption").append(legend);
  }

  push({ time_s, state, subtracted_v }) {
    if (this.rows.length && time_s < this.rows.at(-1).time_s) this.rows = [];
    this.rows.push({ time_s, state, shown: Array.from(subtracted_v, (v) => this.scale * v) });
    while (this.rows[0].time_s < time_s - WINDOW_S) this.rows.shift();
  }

  draw() {
    const latest = this.rows.at(-1);
    if (!latest) return;
    let most = this.least;
    for (const row of this.rows) for (const value of row.shown) if (Math.abs(value) > most) most = Math.abs(value);
    this.panels.forEach(({ canvas, values }, board) => {
      values.forEach((value, axis) => { value.textContent = number(latest.shown[3 * board + axis], this.digits); });
      drawPanel(canvas, this.rows, 3 * board, most);
    });
  }
}

function panel(section, board) {
  const figure = document.createElement("figure");
  const caption = figure.appendChild(document.createElement("figcaption"));
  const title = caption.appendChild(document.createElement("b"));
  title.textContent = `${board.name} at (${number(board.x_mm, 1)}, ${number(board.y_mm, 1)}) mm`;
  const values = AXES.map((axis) => {
    const item = caption.appendChild(document.createElement("span"));
    item.style.color = `var(--${axis})`;
    const volts = inVolts(board);
    item.append(...(volts ? ["V", Object.assign(document.createElement("sub"), { textContent: axis })] : [axis]), " ");
    const value = item.appendChild(document.createElement("span"));
    item.append(volts ? " mV" : ` ${board.unit}`);
    return value;
  });
  const canvas = figure.appendChild(document.createElement("canvas"));
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `Subtracted output of ${board.name} over the last ${WINDOW_S} s`);
  section.append(figure);
  return { canvas, values };
}

function drawPanel(canvas, rows, first, most) {
  const { context, width, height } = prepared(canvas);
  const ink = colours();
  if (width < 2 * LEFT_PX || height < 2 * BOTTOM_PX) return;
  const end = rows.at(-1).time_s;
  const floor = height - BOTTOM_PX;
  const middle = (TOP_PX + floor) / 2;
  const x = (time_s) => width - (end - time_s) / WINDOW_S * (width - LEFT_PX);
  const y = (value) => middle - value / most * (middle - TOP_PX);

  slides(context, rows, x, floor, ink.chamber);
  const every = [5, 10, 15].find((s) => s / WINDOW_S * (width - LEFT_PX) > TICK_PX) ?? WINDOW_S;
  for (let ago = 0; ago <= WINDOW_S; ago += every) {
    stroke(context, [[x(end - ago), 0], [x(end - ago), floor]], ink.line);
    const align = ago === 0 ? "right" : "center";
    write(context, ago === 0 ? "now" : `−${ago} s`, x(end - ago), floor + 13, ink.soft, align);
  }
  const step = niceStep(most * STEP_PX / (middle - TOP_PX));
  for (let value = -step * Math.floor(most / step); value <= most; value += step) {
    stroke(context, [[LEFT_PX, y(value)], [width, y(value)]], value === 0 ? ink.soft : ink.line);
    write(context, number(value, digitsOf(step)), LEFT_PX - 6, y(value), ink.soft, "right");
  }
  for (const axis of [2, 1, 0]) {
    stroke(context, rows.map((row) => [x(row.time_s), y(row.shown[first + axis])]), ink[AXES[axis]], 1.5);
  }
  for (const { row, axis, sign } of extremes(rows, first, most)) {
    triangle(context, x(row.time_s), y(row.shown[first + axis]), sign, ink[AXES[axis]], ink.panel);
  }
}

// Of each slide the largest and the smallest V_x and V_y, which the article's method reads: once they are passed, and where
// they stand out from what else is shown.
export function extremes(rows, first, most) {
  const found = [];
  for (let begin = 0, end; begin < rows.length; begin = end + 1) {
    for (end = begin; end < rows.length && rows[end].state === "slide"; end += 1);
    for (const axis of [0, 1]) {
      for (const sign of [1, -1]) {
        const value = (n) => sign * rows[n].shown[first + axis];
        let best = begin;
        for (let n = begin; n < end; n += 1) if (value(n) > value(best)) best = n;
        const passed = begin < best && best < end - 1;
        if (passed && value(best) > OUTSTANDING * most) found.push({ row: rows[best], axis, sign });
      }
    }
  }
  return found;
}

// Outside of the line, with its tip at the extreme; outlined, so that it stands out from other lines.
function triangle(context, x, y, sign, colour, outline) {
  const away = -sign;
  context.beginPath();
  context.moveTo(x, y + away * 2);
  context.lineTo(x - 4, y + away * 9);
  context.lineTo(x + 4, y + away * 9);
  context.closePath();
  context.fillStyle = colour;
  context.fill();
  context.strokeStyle = outline;
  context.lineWidth = 1;
  context.stroke();
}

// Shades the time of the slide.
function slides(context, rows, x, floor, colour) {
  context.fillStyle = colour;
  let begun = null;
  for (const { state, time_s } of [...rows, { state: "", time_s: rows.at(-1).time_s }]) {
    if (state === "slide") begun ??= time_s;
    else if (begun !== null) {
      context.fillRect(x(begun), 0, x(time_s) - x(begun), floor);
      begun = null;
    }
  }
}

// A card from before other units were known names none.
function inVolts(board) {
  return (board.unit ?? "V") === "V";
}

// Digits after the point that numbers need to differ by `step`.
function digitsOf(step) {
  return Math.max(0, -Math.floor(Math.log10(step)));
}

// 1, 2 or 5 times a power of ten, at least `least`.
function niceStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= least);
}

