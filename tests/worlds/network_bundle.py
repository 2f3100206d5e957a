"""A network that was not trained over a response map, and a bundle of it."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from small_bundle import write_bundle_of

from softslide.features.window import WINDOW_BINS
from softslide.models.cnn.gauss_newton import Refinement
from softslide.models.cnn.network import NetworkConfig, Proposal, SlideNetwork
from softslide.models.graph.from_torch import export_graph
from softslide.models.response_map.map import ResponseMap
from softslide.pipeline.sensor import Sensor


def untrained(response: ResponseMap) -> SlideNetwork:
    """Of one sensing element; always the same weights."""
    torch.manual_seed(0)
    config = NetworkConfig()
    proposal = Proposal(response.channels, 1, config)
    return SlideNetwork(proposal, Refinement(response, 0.02, config.refinement)).eval()


def a_window() -> dict[str, np.ndarray]:
    """One window of one sensing element: a bump in each channel."""
    volts = 0.05 * np.random.default_rng(0).standard_normal((1, 3, 1)) * np.hanning(WINDOW_BINS)
    inputs = {"volts": volts, "elapsed_s": np.full(1, 8.0), "weight": np.ones((1, 1))}
    return {name: value.astype(np.float32) for name, value in inputs.items()}


def write_network_bundle(folder: Path, response: ResponseMap, sensor: Sensor, **card: Any) -> Path:
    """As `write_bundle_of`, of the untrained network."""
    network = untrained(response)
    graph = export_graph(network, 1).SerializeToString()
    return write_bundle_of(folder, graph, a_window(), sensor, model="cnn", outputs=network.outputs, **card)
