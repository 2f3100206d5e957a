"""
Train on a folder
=================

A folder of recordings in, a bundle and its errors out. The folder is the sample that ships (emulated bench recordings),
the model the article's interpolation, which takes seconds; `"cnn"`, the default, takes minutes and errs far less.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt

import softslide

work = Path(mkdtemp())
softslide.train(softslide.SAMPLE, work / "bundle", "interpolation", track=False)
result = softslide.evaluate(
    work / "bundle", softslide.SAMPLE, ["test"], work / "results", jobs=1, report=False, track=False
)
print("\n".join(result.lines()))

# %%
# Largest errors next to the article's bounds; a bound that no recording tests has no bar.

tested = [each for each in result.verdicts if each.met is not None]
axes = plt.figure(figsize=(6, 2.6), layout="constrained").add_subplot()
axes.barh([each.bound.name for each in tested], [each.max / each.bound.limit for each in tested])
axes.axvline(1.0, color="0.3", linestyle="--")
axes.set(xlabel="largest error / the article's bound")
plt.show()
