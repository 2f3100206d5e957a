"""A graph as generated C, compiled and run as a process of its own, against ONNX Runtime."""

import copy
import shutil
import subprocess
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort
import pytest
from emx_onnx_cgen.codegen import c_emitter
from jinja2 import MemcachedBytecodeCache
from small_bundle import write_small_bundle
from streams import a_sensor

from softslide.features.card import Card, read_card
from softslide.models.export.c_code import sources
from softslide.models.export.formats import of_one_window


class _Parsed(dict):
    """Templates: the generator parses all of its own anew for each graph, which takes a second or two."""

    get, set = dict.__getitem__, dict.__setitem__


c_emitter.Environment = partial(c_emitter.Environment, bytecode_cache=MemcachedBytecodeCache(_Parsed()))
NEEDS_COMPILER = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler here")
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-O2")
SANITIZED = (*STRICT, "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
RUN = """
#include "model.h"
#include <stdio.h>
int main(void)
{{
    static float x[{width}], y[{outputs}];
    while (fread(x, sizeof x, 1, stdin) == 1) {{
        softslide_estimate({arguments}, y);
        fwrite(y, sizeof y, 1, stdout);
    }}
    return 0;
}}
"""


def any_card(folder: Path) -> Card:
    """The card that the generated code takes names, units and an example from."""
    return read_card(write_small_bundle(folder / "b", a_sensor()) / "model.json")


@dataclass(frozen=True)
class Case:
    """A graph and what it is run on."""

    graph: onnx.ModelProto
    inputs: dict[str, np.ndarray]

    def onnx_rows(self) -> np.ndarray:
        """ONNX Runtime's rows, one window at a time, as on a device."""
        session = ort.InferenceSession(self.graph.SerializeToString(), providers=["CPUExecutionProvider"])
        rows = len(next(iter(self.inputs.values())))
        return np.concatenate(
            [session.run(None, {k: v[n : n + 1] for k, v in self.inputs.items()})[0] for n in range(rows)]
        )

    def c_rows(self, folder: Path, card: Card, flags: tuple[str, ...] = STRICT) -> np.ndarray:
        """The generated code's rows, compiled and run as a process of its own."""
        example = {k: v[:1].tolist() for k, v in self.inputs.items()}
        outputs = self.graph.graph.output[0].type.tensor_type.shape.dim[1].dim_value
        golden = {"inputs": example, "estimate": [0.0] * outputs}
        # A graph of one operator has another number of outputs than a model, which a card would refuse.
        described = copy.copy(card)
        object.__setattr__(described, "golden", golden)
        files, _ = sources(of_one_window(self.graph), described)
        flat = {k: v.reshape(len(v), -1) for k, v in self.inputs.items()}
        ends = np.cumsum([v.shape[1] for v in flat.values()])
        arguments = [
            f"x[{end - 1}]" if v.shape[1] == 1 else f"x + {end - v.shape[1]}"
            for v, end in zip(flat.values(), ends, strict=True)
        ]
        files["run.c"] = RUN.format(width=ends[-1], outputs=outputs, arguments=", ".join(arguments))
        for name, text in files.items():
            (folder / name).write_text(text)
        compiled(folder, "run", flags)
        given = np.hstack(list(flat.values())).astype(np.float32).tobytes()
        done = subprocess.run([folder / "run"], input=given, capture_output=True, check=True)
        return np.frombuffer(done.stdout, np.float32).reshape(-1, outputs)


def compiled(folder: Path, name: str, flags: tuple[str, ...] = STRICT) -> None:
    command = ["cc", *flags, "model.c", f"{name}.c", "-o", name, "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert not done.returncode, done.stderr


def difference(rows: np.ndarray, wanted: np.ndarray) -> float:
    """Largest difference relative to max(1, |wanted|); NaN has to meet NaN, infinity infinity."""
    finite = np.isfinite(wanted)
    np.testing.assert_array_equal(rows[~finite], wanted[~finite])
    return float(np.max(np.abs(rows - wanted)[finite] / np.maximum(1, np.abs(wanted[finite])), initial=0.0))
