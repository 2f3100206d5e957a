"""A bundle's page on a model hub: README.md, whose head is what the hub searches."""

from softslide.features.card import Card

NOT_STATED = "not stated whether measured or simulated"  # of recordings
PAGE = """---
library_name: softslide
pipeline_tag: robotics
tags:
- tactile-sensing
- soft-robotics
- onnx
---

# Contacts on a soft skin: {sensor}

`model.onnx` and its card `model.json` for softslide: where something touches this skin, which way it slides and how
fast, from {columns} at {rate_hz:g} Hz, with 90 % intervals and a flag `valid`.

| | |
|---|---|
| model | `{model}` |
| recordings | {origin} |
| skin | {skin} |
| sensing elements | {elements} |

It holds for this one sensor as it was calibrated. Where an estimate is not valid, its `reason` says why. It is no
safety device.

```python
import softslide

localizer = softslide.Localizer.load(".")
for estimate in localizer.push(volts):  # (samples, {count}), {unit}
    print(estimate.valid, estimate.x_mm, estimate.y_mm, estimate.direction_deg, estimate.speed_mm_s)
```
"""


def page(card: Card) -> str:
    """README.md of a bundle, in Markdown."""
    sensor = card.sensor
    elements = sensor["accelerometers"]
    places = (f"{e.get('kind', 'accelerometer')} at ({e['x_mm']:g}, {e['y_mm']:g}) mm" for e in elements)
    return PAGE.format(
        sensor=sensor["name"],
        columns=", ".join(card.columns),
        rate_hz=card.sample_rate_hz,
        model=card.model,
        origin=sensor.get("origin") or NOT_STATED,
        skin="{:g} x {:g} mm".format(*sensor["chamber_mm"]),
        elements=", ".join(places),
        count=len(card.columns),
        unit=elements[0].get("unit", "V"),
    )
