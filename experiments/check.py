"""One check of a folder of recordings, with what its manifest leaves out derived."""

from pathlib import Path

from softslide.experiments.derived_labels import derived
from softslide.features.errors import InputError
from softslide.pipeline.checks.report import Report, checked, refused
from softslide.pipeline.recordings.folder import read_folder


def check(folder: str | Path, atlas: str | Path | None = None, picture: str | Path | None = None) -> Report:
    """What is wrong with a folder, and what its slides do not cover. One that cannot be read is an error of the report.

    atlas: of the sensor's design; None: the one that ships, or was solved earlier. picture: of the coverage, to draw.

    Raises:
        InputError: the atlas is not one, or the picture cannot be drawn.
    """
    try:
        recordings = read_folder(folder, files=False)
    except InputError as error:
        return refused(Path(folder), error)
    if picture:
        from softslide.experiments.acquisition.pictures import draw_coverage

        draw_coverage(derived(recordings), Path(picture))
    return checked(recordings, atlas, derived)
