// node run_bundle.js BUNDLE [PACKAGE]
// Works a bundle's golden example with onnxruntime-node, or another package: the card and the graph are all that it
// takes.
// Prints {"estimate": {name: number}, "golden": {name: number}}, names from the card.
const fs = require("fs");
const path = require("path");
const ort = require(process.argv[3] || "onnxruntime-node");

function tensor(nested) {
  const shape = [];
  for (let level = nested; Array.isArray(level); level = level[0]) shape.push(level.length);
  return new ort.Tensor("float32", Float32Array.from(nested.flat(shape.length)), shape);
}

async function main(bundle) {
  const card = JSON.parse(fs.readFileSync(path.join(bundle, "model.json"), "utf8"));
  const session = await ort.InferenceSession.create(path.join(bundle, "model.onnx"));
  const feeds = Object.fromEntries(Object.entries(card.golden.inputs).map(([name, v]) => [name, tensor(v)]));
  const row = (await session.run(feeds)).estimate.data;
  const named = (values) => Object.fromEntries(card.outputs.map((name, n) => [name, values[n]]));
  console.log(JSON.stringify({ estimate: named(row), golden: named(card.golden.estimate) }));
}

main(process.argv[2]);
