"""softslide: where is it, which way, how fast?

What a program needs, by name (docs/api.md). Each is imported when it is first asked for, so that a device needs numpy
and ONNX Runtime alone. The rooms are packages of their own: `softslide.features`, `softslide.serve` and so on.
"""

import os

__version__ = "0.2.0"

# What there is, and where.
OFFERED = {
    "SAMPLE": "pipeline.recordings.folder",
    "Estimate": "features.estimate",
    "Evaluation": "experiments.evaluate",
    "Folder": "pipeline.recordings.folder",
    "Localizer": "serve.localizer",
    "Recording": "pipeline.recordings.folder",
    "evaluate": "experiments.evaluate",
    "examine": "pipeline.checks.findings",
    "main": "command_line",
    "predict": "serve.predict",
    "read_folder": "pipeline.recordings.folder",
    "read_sensor": "pipeline.sensor",
    "synthesize": "pipeline.synthesis.synthesize",
    "train": "experiments.train",
    "write_folder": "pipeline.recordings.folder",
}

# In the repository the rooms lie next to this folder; installed, in it.
if not os.path.isdir(os.path.join(__path__[0], "features")):
    __path__.append(os.path.dirname(__path__[0]))


def __getattr__(name: str) -> object:
    if name not in OFFERED:
        raise AttributeError(f"softslide has no {name!r}; it offers {', '.join(OFFERED)}")
    from importlib import import_module

    return getattr(import_module(f"softslide.{OFFERED[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *OFFERED})
