"""Works a bundle's golden example with OpenVINO and with tract, without softslide; prints {runtime: its row}."""

import json
import sys
from pathlib import Path

import numpy as np
import openvino
import tract

bundle = Path(sys.argv[1])
golden = json.loads((bundle / "model.json").read_text())["golden"]
inputs = {name: np.array(values, np.float32) for name, values in golden["inputs"].items()}
graph = str(bundle / "model.onnx")
# Where it can, OpenVINO computes in half precision unless it is asked for more.
compiled = openvino.Core().compile_model(graph, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
runnable = tract.onnx().load(graph).into_model().into_runnable()
rows = {"openvino": compiled(inputs)[0], "tract": runnable.run(list(inputs.values()))[0].to_numpy()}
print(json.dumps({name: row.ravel().tolist() for name, row in rows.items()}))
