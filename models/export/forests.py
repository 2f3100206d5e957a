"""Forests as standard operators: all trees go down a level at a time, by Gather and Where."""

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np
import onnx
from onnx import helper, numpy_helper


def without_forests(model: onnx.ModelProto) -> onnx.ModelProto:
    """The same graph with each TreeEnsembleRegressor, of one window (1, F), as standard operators.

    Raises:
        ValueError: comparisons other than <=, missing values, averages or a transform.
    """
    plain = onnx.ModelProto()
    plain.CopyFrom(model)
    del plain.graph.node[:]
    for node in model.graph.node:
        nodes, constants = _descent(node) if node.op_type == "TreeEnsembleRegressor" else ([node], [])
        plain.graph.node.extend(nodes)
        plain.graph.initializer.extend(constants)
    return plain


def _descent(forest: onnx.NodeProto) -> tuple[list[onnx.NodeProto], list[onnx.TensorProto]]:
    """The nodes that compute the forest, and their tables."""
    attributes = {a.name: helper.get_attribute_value(a) for a in forest.attribute}
    tables, depth = _tables(attributes)
    name = forest.output[0]
    constants = [numpy_helper.from_array(value, f"{name}/{key}") for key, value in tables.items()]
    nodes: list[onnx.NodeProto] = []

    def op(kind: str, *inputs: str, **more: Any) -> str:
        nodes.append(helper.make_node(kind, inputs, [f"{name}/{len(nodes)}"], **more))
        return nodes[-1].output[0]

    def at(key: str, place: str) -> str:
        return op("Gather", f"{name}/{key}", place)

    x = op("Reshape", forest.input[0], f"{name}/flat")
    place = f"{name}/roots"
    for _ in range(depth):
        goes_on = op("LessOrEqual", op("Gather", x, at("feature", place)), at("bound", place))
        place = op("Where", goes_on, at("yes", place), at("no", place))
    total = op("ReduceSum", at("weights", at("leaf", place)), f"{name}/trees", keepdims=1)
    nodes.append(helper.make_node("Add", [total, f"{name}/base"], [name]))
    return nodes, constants


def _tables(attributes: Mapping[str, Any]) -> tuple[dict[str, np.ndarray], int]:
    """A node's feature, bound and next nodes; a leaf's next node is itself. And how many levels the trees have."""
    if (
        set(attributes["nodes_modes"]) - {b"BRANCH_LEQ", b"LEAF"}
        or any(attributes.get("nodes_missing_value_tracks_true", ()))
        or attributes.get("post_transform", b"NONE") != b"NONE"
        or attributes.get("aggregate_function", b"SUM") != b"SUM"
    ):
        raise ValueError("more than sums of <= branches")
    keys = zip(attributes["nodes_treeids"], attributes["nodes_nodeids"], strict=True)
    row = {key: n for n, key in enumerate(keys)}
    trees = np.array(attributes["nodes_treeids"])
    own = np.arange(len(row))
    is_leaf = np.array([mode == b"LEAF" for mode in attributes["nodes_modes"]])
    yes, no = (
        np.where(is_leaf, own, [row.get((t, n), 0) for t, n in zip(trees, attributes[key], strict=True)])
        for key in ("nodes_truenodeids", "nodes_falsenodeids")
    )
    # Every exporter lists a tree's root first.
    roots = np.unique(trees, return_index=True)[1]
    leaf = np.cumsum(is_leaf) - 1
    weights = np.zeros((is_leaf.sum(), attributes["n_targets"]), np.float32)
    targets = (attributes[f"target_{key}"] for key in ("treeids", "nodeids", "ids", "weights"))
    for tree, node, target, weight in zip(*targets, strict=True):
        weights[leaf[row[tree, node]], target] += weight
    tables = {
        "feature": np.where(is_leaf, 0, attributes["nodes_featureids"]).astype(np.int32),
        "bound": np.array(attributes["nodes_values"], np.float32),
        "yes": yes.astype(np.int32),
        "no": no.astype(np.int32),
        "leaf": leaf.astype(np.int32),
        "roots": roots.astype(np.int32),
        "weights": weights,
        "base": np.array(attributes.get("base_values") or [0.0] * weights.shape[1], np.float32),
        "flat": np.array([-1]),
        "trees": np.array([0]),
    }
    return tables, _levels(roots, yes, no)


def _levels(roots: np.ndarray, yes: np.ndarray, no: np.ndarray) -> int:
    """Steps after which every tree is at a leaf, whatever the way."""
    nodes = roots
    for level in itertools.count():
        further = np.unique(np.concatenate([yes[nodes], no[nodes]]))
        if np.array_equal(further, np.unique(nodes)):
            return level
        nodes = further
    raise AssertionError
