// The skin from above, to scale: x to the right, y up, in mm from the chamber's centre.
import { colours, number, prepared, stroke, write } from "./canvas.js";

const TICK_MM = 10;
// Margins: of the skin beyond the chamber, where slides begin and end; of the axes' numbers.
const MARGIN_MM = 7;
const AXIS_PX = 42;
const ARROW_MM = 9;
const WEDGE_MM = 14;

export function drawSkin(canvas, { sensor, reference_mm }, estimate, trace, zones) {
  const { context, width, height } = prepared(canvas);
  const ink = colours();
  const half = sensor.chamber_mm.map((side) => side / 2 + MARGIN_MM);
  // Hidden, or on its way to its size.
  if (Math.min(width, height) < 2 * AXIS_PX) return;
  const scale = Math.min((width - AXIS_PX) / (2 * half[0]), (height - AXIS_PX) / (2 * half[1]));
  const centre = [(width + AXIS_PX) / 2, (height - AXIS_PX) / 2];
  const at = (x, y) => [centre[0] + x * scale, centre[1] - y * scale];

  chamber(context, at, sensor.chamber_mm, half, ink);
  context.save();
  clip(context, at, half);
  quadrants(context, at, sensor.chamber_mm, zones.lit(), ink);
  path(context, at, scale, trace, ink);
  for (const place of estimate?.places ?? []) guess(context, at, scale, sensor, place, ink);
  if (estimate?.valid) motion(context, at, scale, sensor, reference_mm, estimate, ink);
  boards(context, at, sensor.accelerometers, reference_mm, ink);
  context.restore();
}

function chamber(context, at, [wide, high], half, ink) {
  const corners = (w, h) => [at(-w, -h), at(w, -h), at(w, h), at(-w, h), at(-w, -h)];
  const [left, top] = at(-wide / 2, high / 2);
  const [right, bottom] = at(wide / 2, -high / 2);
  context.fillStyle = ink.chamber;
  context.fillRect(left, top, right - left, bottom - top);
  const [leftmost, lowest] = at(-half[0], -half[1]);
  for (let mm = -TICK_MM * Math.floor(half[0] / TICK_MM); mm <= half[0]; mm += TICK_MM) {
    stroke(context, [at(mm, -half[1]), at(mm, half[1])], ink.line);
    write(context, number(mm), at(mm, 0)[0], lowest + 11, ink.soft);
  }
  for (let mm = -TICK_MM * Math.floor(half[1] / TICK_MM); mm <= half[1]; mm += TICK_MM) {
    stroke(context, [at(-half[0], mm), at(half[0], mm)], ink.line);
    write(context, number(mm), leftmost - 5, at(0, mm)[1], ink.soft, "right");
  }
  write(context, "x, mm", at(0, 0)[0], lowest + 30, ink.soft);
  context.save();
  context.translate(leftmost - 34, at(0, 0)[1]);
  context.rotate(-Math.PI / 2);
  write(context, "y, mm", 0, 0, ink.soft);
  context.restore();
  stroke(context, corners(wide / 2, high / 2), ink.soft, 1.5);
}

// The lit quadrants of the chamber around each sensing element; where several overlap they are stronger.
function quadrants(context, at, [wide, high], lit, ink) {
  context.globalAlpha = 0.2 / Math.max(1, lit.length);
  context.fillStyle = ink.zone;
  for (const { board, x, y } of lit) {
    const [across, down] = at(board.x_mm, board.y_mm);
    const [edge, end] = at(x * wide / 2, y * high / 2);
    context.fillRect(across, down, edge - across, end - down);
  }
  context.globalAlpha = 1;
}

function clip(context, at, [wide, high]) {
  const [left, top] = at(-wide, high);
  const [right, bottom] = at(wide, -high);
  context.beginPath();
  context.rect(left, top, right - left, bottom - top);
  context.clip();
}

function boards(context, at, accelerometers, [x, y], ink) {
  context.font = `600 ${context.font}`;
  for (const board of accelerometers) {
    const [left, top] = at(board.x_mm, board.y_mm);
    context.strokeStyle = ink.ink;
    context.lineWidth = 2;
    context.strokeRect(left - 6, top - 6, 12, 12);
    write(context, board.name, left, top + 17, ink.ink);
  }
  const [across, down] = at(x, y);
  stroke(context, [[across - 9, down], [across + 9, down]], ink.soft, 1.5);
  stroke(context, [[across, down - 9], [across, down + 9]], ink.soft, 1.5);
}

