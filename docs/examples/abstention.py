"""
When it says nothing
====================

An estimate carries `valid`, and a `reason` where it is not. Here the device is tilted first, while nothing touches,
and then a ball slides over the skin. A program acts on valid estimates alone.
"""

import matplotlib.pyplot as plt
import numpy as np

import softslide

skin, localizer = softslide.SimulatedSkin(301), softslide.Localizer.load("bundle")
rate_hz = skin.sensor.sample_rate_hz
way_mm = np.arange(-34, 34, 4.0 / rate_hz)
ball = np.column_stack([way_mm, np.full_like(way_mm, 6.0), np.full_like(way_mm, -0.5)])
above = np.tile([-34.0, 6.0, 20.0], (round(12 * rate_hz), 1))
volts = skin.push(np.concatenate([above, ball, ball[-1:] + np.array([0.0, 0.0, 20.0])]))

# %%
# From the third to the sixth second the device leans over by 4 deg about one axis and comes back.

seconds = np.arange(len(volts)) / rate_hz
lean = np.deg2rad(4.0) * np.sin(np.pi * np.clip((seconds - 3.0) / 3.0, 0.0, 1.0))
element = skin.sensor.accelerometers[0]
volts[:, 0] += element.sensitivity_v_per_g * np.sin(lean)
estimates = localizer.push(volts)

# %%
# The reasons, and how often each was given.

found, counts = np.unique([each.reason.value or "valid" for each in estimates], return_counts=True)
for reason, count in zip(found, counts, strict=True):
    print(f"{reason:<16}{count * 0.02:6.1f} s")

time_s = np.array([each.time_s for each in estimates])
valid = np.array([each.valid for each in estimates])
figure, (top, bottom) = plt.subplots(2, 1, figsize=(8, 4), sharex=True, layout="constrained")
top.plot(seconds, volts[:, :2] - volts[: round(rate_hz), :2].mean(axis=0), linewidth=0.6)
top.set(ylabel="V_x and V_y, V")
bottom.plot(time_s, [each.x_mm for each in estimates], color="0.75", label="not valid")
bottom.plot(time_s, np.where(valid, [each.x_mm for each in estimates], np.nan), label="valid")
bottom.set(xlabel="time, s", ylabel="x, mm", ylim=(-30, 30))
bottom.legend()
for axes in (top, bottom):
    axes.axvspan(3.0, 6.0, color="0.9")
plt.show()
