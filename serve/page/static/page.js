// Shows the stream on the page: numbers with every frame, pictures with every redraw of the screen.
import { number } from "./canvas.js";
import { drawSkin } from "./skin.js";
import { follow, kept } from "./stream.js";
import { Traces } from "./traces.js";
import { Zones } from "./zones.js";

const byId = (id) => document.getElementById(id);
// Title, unit, digits, and the names of value, lower and upper bound.
const ESTIMATES = [
  ["direction", "deg", 1, "direction_deg", "direction_lo_deg", "direction_hi_deg"],
  ["speed", "mm/s", 2, "speed_mm_s", "speed_lo_mm_s", "speed_hi_mm_s"],
  ["offset", "mm", 2, "offset_mm", "offset_lo_mm", "offset_hi_mm"],
  ["depth", "mm", 2, "depth_mm", "depth_lo_mm", "depth_hi_mm"],
  ["x", "mm", 1, "x_mm", "x_lo_mm", "x_hi_mm"],
  ["y", "mm", 1, "y_mm", "y_lo_mm", "y_hi_mm"],
  ["force", "mN", 0, "force_mn", "force_lo_mn", "force_hi_mn"],
];
const DEVICE = [
  ["time", "s", 1, "time_s"],
  ["accelerometers in use", "", 0, "accelerometers"],
  ["zero shift", "mV", 1, "zero_shift_mv"],
  ["gain", "", 3, "gain"],
  ["turn", "deg", 1, "turn_deg"],
];

// What is shown of an estimate that is not valid, by its reason.
const REASONS = {
  no_contact: "nothing touches the skin",
  unknown_zero: "the static output is not known yet: leave the skin alone",
  too_early: "the contact has not moved enough yet",
  ambiguous: "several places or headings explain the output",
  off_map: "outside of what the calibration covers",
  not_this_sensor: "the output fits no contact on this skin",
  strength: "weaker than any contact",
  drift: "gravity's length has changed: the sensor has drifted",
  dead_channel: "a sensing element is lost, frozen or clipped",
  skin_height: "the skin stands at another height than in the calibration: check the pressure",
  attitude: "gravity shows the sensor turned from how it was calibrated",
  no_signal: "no samples come",
};
// Points of the path that are kept; a contact of four minutes.
const LONGEST_PATH = 10000;

let sensor = null;
let latest = null;
let traces = null;
let trace = [];
let zones = null;
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
    // Numbers of an estimate that is not valid are no estimate, and without a slide no accelerometer is chosen.
    const hidden = interval ? !latest.valid : name === "accelerometers" && !latest[name];
    const shown = hidden ? NaN : latest[name];
    const [scaled, written] = unit === "mV" ? inUnit(shown) : [shown, unit];
    value.textContent = number(scaled, digits);
    if (Number.isFinite(shown) && written) value.append(` ${written}`);
    if (!interval) continue;
    const known = low && Number.isFinite(shown + latest[low] + latest[high]);
    interval.textContent = known ? `${number(latest[low], digits)} … ${number(latest[high], digits)}` : "";
  }
  const estimated = latest.valid || Number.isFinite(latest.direction_deg);
  const trust = latest.valid ? "valid" : estimated ? "abstains" : "no estimate";
  // Written on a change only, because screen readers read these lines aloud.
  say(byId("phase"), latest.valid && latest.contact === "press" ? "press" : latest.state);
  say(byId("trust"), trust, estimated ? trust : "");
  say(byId("zones"), zones.text());
  say(byId("reason"), latest.valid ? "" : REASONS[latest.reason] ?? latest.reason);
  say(byId("places"), latest.places.map(([x, y, weight]) =>
    `${number(100 * weight)} % at x ${number(x, 1)}, y ${number(y, 1)} mm`).join("; "));
}

// Thousandths of the outputs' unit: mV, or of another unit it itself.
function inUnit(value) {
  const { unit = "V" } = sensor.sensor.accelerometers[0];
  return unit === "V" ? [value, "mV"] : [value / 1000, unit];
}

function say(element, text, kind = element.className) {
  if (element.textContent !== text) element.textContent = text;
  if (element.className !== kind) element.className = kind;
}

function draw() {
  waiting = false;
  if (!sensor) return;
  drawSkin(byId("skin"), sensor, latest, trace, zones);
  if (latest) show();
  traces.draw();
}

function drawSoon() {
  if (!waiting) requestAnimationFrame(draw);
  waiting = true;
}

function clear() {
  latest = null;
  trace = [];
  byId("traces").replaceChildren();
  traces = new Traces(byId("traces"), sensor.sensor);
  zones = new Zones(sensor.sensor.accelerometers);
}

// Takes a frame in: the numbers, the path and the traces.
function take(record) {
  // A contact's path stays until the next one begins.
  const touched = (r) => r && r.contact !== "none";
  if (touched(record) && !touched(latest)) trace = [];
  if (touched(record)) {
    const halves = ["x", "y"].map((axis) => (record[`${axis}_hi_mm`] - record[`${axis}_lo_mm`]) / 2);
    const known = record.valid && Number.isFinite(record.x_mm + record.y_mm);
    if (known || trace.at(-1)) trace.push(known ? [record.x_mm, record.y_mm, ...halves] : null);
    if (trace.length > LONGEST_PATH) trace.shift();
  }
  latest = record;
  traces.push(record);
  zones.push(record);
  drawSoon();
}

// What was estimated last is not true any more: no samples come, or nothing at all.
function silence() {
  if (trace.at(-1)) trace.push(null);
  latest = { ...latest, valid: 0, reason: "no_signal", places: [] };
  zones.clear();
  drawSoon();
}

// What is shown: "live" what comes, "pause" what there was, "replay" what the server has kept, from its beginning.
let mode = "live";

function switchTo(next) {
  mode = mode === next ? "live" : next;
  for (const name of ["pause", "replay"]) byId(name).ariaPressed = String(mode === name);
  return mode === next;
}

byId("pause").onclick = () => switchTo("pause");
byId("zero").onclick = () => fetch("zero", { method: "POST" });
byId("replay").onclick = async () => {
  if (!switchTo("replay")) return;
  const records = await kept(sensor);
  clear();
  const begun = performance.now();
  let next = 0;
  const step = () => {
    if (mode !== "replay") return;
    const until = records[0]?.time_s + (performance.now() - begun) / 1000;
    // A clock that runs back is a stream that began anew: it goes on at once.
    while (next < records.length && (records[next].time_s <= until || records[next].time_s < records[next - 1]?.time_s)) take(records[next++]);
    if (next < records.length) setTimeout(step, 20);
    else switchTo("replay");
  };
  step();
};

follow({
  about(names) {
    sensor = names;
    clear();
    const { kind } = names.sensor.accelerometers[0];
    // A card from before other kinds were known names none.
    const element = kind === "other" ? "sensing element" : kind ?? "accelerometer";
    byId("element").textContent = element;
    byId("device").rows[1].cells[0].textContent = `${element}s in use`;
    byId("about").textContent = `${names.sensor.name}, ${names.model}, ${names.source === "-" ? "standard input" : names.source}`;
    drawSoon();
  },
  frame(record) {
    if (mode === "live") take(record);
  },
  status(kind, text) {
    say(byId("connection"), text, kind);
    if (kind !== "live" && mode === "live" && latest) silence();
  },
});

new ResizeObserver(drawSoon).observe(document.body);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawSoon);
