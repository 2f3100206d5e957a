"""The models by name: a line each. A model's file ends in its entry, `MODEL` (CONTRIBUTING.md)."""

from dataclasses import replace
from importlib import import_module
from typing import TYPE_CHECKING, Any

from softslide.features.errors import InputError

if TYPE_CHECKING:
    from softslide.models.fitted_model import FittedModel, Given, Model
    from softslide.pipeline.recordings.folder import Folder

# Imported when they are asked for: the names cost nothing, so that `train --help` needs the base install alone.
MODELS = {
    "interpolation": "softslide.models.classical.interpolation",
    "trees": "softslide.models.classical.trees",
    "mlp": "softslide.models.classical.mlp",
    "gp": "softslide.models.classical.gaussian_process",
    "cnn": "softslide.models.cnn.fit",
}
DEFAULT = "cnn"
# Least output of a slide that is believed, in triggers: 8 mV at the default of 5.
PEAK_TRIGGERS = 1.6


def model_named(name: str) -> "Model":
    """The model's entry.

    Raises:
        InputError: no such model.
    """
    if name not in MODELS:
        raise InputError(f"no model '{name}'; name one of {', '.join(MODELS)}")
    return replace(import_module(MODELS[name]).MODEL, name=name)


def fit_model(model: "Model", folder: "Folder", config: Any, given: "Given | None" = None) -> "FittedModel":
    """Fits a model to the folder's labelled recordings.

    Raises:
        InputError: there is nothing to fit it to, or it cannot take an atlas or a bundle that is given.
    """
    from softslide.models.fitted_model import Given
    from softslide.pipeline.recordings.at_rest import conditioning_for

    given = given or Given()
    if given.atlas is not None and not model.uses_design:
        raise InputError(f"{model.name} learns from recordings alone; leave the atlas out, or use {DEFAULT}")
    if given.init is not None and not model.design_suffices:
        raise InputError(f"{model.name} starts from no bundle; leave it out, or use {DEFAULT}")
    config = replace(config, conditioning=conditioning_for(folder, config.conditioning))
    fitted = model.fit(folder, config, given)
    peak_v = max(fitted.validity.peak_v, PEAK_TRIGGERS * config.conditioning.trigger_v)
    return replace(fitted, name=model.name, validity=replace(fitted.validity, peak_v=peak_v))
