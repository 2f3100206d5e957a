"""C99 from a graph: emx-onnx-cgen writes the operators, this file the frame: model.h, shared memory, check.c.

The library gives every value between two operators an array of its own on the stack. Here they lie in static
arrays, and two that are never alive together share their place: 20 kB in place of 194 for the default network.
"""

import re
import textwrap
from collections import Counter
from collections.abc import Callable
from math import prod
from typing import Any, NamedTuple

import numpy as np
import onnx
from emx_onnx_cgen import CodegenError, Compiler, ShapeInferenceError, UnsupportedOpError
from emx_onnx_cgen.compiler import CompilerOptions
from onnx.helper import (
    get_attribute_value,
    make_attribute,
    make_graph,
    make_model,
    make_node,
    make_tensor_value_info,
)
from onnx.numpy_helper import from_array, to_array

from softslide.features.card import UNITS, Card
from softslide.features.vector.feature_vector import feature_names

INDENT = "    "
PER_LINE = 8  # numbers
FUNCTION = re.compile(r"^void graph\((.*?)\) \{\n(.*?)^\}", re.MULTILINE | re.DOTALL)
LOCAL = re.compile(r"^    (\w+) (tmp\w+)(\[\d+\])((?:\[\d+\])*);$")
PLAIN = re.compile(rb"[\w\s.,>-]*")  # cannot end a comment
SIZES = {"float": 4, "double": 8, "int64_t": 8, "int32_t": 4}  # bytes; all else is counted as 1
# GCC 12 at -O2 drops calls whose arrays share memory, once it has put their addresses into the functions.
EACH_BY_ITSELF = """\
#if defined(__GNUC__) && !defined(__clang__)
#define EMX_NODE_FN static __attribute__((noipa))
#endif
"""


class Local(NamedTuple):
    """A value between two operators: its type in C, how many numbers it holds, all of its sizes but the first as C
    writes them, and the calls that it is alive in."""

    kind: str
    size: int
    inner: str
    first: int
    last: int


def sources(model: onnx.ModelProto, card: Card) -> tuple[dict[str, str], dict[str, Any]]:
    """File names with their text; and what the code needs: kB of constants and of static memory, steps by operator.

    model: of one window, every size known.

    Raises:
        ValueError: an operator that has no form in C, or one with a text that C might read.
    """
    options = CompilerOptions(model_name="graph", large_temp_threshold_bytes=0, large_weight_threshold=0)
    try:
        text = Compiler(options).compile(_without_texts(model))
    except (CodegenError, ShapeInferenceError, UnsupportedOpError) as error:
        raise ValueError(str(error)) from None
    inputs = {value.name: _shape(value) for value in model.graph.input}
    text, static_bytes = _sharing_memory(text, list(inputs))
    output = prod(_shape(model.graph.output[0]))
    signature = _signature(inputs, output)
    body = f"{signature}\n{{\n{INDENT}graph({_casts(inputs, output)});\n}}\n"
    files = {
        "model.c": f'#include "model.h"\n{EACH_BY_ITSELF}{text}\n{body}',
        "model.h": _header(signature, card),
        "check.c": _check(inputs, card),
    }
    constants = (to_array(item).nbytes for item in model.graph.initializer)
    figures = {
        "constants_kb": sum(constants) / 1e3,
        "static_ram_kb": static_bytes / 1e3,
        "operators": dict(sorted(Counter(node.op_type for node in model.graph.node).items())),
    }
    return files, figures


def _without_texts(model: onnx.ModelProto) -> onnx.ModelProto:
    """The graph with numbers for names, but for its inputs and outputs, and none of its other texts: the library writes
    them into comments, which a text could end.

    Raises:
        ValueError: an operator's attribute has a text that is not plain.
    """
    graph = model.graph
    kept = {"", *(value.name for value in (*graph.input, *graph.output))}
    names: dict[str, str] = {}

    def short(name: str) -> str:
        return name if name in kept else names.setdefault(name, f"v{len(names)}")

    inputs, outputs = (
        [make_tensor_value_info(v.name, v.type.tensor_type.elem_type, _shape(v)) for v in values]
        for values in (graph.input, graph.output)
    )
    constants = [from_array(to_array(item), short(item.name)) for item in graph.initializer]
    nodes = [_plain(node, short) for node in graph.node]
    plain = make_graph(nodes, "graph", inputs, outputs, constants)
    return make_model(plain, opset_imports=model.opset_import, ir_version=model.ir_version)


def _plain(node: onnx.NodeProto, short: Callable[[str], str]) -> onnx.NodeProto:
    """The operator with short names for its values."""
    inputs, outputs = (list(map(short, given)) for given in (node.input, node.output))
    plain = make_node(node.op_type, inputs, outputs, domain=node.domain)
    for attribute in node.attribute:
        texts = (attribute.name.encode(), attribute.s, *attribute.strings)
        if not all(map(PLAIN.fullmatch, texts)):
            raise ValueError(f"{node.op_type} with the text {b' '.join(texts)!r}")
        value = get_attribute_value(attribute)
        if isinstance(value, onnx.TensorProto):
            value = from_array(to_array(value))
        plain.attribute.append(make_attribute(attribute.name, value, attr_type=attribute.type))
    return plain


