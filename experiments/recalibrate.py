"""A bundle with the gains of its response map renewed, without training: graph, card, example and hashes."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from onnx import numpy_helper

from softslide.experiments.derived_labels import derived
from softslide.experiments.evaluation.readout import check_fits
from softslide.experiments.provenance import data_hashes
from softslide.features.card import Card, write_card
from softslide.features.contact.calibration import ContactCalibration
from softslide.features.errors import InputError
from softslide.models.cnn.forward_model import TABLE
from softslide.models.cnn.height_input import SLOPE
from softslide.models.export.bundle import read_graph, with_graph
from softslide.models.export.gains import Gains, fit_gains, labelled_contacts
from softslide.models.graph.packing import pack
from softslide.models.response_map.card import (
    calibrated_heights,
    contact_calibration,
    response_of,
    static_heights_mm,
)
from softslide.models.response_map.slides import static_outputs
from softslide.pipeline.recordings.folder import Folder, read_folder
from softslide.pipeline.recordings.learned import REPORTING
from softslide.pipeline.staging import staged
from softslide.serve.bundle import open_bundle


def recalibrate(
    model: str | Path, recordings: str | Path, out: str | Path, split: Sequence[str] | None = None
) -> dict[str, Any]:
    """Fits the bundle's map to the gains that strokes and presses of some splits show, and writes it anew.

    split: beginnings of their names; None: all but those that are for reporting, REPORTING. Returns what was found, for
    people to read. The card keeps it, with the recordings' hashes. The zero needs no such step: a stream's own static
    output is subtracted, whatever it is that day.

    Raises:
        InputError: the folder or the bundle is not valid, the bundle holds no response map, the sensor is another one,
            no recording is labelled as a stroke or a press, or all are for reporting and no split is named.
    """
    folder = derived(_chosen(read_folder(recordings), split))
    card, contact = _with_map(Path(model), folder)
    data, folder = data_hashes(folder), replace(folder, base_motion=card.base)
    heights_mm = static_heights_mm(folder, card.conditioning, contact, card.heights)
    slides, presses, left_out = labelled_contacts(folder, card.conditioning, heights_mm)
    if not slides and not presses:
        raise InputError(
            f"{folder.root / 'manifest.csv'}: no stroke with all its labels after a rest, and no press with its "
            "place and moments; label one"
        )
    gains = fit_gains(response_of(card), slides, presses)
    graph = _with_gains(Path(model), gains)
    found = {"strokes": len(slides), "presses": len(presses), "left_out": left_out, **_summary(card, gains)}
    recalibrations = [*card.provenance.get("recalibrations", ()), {**found, "data": data}]
    with staged(Path(out)) as made:
        (made / "model.onnx").write_bytes(graph)
        renewed = replace(
            with_graph(card, graph),
            contact=_renewed(card, contact, gains, folder),
            heights=calibrated_heights(response_of(card).scaled(gains.gain)),
            provenance={**card.provenance, "recalibrations": recalibrations},
        )
        write_card(renewed, made / "model.json")
    return found


def _chosen(folder: Folder, split: Sequence[str] | None) -> Folder:
    if split:
        return folder.select(*split)
    others = folder.manifest[~folder.manifest["split"].str.startswith(REPORTING)]
    if len(folder) and not len(others):
        raise InputError(
            f"is needed: every recording of {folder.root} is for reporting, of a split {' or '.join(REPORTING)}; name "
            "what may be fitted",
            "split",
        )
    return replace(folder, manifest=others)


def _with_map(bundle: Path, folder: Folder) -> tuple[Card, ContactCalibration]:
    """The card of a bundle that holds a response map of the folder's sensor, and this map.

    Raises:
        InputError: it is not such a bundle.
    """
    card, _ = open_bundle(bundle)
    if card.contact is None or not (bundle / "model.onnx").is_file():
        raise InputError(f"{bundle}: holds no response map to renew; name a cnn bundle that 'train' wrote")
    check_fits(card, folder)
    return card, card.contact


def _with_gains(bundle: Path, gains: Gains) -> bytes:
    """The graph with each channel's columns of the map's table times its gain, rounded as they were; its change with
    the skin's height as well."""
    graph = read_graph(bundle)
    tables = {item.name: item for item in graph.graph.initializer if item.name in (TABLE, SLOPE)}
    if TABLE not in tables:
        raise InputError(
            f"{bundle / 'model.onnx'}: its graph holds no table of the response map; name a bundle as 'train' wrote it"
        )
    for name, table in tables.items():
        values = numpy_helper.to_array(table)
        # The parts of a channel lie side by side (models/cnn/forward_model.py).
        scaled = values * np.repeat(gains.gain, values.shape[1] // len(gains.gain))
        table.CopyFrom(numpy_helper.from_array(scaled.astype(np.float16).astype(values.dtype), name))
    pack(graph)
    return graph.SerializeToString()


def _renewed(card: Card, contact: ContactCalibration, gains: Gains, folder: Folder) -> ContactCalibration:
    """The map with the gains, and what is known of the output at rest: it is these recordings', that of today's
    mounting; of a bundle over heights it stays."""
    static_v = contact.static_v
    if static_v and card.heights is None:
        today = list(static_outputs(folder, card.conditioning).values())
        static_v = tuple(np.mean(today, axis=0).tolist()) if today else static_v
    return replace(
        contact_calibration(response_of(card).scaled(gains.gain), contact.inflation_v_per_mm),
        static_v=static_v,
        static_covariance_v2=contact.static_covariance_v2,
    )


def _summary(card: Card, gains: Gains) -> dict[str, Any]:
    """Gains and their deviations by channel; rms residuals over the conditioning's scale, before and with them."""
    axes = len(card.conditioning.touch_axes)
    names = [name for n, name in enumerate(card.channels) if n % 3 < axes]
    return {
        "gain": {name: round(float(g), 4) for name, g in zip(names, gains.gain, strict=True)},
        "gain_sd": {name: round(float(s), 4) for name, s in zip(names, gains.sd, strict=True)},
        "residual_before": round(gains.before_v / card.conditioning.scale, 5),
        "residual": round(gains.residual_v / card.conditioning.scale, 5),
    }
