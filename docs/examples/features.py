"""
Features of a slide
===================

The features that the models on features learn from, as a table with a name and a unit for each: extremes of the
subtracted outputs, when they pass, the zones of the article. Volts alone are needed, from any recording.
"""

import matplotlib.pyplot as plt

import softslide

lab = softslide.read_folder(softslide.SAMPLE)
recording = lab.load("a0120")
table = softslide.feature_table(recording.volts, lab.sensor.sample_rate_hz)
contact, end_s = table.iloc[0], table.index[0]
print(contact.filter(regex="^a0_v._(min|max)_[vs]$").round(4).to_string())

# %%
# Extremes of V_x and V_y on the signal that they are of. Moments are counted from when the contact was detected.

began_s = end_s - contact["elapsed_s"]
rest = recording.time_s < began_s - 1.0
axes = plt.figure(figsize=(7, 3.4), layout="constrained").add_subplot()
axes.set(xlabel="time, s", ylabel="subtracted output, V")
for channel, name in enumerate(("vx", "vy")):
    output = recording.volts[:, channel] - recording.volts[rest, channel].mean()
    (line,) = axes.plot(recording.time_s, output, linewidth=0.6, label=f"V_{name[1]}")
    for extreme in ("min", "max"):
        at = began_s + contact[f"a0_{name}_{extreme}_s"], contact[f"a0_{name}_{extreme}_v"]
        axes.plot(*at, "o", color=line.get_color(), markeredgecolor="black")
axes.legend()
plt.show()
