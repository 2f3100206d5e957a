"""
A contact along a path
======================

A contact that turns is no straight slide: the filters follow it, and every moment has a place, a velocity and
intervals. With a lag each estimate comes half a second later and knows what followed.
"""

import matplotlib.pyplot as plt
import numpy as np

import softslide

SPEED_MM_S = 5.0
skin = softslide.SimulatedSkin(301)
rate_hz = skin.sensor.sample_rate_hz
x_mm = np.arange(-40, 40, SPEED_MM_S / rate_hz)
path = np.column_stack([x_mm, 10.0 * np.sin(2 * np.pi * x_mm / 80.0), np.full_like(x_mm, -0.5)])
volts = skin.push(np.concatenate([np.tile([*path[0, :2], 20.0], (round(2 * rate_hz), 1)), path]))

# %%
# The same volts live and with a lag. `rest` has what is left at a stream's end.

axes = plt.figure(figsize=(6, 4.6), layout="constrained").add_subplot(aspect="equal")
axes.add_patch(plt.Rectangle((-25, -25), 50, 50, fill=False, color="0.7"))
axes.plot(*path[:, :2].T, color="0.5", label="true")
for lag_s, colour in ((0.0, "C0"), (0.5, "C1")):
    localizer = softslide.Localizer.load("bundle", lag_s=lag_s)
    followed = [each for each in localizer.push(volts) + localizer.rest() if each.valid]
    place = np.array([(each.x_mm, each.y_mm) for each in followed])
    now = np.clip([round((each.time_s - 2.0) * rate_hz) for each in followed], 0, len(path) - 1)
    off_mm = np.hypot(*(place - path[now, :2]).T)
    print(
        f"lag {lag_s:g} s: {len(followed) * 0.02:.1f} s valid, median error of the place {np.median(off_mm):.2f} mm"
    )
    axes.plot(*place.T, ".", markersize=3, color=colour, label=f"lag {lag_s:g} s")
axes.set(xlabel="x, mm", ylabel="y, mm", xlim=(-45, 45), ylim=(-28, 28))
axes.legend()
plt.show()
