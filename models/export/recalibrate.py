"""A bundle with the gains of its response map renewed, without training: graph, card, example and hashes."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import numpy_helper

from softslide.features.card import Card, write_card
from softslide.features.errors import InputError
from softslide.models.cnn.forward_model import TABLE
from softslide.models.cnn.height_input import SLOPE
from softslide.models.export.bundle import read_graph, with_graph
from softslide.models.export.gains import Gains, fit_gains, labelled_contacts
from softslide.models.graph.packing import pack
from softslide.models.response_map.card import contact_calibration, response_of, with_gains
from softslide.models.response_map.slides import static_outputs
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.staging import staged
from softslide.serve.bundle import open_bundle


def recalibrated(bundle: Path, folder: Folder, out: Path, data: dict[str, str]) -> dict[str, Any]:
    """Fits the bundle's map to the gains that the folder's strokes and presses show, and writes the bundle anew.

    data: hashes of the recordings, for the card. Returns what was found, for people to read.

    The zero needs no such step: a stream's own static output is subtracted, whatever it is that day.

    Raises:
        InputError: the bundle is not valid or holds no response map, the sensor is another one, or no recording is
            labelled as a stroke or a press.
    """
    card, _ = open_bundle(bundle)
    path = bundle / "model.onnx"
    if card.contact is None or not path.is_file():
        raise InputError(f"{bundle}: holds no response map to renew; name a cnn bundle that 'train' wrote")
    if folder.sensor.channels != card.channels:
        raise InputError(
            f"{folder.root / 'sensor.toml'}: channels are {', '.join(folder.sensor.channels)}, the bundle's "
            f"{', '.join(card.channels)}; record with the bundle's sensor"
        )
    if card.base is not None and folder.sensor.base is None:
        raise InputError(
            f"{folder.root / 'sensor.toml'}: has no [base], which the bundle reads; record it too"
        )
    folder = replace(folder, base_motion=card.base)
    slides, presses, left_out = labelled_contacts(folder, card.conditioning, card.heights)
    if not slides and not presses:
        raise InputError(
            f"{folder.root / 'manifest.csv'}: no stroke with all its labels after a rest, and no press with its "
            "place and moments; label one"
        )
    gains = fit_gains(response_of(card), slides, presses)
    graph = _with_gains(read_graph(bundle), gains, path).SerializeToString()
    found = _summary(card, gains, len(slides), len(presses), left_out)
    with staged(out) as made:
        (made / "model.onnx").write_bytes(graph)
        renewed = _at_rest_of(_renewed(card, gains, graph, {**found, "data": data}), folder)
        write_card(renewed, made / "model.json")
    return found


def _at_rest_of(card: Card, folder: Folder) -> Card:
    """The card with these recordings' static output, that of today's mounting; of a bundle over heights it stays."""
    contact, heights = card.contact, card.heights
    if contact is None or heights is not None or not contact.static_v:
        return card
    statics = list(static_outputs(folder, card.conditioning).values())
    if not statics:
        return card
    return replace(card, contact=replace(contact, static_v=tuple(np.mean(statics, axis=0).tolist())))


def _with_gains(graph: onnx.ModelProto, gains: Gains, path: Path) -> onnx.ModelProto:
    """The graph with each channel's columns of the map's table times its gain, rounded as they were; its change with
    the skin's height as well."""
    tables = {item.name: item for item in graph.graph.initializer if item.name in (TABLE, SLOPE)}
    if TABLE not in tables:
        raise InputError(
            f"{path}: its graph holds no table of the response map; name a bundle as 'train' wrote it"
        )
    for name, table in tables.items():
        values = numpy_helper.to_array(table)
        # The parts of a channel lie side by side (models/cnn/forward_model.py).
        scaled = values * np.repeat(gains.gain, values.shape[1] // len(gains.gain))
        table.CopyFrom(numpy_helper.from_array(scaled.astype(np.float16).astype(values.dtype), name))
    pack(graph)
    return graph


def _renewed(card: Card, gains: Gains, graph: bytes, found: dict[str, Any]) -> Card:
    assert card.contact is not None
    contact = contact_calibration(response_of(card).scaled(gains.gain))
    at_rest = ("inflation_v_per_mm", "static_v", "static_covariance_v2")
    contact = replace(contact, **{name: getattr(card.contact, name) for name in at_rest})
    recalibrations = [*card.provenance.get("recalibrations", ()), found]
    return replace(
        with_graph(card, graph),
        contact=contact,
        heights=None if card.heights is None else with_gains(card.heights, gains.gain),
        provenance={**card.provenance, "recalibrations": recalibrations},
    )


def _summary(card: Card, gains: Gains, slides: int, presses: int, left_out: list[str]) -> dict[str, Any]:
    axes = len(card.conditioning.touch_axes)
    names = [name for n, name in enumerate(card.channels) if n % 3 < axes]
    return {
        "strokes": slides,
        "presses": presses,
        "left_out": left_out,
        "gain": {name: round(float(g), 4) for name, g in zip(names, gains.gain, strict=True)},
        "gain_sd": {name: round(float(s), 4) for name, s in zip(names, gains.sd, strict=True)},
        "residual_before": round(gains.before_v / card.conditioning.scale, 5),
        "residual": round(gains.residual_v / card.conditioning.scale, 5),
    }
