"""
A slide and its estimate
========================

A ball comes over the chamber's edge at 35 deg and 6 mm/s, 0.5 mm deep. The volts go to the localizer as they would on a
robot; every 20 ms it gives an estimate with 90 % intervals, once enough of the slide is seen.
"""

import matplotlib.pyplot as plt
import numpy as np

import softslide

DIRECTION_DEG, SPEED_MM_S, DEPTH_MM = 35.0, 6.0, 0.5
skin, localizer = softslide.SimulatedSkin(301), softslide.Localizer.load("bundle")
rate_hz = skin.sensor.sample_rate_hz

# %%
# Where the ball is at each sample: two seconds above the skin, then along a line that passes 4 mm beside the middle.

turn = np.deg2rad(DIRECTION_DEG)
along, across = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
way_mm = np.arange(-40, 40, SPEED_MM_S / rate_hz)
over_skin = np.column_stack([way_mm[:, None] * along + 4.0 * across, np.full(len(way_mm), -DEPTH_MM)])
above = np.tile([*over_skin[0, :2], 20.0], (round(2 * rate_hz), 1))

volts = skin.push(np.concatenate([above, over_skin]))
estimates = localizer.push(volts)
last = estimates[-1]
print(
    f"{last.direction_deg:.2f} deg, {last.speed_mm_s:.2f} mm/s, {last.offset_mm:.2f} mm from the accelerometer"
)

# %%
# The wedge of each interval closes as the slide goes on.

valid = [each for each in estimates if each.valid and each.state.value == "slide"]
time_s = [each.time_s for each in valid]
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
for axes, name, unit, truth in (
    (left, "direction", "deg", DIRECTION_DEG),
    (right, "speed", "mm_s", SPEED_MM_S),
):
    low, value, high = (
        [getattr(each, f"{name}_{part}{unit}") for each in valid] for part in ("lo_", "", "hi_")
    )
    axes.fill_between(time_s, low, high, alpha=0.3, label="90 % interval")
    axes.plot(time_s, value, label="estimate")
    axes.axhline(truth, color="0.4", linestyle="--", label="true")
    axes.set(xlabel="time, s", ylabel=f"{name}, {unit.replace('_', '/')}")
    axes.set_ylim(0.75 * truth, 1.25 * truth)
left.legend()
plt.show()
