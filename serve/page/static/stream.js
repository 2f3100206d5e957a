// The stream as the server sends it (serve/page/server.py): a description once, then one frame for each request.
const RETRY_MS = 1000;

// Connects, and reconnects for as long as the page is open. about(text as an object), frame(record),
// status(word, said): "live", "silent", "ended" or "lost".
export function follow({ about, frame, status }, ended = false) {
  const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/stream`);
  socket.binaryType = "arraybuffer";
  let names = null;
  let last = null;
  socket.onmessage = ({ data }) => {
    if (typeof data === "string") {
      names = JSON.parse(data);
      about(names);
      status("silent", "no samples yet");
    } else if (data.byteLength) {
      const record = decoded(data, names);
      // Without new samples the last frame comes again, or one that says so.
      const fresh = record.time_s !== last && record.reason !== "no_signal";
      if (record.time_s !== last) frame(record);
      last = record.time_s;
      status(fresh ? "live" : "silent", fresh ? "live" : "no samples come");
    }
    socket.send("");
  };
  socket.onclose = ({ wasClean }) => {
    // After an end a closed connection is expected.
    const over = names ? wasClean : ended;
    status(over ? "ended" : "lost", over ? "the stream has ended; waiting for the next" : "no connection; trying again");
    setTimeout(follow, RETRY_MS, { about, frame, status }, over);
  };
}

// The frames that the server has kept, oldest first.
export async function kept(names) {
  const all = await (await fetch("frames")).arrayBuffer();
  const size = 8 + 4 * (1 + names.numbers.length + names.channels.length);
  return Array.from({ length: Math.floor(all.byteLength / size) }, (_, n) => decoded(all.slice(n * size, (n + 1) * size), names));
}

// time_s as float64, then float32: the state's index, the numbers by name (of a word its index), the channels in V.
function decoded(buffer, { numbers, states, words }) {
  const values = new Float32Array(buffer, 8);
  const record = { time_s: new Float64Array(buffer, 0, 1)[0], state: states[values[0]] };
  numbers.forEach((name, n) => { record[name] = words[name] ? words[name][values[1 + n]] : values[1 + n]; });
  record.places = numbers.filter((name) => /^place_\d+_x_mm$/.test(name))
    .map((x) => [record[x], record[x.replace("x_mm", "y_mm")], record[x.replace("x_mm", "weight")]])
    .filter((place) => place.every(Number.isFinite));
  record.zero_shift_mv = 1000 * record.zero_shift_v;
  record.subtracted_v = values.subarray(1 + numbers.length);
  return record;
}
