"""Storage in half precision and in bytes: the same answers to the last bit, and nothing that it would round."""

import numpy as np
import onnx
import onnxruntime as ort
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper

from softslide.models.graph.packing import LEAST, pack, rounded, rounded_weights, unpack


def dense(weights: np.ndarray) -> onnx.ModelProto:
    """y = x W, W (n, m)."""
    n, m = weights.shape
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["x", "w"], ["y"])],
        "dense",
        [helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, n])],
        [helper.make_tensor_value_info("y", TensorProto.FLOAT, [1, m])],
        [numpy_helper.from_array(weights, "w")],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)


def weights(*shape: int) -> np.ndarray:
    return np.random.default_rng(0).normal(size=shape).astype(np.float32)


def answer(model: onnx.ModelProto) -> np.ndarray:
    onnx.checker.check_model(model, full_check=True)
    x = weights(1, 32)
    return ort.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"]).run(
        None, {"x": x}
    )[0]


def packs_exactly(model: onnx.ModelProto, share: float) -> None:
    """Packed it takes less than this share of its bytes; packed and unpacked it answers as before, to the bit."""
    plain, size = answer(model), len(model.SerializeToString())
    pack(model)
    assert len(model.SerializeToString()) < share * size
    np.testing.assert_array_equal(answer(model), plain)
    unpack(model)
    assert len(model.SerializeToString()) == size
    np.testing.assert_array_equal(answer(model), plain)


def test_packing_halves_the_bytes_and_changes_no_bit():
    packs_exactly(dense(rounded(torch.tensor(weights(32, 64))).numpy()), 0.55)


@pytest.mark.parametrize("silent", [[], [3]])
def test_weights_of_eight_bits_take_a_quarter_and_change_no_bit(silent):
    rounded_to = rounded_weights(torch.tensor(weights(32, 64))).numpy()
    rounded_to[silent] = 0.0
    packs_exactly(dense(rounded_to), 0.32)


@pytest.mark.parametrize("shape", [(32, 64), (24, 8, 5)])
def test_eight_bits_are_off_by_half_a_step_of_the_row_at_most(shape):
    value = weights(*shape)
    value[5] *= 1000.0
    off = np.abs(rounded_weights(torch.tensor(value)).numpy() - value).reshape(shape[0], -1)
    assert (off.max(axis=1) <= 0.51 * np.abs(value).reshape(shape[0], -1).max(axis=1) / 127).all()


def test_doubles_are_stored_in_the_least_precision_that_holds_them():
    """1, 1 + 2^-20 and 1/3 need 2, 4 and 8 bytes each."""
    for value, size in ((1.0, 2), (1.0 + 2.0**-20, 4), (1 / 3, 8)):
        x = helper.make_tensor_value_info("x", TensorProto.DOUBLE, [1])
        y = helper.make_tensor_value_info("y", TensorProto.DOUBLE, [1000])
        constant = numpy_helper.from_array(np.full(1000, value), "w")
        graph = helper.make_graph([helper.make_node("Add", ["x", "w"], ["y"])], "sum", [x], [y], [constant])
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
        before = model.SerializeToString()
        pack(model)
        assert abs(len(model.SerializeToString()) - 1000 * size) < 200
        session = ort.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
        assert (session.run(None, {"x": np.zeros(1)})[0] == value).all()
        unpack(model)
        assert model.SerializeToString() == before


def test_what_would_be_rounded_or_is_small_stays():
    for values in (
        weights(32, 64),
        1e6 * rounded(torch.tensor(weights(32, 64))).numpy(),
        np.ones((32, LEAST // 32 - 1), np.float32),
    ):
        model = dense(values)
        before = model.SerializeToString()
        pack(model)
        assert model.SerializeToString() == before


def test_rounding_keeps_eleven_bits():
    values = torch.tensor(weights(1000))
    assert ((rounded(values) - values).abs() <= values.abs() * 2.0**-11 + 2.0**-25).all()
