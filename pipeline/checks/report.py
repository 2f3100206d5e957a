"""What `softslide check` says of a folder: its findings, what was not checked, skin heights, what is not covered."""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from softslide.features.errors import InputError
from softslide.pipeline.atlas.library import atlas_at_hand
from softslide.pipeline.atlas.skin_height import height_lines, heights_to_report, skin_heights
from softslide.pipeline.checks.coverage import not_covered
from softslide.pipeline.checks.findings import Finding, compared, measured_slides
from softslide.pipeline.recordings.derived_labels import with_derived_labels
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.heights import said_of_heights
from softslide.pipeline.recordings.learned import CALIBRATION
from softslide.pipeline.sensor import Sensor


@dataclass(frozen=True)
class Report:
    """What was found. not_checked, not_covered: a sentence each. heights: what `train` makes of several pressures.
    skin_heights: rows of `pipeline.atlas.skin_height.skin_heights`."""

    folder: str
    recordings: int
    findings: list[Finding]
    not_checked: list[str] = field(default_factory=list)
    heights: str = ""
    skin_heights: list[dict[str, Any]] = field(default_factory=list)
    not_covered: list[str] = field(default_factory=list)

    @property
    def unreadable(self) -> str:
        """Why the folder could not be read; empty where it could."""
        return next((f.text for f in self.findings if f.kind == "unreadable" and not f.recording), "")

    def level(self, level: str) -> list[Finding]:
        """The findings that are an `error`, or a `warning`."""
        return [finding for finding in self.findings if finding.level == level]

    def to_frame(self) -> pd.DataFrame:
        """A row for each finding."""
        return pd.DataFrame(map(asdict, self.findings), columns=[each.name for each in fields(Finding)])

    def as_json(self) -> dict[str, Any]:
        """The report as plain values; null where a number is not known."""
        rows = [
            {
                key: None if isinstance(value, float) and np.isnan(value) else value
                for key, value in row.items()
            }
            for row in self.skin_heights
        ]
        counts = {f"{level}s": len(self.level(level)) for level in ("error", "warning")}
        return asdict(self) | counts | {"skin_heights": rows}

    def lines(self) -> Iterator[str]:
        """The report for people."""
        yield from (finding.line() for finding in self.findings)
        yield from (f"not checked: {line}" for line in self.not_checked)
        if self.heights:
            yield f"heights: {self.heights}"
        yield from (f"skin height: {line}" for line in height_lines(self.skin_heights))
        yield from (f"not covered: {line}" for line in self.not_covered)
        errors, warnings = len(self.level("error")), len(self.level("warning"))
        yield f"{self.recordings} recordings, {errors} errors, {warnings} warnings"


def checked(
    folder: Folder,
    atlas: str | Path | None = None,
    derive: Callable[[Folder], Folder] = with_derived_labels,
) -> Report:
    """Every recording measured, with the labels that follow from others where the manifest leaves them out.

    atlas: of the design, for the skin's heights; None: the one that ships or was solved earlier. derive: fills labels
    of recordings that can be read, for what is said of what they cover.

    Raises:
        InputError: the atlas named is not one, or of another design.
    """
    measured, unreadable = measured_slides(folder)
    findings = compared(folder, measured, unreadable)
    known = derive(replace(folder, manifest=folder.manifest.loc[[one.name for one in measured]]))
    heights: list[dict[str, Any]] = []
    if heights_to_report(known):
        rest_v = {one.name: one.rest_v for one in measured}
        heights = skin_heights(known, rest_v, atlas_at_hand(folder.sensor, atlas))
    return Report(
        folder=str(folder.root),
        recordings=len(folder),
        findings=findings,
        not_checked=not_checked(folder.sensor),
        heights=said_of_heights(known.select(*CALIBRATION)),
        skin_heights=heights,
        not_covered=not_covered(known.manifest, folder.sensor),
    )


def refused(root: Path, error: InputError) -> Report:
    """The report on a folder that could not be read."""
    return Report(str(root), 0, [Finding("error", "unreadable", "", "", 1.0, 0.0, str(error))])


def not_checked(sensor: Sensor) -> list[str]:
    """What was left out, and why; a line each."""
    lines = []
    if others := [a.name for a in sensor.accelerometers if not a.measures_gravity]:
        lines.append(
            f"{', '.join(others)}: gravity, data-sheet noise, mains, drift and contact zones are not checked; "
            "they apply to accelerometers alone"
        )
    if sensor.origin == "assembled":
        lines.append(
            "assembled recordings hold and share samples: clipped, copied and made-up are not checked"
        )
    return lines
