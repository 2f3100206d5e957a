"""The models by name: a line each. A model's file ends in its entry, `MODEL` (CONTRIBUTING.md)."""

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from typing import TYPE_CHECKING, Any

from features.errors import InputError

if TYPE_CHECKING:
    import onnx

    from models.fitted_model import FittedModel, Model
    from models.response_map.select import CalibratedMap
    from pipeline.atlas.atlas import Atlas
    from pipeline.recordings.folder import Folder

# Imported when they are asked for: the names cost nothing, so that `train --help` needs the base install alone.
MODELS = {
    "interpolation": "models.classical.interpolation",
    "trees": "models.classical.trees",
    "mlp": "models.classical.mlp",
    "gp": "models.classical.gaussian_process",
    "cnn": "models.cnn.fit",
}
DEFAULT = "cnn"
# Least output of a slide that is believed, in triggers: 8 mV at the default of 5.
PEAK_TRIGGERS = 1.6


def names() -> tuple[str, ...]:
    """The models' names, the default one last."""
    return tuple(MODELS)


def default_config(name: str) -> Any:
    """The model's configuration, a frozen dataclass whose `conditioning` is the signal path's.

    Raises:
        InputError: no such model.
    """
    return _model(name).config()


def uses_design(name: str) -> bool:
    """Whether the model can use an atlas of the sensor's design.

    Raises:
        InputError: no such model.
    """
    return _model(name).from_design


def learns_from_design_alone(name: str) -> bool:
    """Whether the model needs no recordings, and can start from an earlier bundle.

    Raises:
        InputError: no such model.
    """
    return _model(name).alone


def takes_several_heights(name: str) -> bool:
    """Whether the model can learn from recordings at several heights of the skin.

    Raises:
        InputError: no such model.
    """
    return _model(name).several_heights


def fit_model(
    name: str,
    folder: "Folder",
    config: Any,
    atlas: "Atlas | None" = None,
    init: "onnx.ModelProto | None" = None,
    progress: Callable[[int, float], None] = lambda step, loss: None,
    calibrate: "Callable[..., CalibratedMap] | None" = None,
    judge: Callable[[int, dict[str, float]], None] | None = None,
) -> "FittedModel":
    """Fits the model to the folder's labelled recordings.

    atlas: the sensor's design (`uses_design`). init: the graph of a bundle of the same model to start from
    (`learns_from_design_alone`). progress: called with the step and the loss, now and then. calibrate: for models that
    use the design, in place of `calibrated_map` (models/response_map/select.py). judge: for models that can start from
    a bundle, sees their errors on held-out lines after each third of the training but the last, and ends the fit by
    what it raises.

    Raises:
        InputError: no such model, nothing to fit it to, or `init` is of another kind.
    """
    from pipeline.recordings.at_rest import conditioning_for

    model = _model(name)
    config = replace(config, conditioning=conditioning_for(folder, config.conditioning))
    if atlas is not None and not model.from_design:
        raise InputError(f"{name} learns from recordings alone; leave the atlas out, or use {DEFAULT}")
    if init is not None and not model.alone:
        raise InputError(f"{name} starts from no bundle; leave it out, or use {DEFAULT}")
    if model.alone:
        fitted = model.fit(folder, config, atlas, init, progress, calibrate, judge)
    elif model.from_design:
        fitted = model.fit(folder, config, atlas, calibrate)
    else:
        fitted = model.fit(folder, config)
    peak_v = PEAK_TRIGGERS * config.conditioning.trigger_v
    validity = replace(fitted.validity, peak_v=max(fitted.validity.peak_v, peak_v))
    return replace(fitted, name=name, validity=validity)


def _model(name: str) -> "Model":
    if name not in MODELS:
        raise InputError(f"no model '{name}'; name one of {', '.join(MODELS)}")
    return import_module(MODELS[name]).MODEL
