"""softslide: where is it, which way, how fast?

What a program needs, by name (docs/api.md). Each is imported when it is first asked for, so that a device needs numpy
and ONNX Runtime alone. The rooms are packages of their own: `softslide.features`, `softslide.serve` and so on.
"""

import os
import sys

# `python -m softslide...` puts the current folder first, where a module of any name may be anybody's: typing as well.
# While it looks for the module, `-m` stands in the place of the script.
if (
    sys.argv[:1] == ["-m"]
    and any(word.partition(".")[0] == "softslide" for word in sys.orig_argv)
    and sys.path[0] == os.getcwd() != os.path.dirname(__path__[0])
):
    del sys.path[0]

from typing import Any

__version__ = "0.2.0"

# What there is, and where.
OFFERED = {
    # The commands.
    "article": "experiments.article.article",
    "check": "experiments.check",
    "compare": "experiments.comparison.compare",
    "demo": "experiments.demo",
    "design": "experiments.acquisition.design",
    "evaluate": "experiments.evaluate",
    "export": "models.export.formats",
    "export_recordings": "experiments.export_recordings",
    "import_recordings": "pipeline.importers.run",
    "plan": "experiments.acquisition.plan",
    "predict": "serve.predict",
    "recalibrate": "experiments.recalibrate",
    "record": "experiments.acquisition.record",
    "simulate": "pipeline.atlas.solve",
    "synthesize": "pipeline.synthesis.synthesize",
    "train": "experiments.train",
    "train_from_run": "experiments.from_run",
    "main": "command_line",
    # What they work on.
    "SAMPLE": "pipeline.recordings.folder",
    "Estimate": "features.estimate",
    "Evaluation": "experiments.evaluate",
    "Folder": "pipeline.recordings.folder",
    "Localizer": "serve.localizer",
    "Recording": "pipeline.recordings.folder",
    "SimulatedSkin": "pipeline.synthesis.simulated_skin",
    "feature_table": "stream_features",
    "read_folder": "pipeline.recordings.folder",
    "read_sensor": "pipeline.sensor",
    "write_folder": "pipeline.recordings.folder",
}
ROOMS = ("experiments", "features", "models", "pipeline", "serve")

# In the repository the rooms lie next to this folder; installed, in it.
if not os.path.isdir(os.path.join(__path__[0], "features")):
    __path__.append(os.path.dirname(__path__[0]))


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name in ROOMS:
        return import_module(f"softslide.{name}")
    if name not in OFFERED:
        raise AttributeError(f"softslide has no {name!r}; it offers {', '.join((*OFFERED, *ROOMS))}")
    return getattr(import_module(f"softslide.{OFFERED[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *OFFERED, *ROOMS})
