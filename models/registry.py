"""One entry for every model: its configuration with its defaults, and its fit to a folder of recordings."""

from collections.abc import Callable
from typing import Any

import onnx

from features.errors import InputError
from models.fitted_model import FittedModel
from pipeline.atlas.atlas import Atlas
from pipeline.recordings.folder import Folder

MODELS = ("interpolation", "trees", "mlp", "gp", "cnn")


def default_config(name: str) -> Any:
    """The model's configuration, a frozen dataclass whose `conditioning` is the signal path's.

    Raises:
        InputError: no such model.
    """
    if name == "cnn":
        from models.cnn.fit import CnnConfig

        return CnnConfig()
    if name in MODELS:
        from models.classical.fit import CONFIGS

        return CONFIGS[name]()
    raise InputError(f"no model '{name}'; name one of {', '.join(MODELS)}")


def fit_model(
    name: str,
    folder: Folder,
    config: Any,
    atlas: Atlas | None = None,
    init: onnx.ModelProto | None = None,
    progress: Callable[[int, float], None] = lambda step, loss: None,
) -> FittedModel:
    """Fits the model to the folder's labelled recordings.

    atlas: the sensor's design, which only the default model can use. init: an exported graph of the same model
    to go on from. progress: told the step and the loss, now and then.

    Raises:
        InputError: no such model, nothing to fit it to, or `init` is of another kind.
    """
    if name == "cnn":
        from models.cnn.fit import fit_cnn

        try:
            return fit_cnn(folder, config, atlas, init, progress)
        except InputError:
            raise
        except ValueError as error:
            raise InputError(str(error), "init") from None
    if name in MODELS:
        from models.classical.fit import fit_classical

        if atlas is not None or init is not None:
            raise InputError(
                f"{name} learns from recordings alone; leave the atlas and the bundle to start from out, or use cnn"
            )
        return fit_classical(name, folder, config)
    raise InputError(f"no model '{name}'; name one of {', '.join(MODELS)}")
