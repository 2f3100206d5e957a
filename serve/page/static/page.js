// Shows the stream on the page: numbers with every frame, pictures with every redraw of the screen.
import { number } from "./canvas.js";
import { drawSkin } from "./skin.js";
import { follow } from "./stream.js";
import { Traces } from "./traces.js";

const byId = (id) => document.getElementById(id);
// Title, unit, digits, and the names of value, lower and upper bound.
const ESTIMATES = [
  ["direction", "deg", 1, "direction_deg", "direction_lo_deg", "direction_hi_deg"],
  ["speed", "mm/s", 2, "speed_mm_s", "speed_lo_mm_s", "speed_hi_mm_s"],
  ["offset", "mm", 2, "offset_mm", "offset_lo_mm", "offset_hi_mm"],
  ["depth", "mm", 2, "depth_mm"],
  ["x", "mm", 1, "x_mm"],
  ["y", "mm", 1, "y_mm"],
];
const DEVICE = [
  ["time", "s", 1, "time_s"],
  ["accelerometers in use", "", 0, "accelerometers"],
  ["zero shift", "mV", 1, "zero_shift_mv"],
  ["gain", "", 3, "gain"],
  ["turn", "deg", 1, "turn_deg"],
];

let sensor = null;
let latest = null;
let traces = null;
let trace = [];
let waiting = false;

const cells = [...rows(byId("estimates"), ESTIMATES, true), ...rows(byId("device"), DEVICE, false)];

function rows(body, quantities, bounded) {
  return quantities.map(([title, ...quantity]) => {
    const row = body.insertRow();
    const head = row.appendChild(document.createElement("th"));
    head.scope = "row";
    head.textContent = title;
    return [row.insertCell(), bounded ? row.insertCell() : null, ...quantity];
  });
}

function show() {
  for (const [value, interval, unit, digits, name, low, high] of cells) {
    value.textContent = number(latest[name], digits);
    if (Number.isFinite(latest[name]) && unit) value.append(` ${unit}`);
    if (!low) continue;
    const known = Number.isFinite(latest[low] + latest[high]);
    interval.textContent = known ? `${number(latest[low], digits)} … ${number(latest[high], digits)}` : "";
  }
  const estimated = Number.isFinite(latest.direction_deg);
  const trust = estimated ? latest.valid ? "valid" : "abstains" : "no estimate";
  // Written on a change only, because screen readers read these lines aloud.
  say(byId("phase"), latest.state);
  say(byId("trust"), trust, estimated ? trust : "");
  byId("estimates").className = trust === "abstains" ? "doubtful" : "";
}

function say(element, text, kind = element.className) {
  if (element.textContent !== text) element.textContent = text;
  if (element.className !== kind) element.className = kind;
}

function draw() {
  waiting = false;
  if (!sensor) return;
  drawSkin(byId("skin"), sensor, latest, trace);
  if (latest) show();
  traces.draw();
}

function drawSoon() {
  if (!waiting) requestAnimationFrame(draw);
  waiting = true;
}

follow({
  about(names) {
    sensor = names;
    latest = null;
    trace = [];
    byId("traces").replaceChildren();
    traces = new Traces(byId("traces"), names.sensor.accelerometers);
    byId("about").textContent = `${names.sensor.name}, ${names.model}, ${names.source === "-" ? "standard input" : names.source}`;
    drawSoon();
  },
  frame(record) {
    // A slide's path stays until the next one begins.
    if (record.state === "slide" && latest?.state !== "slide") trace = [];
    if (record.state === "slide" && record.valid && Number.isFinite(record.x_mm + record.y_mm)) {
      trace.push([record.x_mm, record.y_mm]);
    }
    latest = record;
    traces.push(record);
    drawSoon();
  },
  status(kind, text) {
    say(byId("connection"), text, kind);
  },
});

new ResizeObserver(drawSoon).observe(document.body);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawSoon);