// The slide's line, the contact on it, and its direction. Where the model gives no position (x, y unknown), the line is
// drawn through its point nearest to the reference point, without a contact. A press has no direction, and so no line.
function motion(context, at, scale, sensor, reference, estimate, ink) {
  const angle = estimate.direction_deg * Math.PI / 180;
  const along = [Math.cos(angle), Math.sin(angle)];
  const left = [-along[1], along[0]];
  const placed = Number.isFinite(estimate.x_mm) && Number.isFinite(estimate.y_mm);
  const place = placed ? [estimate.x_mm, estimate.y_mm] : reference.map((mm, k) => mm + estimate.offset_mm * left[k]);
  if (!Number.isFinite(angle)) {
    if (placed) contact(context, at(...place), sensor.indenter_diameter_mm / 2 * scale, ink);
    return;
  }
  const point = (forward, aside) => at(...place.map((mm, k) => mm + forward * along[k] + aside * left[k]));
  const aside = [estimate.offset_lo_mm, estimate.offset_hi_mm].map((mm) => mm - estimate.offset_mm);

  stroke(context, [point(-200, 0), point(200, 0)], ink.soft, 1, [3, 5]);
  wedge(context, at(...place), WEDGE_MM * scale, estimate, ink.mark);
  if (placed) contact(context, at(...place), sensor.indenter_diameter_mm / 2 * scale, ink);
  stroke(context, [point(0, 0), point(ARROW_MM, 0)], ink.mark, 2.5);
  stroke(context, [point(ARROW_MM - 2, 1.4), point(ARROW_MM, 0), point(ARROW_MM - 2, -1.4)], ink.mark, 2.5);
  if (aside.every(Number.isFinite)) {
    stroke(context, aside.map((mm) => point(0, mm)), ink.ink, 2);
    for (const mm of aside) stroke(context, [point(-0.8, mm), point(0.8, mm)], ink.ink, 2);
  }
}

// The contact's path, and as wide as its 90 % interval a band of ellipses. A gap, null, is where nothing was valid.
function path(context, at, scale, trace, ink) {
  context.globalAlpha = 0.08;
  context.fillStyle = ink.mark;
  for (const point of trace) {
    if (!point || !Number.isFinite(point[2] + point[3])) continue;
    context.beginPath();
    context.ellipse(...at(point[0], point[1]), point[2] * scale, point[3] * scale, 0, 0, 2 * Math.PI);
    context.fill();
  }
  context.globalAlpha = 1;
  let piece = [];
  for (const point of [...trace, null]) {
    if (point) piece.push(at(point[0], point[1]));
    else {
      stroke(context, piece, ink.mark, 3);
      piece = [];
    }
  }
}

// The object's footprint, to scale and translucent.
function contact(context, [x, y], radius, ink) {
  const faint = context.globalAlpha;
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.globalAlpha = 0.7 * faint;
  context.fillStyle = ink.panel;
  context.fill();
  context.globalAlpha = faint;
  context.strokeStyle = ink.mark;
  context.lineWidth = 2;
  context.stroke();
}

// One of several places where the contact may be: the object's outline, dashed, the stronger the likelier.
function guess(context, at, scale, { indenter_diameter_mm }, [x, y, weight], ink) {
  const [across, down] = at(x, y);
  const radius = indenter_diameter_mm / 2 * scale;
  context.beginPath();
  context.arc(across, down, radius, 0, 2 * Math.PI);
  context.globalAlpha = 0.4 * weight;
  context.fillStyle = ink.mark;
  context.fill();
  context.globalAlpha = 0.35 + 0.65 * weight;
  context.setLineDash([4, 3]);
  context.strokeStyle = ink.mark;
  context.lineWidth = 2;
  context.stroke();
  context.setLineDash([]);
  context.globalAlpha = 1;
}

function wedge(context, [x, y], radius, estimate, colour) {
  const [low, high] = [estimate.direction_lo_deg, estimate.direction_hi_deg].map((deg) => -deg * Math.PI / 180);
  if (!Number.isFinite(low + high)) return;
  const faint = context.globalAlpha;
  context.beginPath();
  context.moveTo(x, y);
  context.arc(x, y, radius, low, low - high >= 2 * Math.PI ? low - 2 * Math.PI : high, true);
  context.closePath();
  context.globalAlpha = 0.3 * faint;
  context.fillStyle = colour;
  context.fill();
  context.globalAlpha = faint;
  stroke(context, [[x + radius * Math.cos(low), y + radius * Math.sin(low)], [x, y],
    [x + radius * Math.cos(high), y + radius * Math.sin(high)]], colour, 1);
}
