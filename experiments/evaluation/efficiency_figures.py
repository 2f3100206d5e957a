"""The report's figures of errors over the Cramer-Rao bound."""

from collections.abc import Mapping

import numpy as np

from experiments.pages.figures import COLOURS, INK, Panel, inline, log_with_zero, panel

# Of `efficiency.over_bound`: key and word of each quantity.
QUANTITIES = {"direction_deg": "direction", "log_speed": "speed", "offset_mm": "distance"}
# Stroke fractions of the report's table; the figures have them all.
SHARES = {"0.4": "after 2/5 of the stroke", "1.0": "at its end"}


def over_bound(found: Mapping[str, Mapping[str, Mapping[str, float]]]) -> list[Panel]:
    """Rms error over the bound against the share of the stroke seen, a line a split, a panel a quantity.

    found: of `efficiency.over_bound`.
    """
    if not found:
        return []
    panels = []
    for quantity, word in QUANTITIES.items():
        with panel() as (figure, ax):
            ax.axhline(1.0, color=INK, linestyle="--", linewidth=1)
            drawn = [1.0]
            for n, (split, strokes) in enumerate(found.items()):
                values = [row[quantity] for row in strokes.values()]
                ax.plot(
                    [float(share) for share in strokes],
                    values,
                    "o-",
                    markersize=3,
                    color=COLOURS[n % len(COLOURS)],
                    label=split,
                )
                drawn += values
            log_with_zero(ax, np.array(drawn))
            ax.set(xlabel="share of the stroke seen", xlim=(0.05, 1.05), title=f"{word}: rms error / bound")
            ax.legend(fontsize=8)
            counts = ", ".join(f"{split} {_range(strokes)}" for split, strokes in found.items())
            text = (
                f"Rms error of the {word} over its Cramer-Rao bound by the share of the stroke seen, a line a split; "
                f"dashed: the bound. Recordings behind each point: {counts}."
            )
            panels.append(Panel(inline(figure, text), text))
    return panels


def _range(strokes: Mapping[str, Mapping[str, float]]) -> str:
    """The least and the largest number of recordings over the stroke."""
    counts = [int(row["recordings"]) for row in strokes.values()]
    least, most = min(counts), max(counts)
    return f"{least}" if least == most else f"{least} to {most}"
