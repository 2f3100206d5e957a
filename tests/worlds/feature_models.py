"""The models on features, small enough to be fitted in seconds."""

from softslide.models.classical.fit import OnFeatures, WithMisfit
from softslide.models.classical.gaussian_process import GpConfig, fit_gp
from softslide.models.classical.interpolation import InterpolationConfig, fit_interpolation
from softslide.models.classical.misfit import Misfit
from softslide.models.classical.mlp import MlpConfig, fit_mlp
from softslide.models.classical.trees import TreesConfig, fit_trees
from softslide.pipeline.recordings.windows import LabelledWindows

SMALL = {
    "interpolation": (fit_interpolation, InterpolationConfig()),
    "interpolation as published": (fit_interpolation, InterpolationConfig(form="quadratic")),
    "trees": (fit_trees, TreesConfig(trees=20)),
    "mlp": (fit_mlp, MlpConfig(members=2, hidden=(16,), iterations=60)),
    "gp": (fit_gp, GpConfig(search_rows=60)),
}


def small_model(name: str, windows: LabelledWindows) -> OnFeatures:
    """One of SMALL, with its misfit."""
    fit, config = SMALL[name]
    return WithMisfit(fit(windows, config), Misfit.of(windows))