def _sharing_memory(text: str, inputs: list[str]) -> tuple[str, int]:
    """The text with `graph`'s local arrays in static ones, shared by what is not alive together; and their bytes."""
    found = FUNCTION.search(text)
    assert found is not None
    lines = found[2].splitlines()
    calls = [line for line in lines if not LOCAL.match(line)]
    named = [set(re.findall(r"\btmp\w+", call)) for call in calls]
    local = {}
    for kind, name, outer, inner in (match.groups() for match in map(LOCAL.match, lines) if match):
        alive = [n for n, names in enumerate(named) if name in names]
        size = prod(map(int, re.findall(r"\d+", outer + inner)))
        local[name] = Local(kind, size, inner, alive[0], alive[-1])
    offsets, sizes = _layout(local)
    static = [f"static {kind} work_{kind}[{size}];" for kind, size in sizes.items()]
    places = [
        f"{INDENT}{v.kind} (*{name}){v.inner} = (void *)(work_{v.kind} + {offsets[name]});"
        for name, v in local.items()
    ]
    used = [f"{INDENT}(void){name};" for name in inputs]
    function = "\n".join(["static " + found[0].split("\n", 1)[0], *places, *used, *calls, "}"])
    before = text[: found.start()].replace("_Bool model_load", "static inline _Bool model_load")
    static_bytes = sum(size * SIZES.get(kind, 1) for kind, size in sizes.items())
    return "\n".join([before, *static, function, text[found.end() :]]), static_bytes


def _layout(local: dict[str, Local]) -> tuple[dict[str, int], dict[str, int]]:
    """Where each value begins in its type's array, the largest placed first, and each array's size: in numbers."""
    offsets: dict[str, int] = {}
    sizes: dict[str, int] = {}
    for name, value in sorted(local.items(), key=lambda item: -item[1].size):
        taken = sorted(
            (offsets[other], offsets[other] + v.size)
            for other, v in local.items()
            if other in offsets and v.kind == value.kind and v.first <= value.last and value.first <= v.last
        )
        begin = 0
        for start, end in taken:
            if begin + value.size <= start:
                break
            begin = max(begin, end)
        offsets[name] = begin
        sizes[value.kind] = max(sizes.get(value.kind, 0), begin + value.size)
    return offsets, sizes


def _shape(value: onnx.ValueInfoProto) -> list[int]:
    return [size.dim_value for size in value.type.tensor_type.shape.dim]


def _signature(inputs: dict[str, list[int]], output: int) -> str:
    given = [
        f"float {name}" if prod(shape) == 1 else f"const float {name}[{prod(shape)}]"
        for name, shape in inputs.items()
    ]
    return f"void softslide_estimate({', '.join(given)}, float estimate[{output}])"


def _casts(inputs: dict[str, list[int]], output: int) -> str:
    """The flat arguments as the arrays that `graph` takes."""
    given = [
        f"(const float (*){''.join(f'[{n}]' for n in shape[1:])}){'&' * (prod(shape) == 1)}{name}"
        for name, shape in inputs.items()
    ]
    return ", ".join([*given, f"(float (*)[{output}])estimate"])


def _array(name: str, values: np.ndarray) -> str:
    numbers = [f"{value:.9e}f" for value in values]
    lines = [", ".join(numbers[n : n + PER_LINE]) for n in range(0, len(numbers), PER_LINE)]
    joined = f",\n{INDENT}".join(lines)
    return f"static const float {name}[{len(values)}] = {{\n{INDENT}{joined}}};"


def _header(signature: str, card: Card) -> str:
    columns = "\n".join(f"    SOFTSLIDE_{name.upper()}, /* {UNITS[name]} */" for name in card.outputs)
    return f"""\
/* What slides over {card.sensor["name"]}: direction, speed and place, by the model '{card.model}'.

{textwrap.indent(_inputs(card), "   ")}
   estimate: {len(card.outputs)} numbers, by the names below, with their units.

   What may be believed, and its 90 % intervals, model.json says. No heap, nothing but math.h; the work is done in
   static arrays, so one call at a time. Generated by softslide export. */
#ifndef SOFTSLIDE_MODEL_H
#define SOFTSLIDE_MODEL_H

#ifdef __cplusplus
extern "C" {{
#endif

enum {{
{columns}
}};

{signature};

#ifdef __cplusplus
}}
#endif

#endif
"""


def _inputs(card: Card) -> str:
    boards = len(card.channels) // 3
    if card.input == "features":
        names = textwrap.fill(", ".join(feature_names(boards)), 100, subsequent_indent="  ")
        return f"features: of the slide so far, in this order (suffixes: _v V, _s s)\n  {names}"
    base = "  What base in model.json says of the base's motion is taken out first.\n" if card.base else ""
    return (
        f"volts: the slide so far in 64 equal bins of time, V less the static output: 64 of {card.channels[0]}, then\n"
        f"  64 of {card.channels[1]}, and so on in the card's order.\n"
        f"{base}"
        "elapsed_s: time since the slide began, s.\n"
        "weight: 1 for an accelerometer in use, 0 for one that is not."
    )


def _check(inputs: dict[str, list[int]], card: Card) -> str:
    """A program that ends with 0 if the code computes the card's example."""
    given = {name: np.array(card.golden["inputs"][name], np.float32).ravel() for name in inputs}
    wanted = np.array(card.golden["estimate"], np.float32)
    arrays = "\n".join(_array(name, values) for name, values in {**given, "wanted": wanted}.items())
    arguments = [f"{name}[0]" if value.size == 1 else name for name, value in given.items()]
    return f"""\
/* Works the example of model.json: prints what came out and what should, ends with 0 if they agree. */
#include "model.h"
#include <math.h>
#include <stdio.h>

{arrays}

int main(void)
{{
    float estimate[{wanted.size}];
    int wrong = 0;
    softslide_estimate({", ".join(arguments)}, estimate);
    for (int n = 0; n < {wanted.size}; n++) {{
        printf("%g %g\\n", (double)estimate[n], (double)wanted[n]);
        wrong += !(fabsf(estimate[n] - wanted[n]) <= 1e-3f * fmaxf(1, fabsf(wanted[n])));
    }}
    return wrong;
}}
"""
