"""Subcommands that compare: article, compare."""

from pathlib import Path
from typing import Any

import softslide
from softslide.commands import arguments
from softslide.commands.arguments import Parser, Run


def article(parser: Parser) -> Run:
    """the article's figures and claims on a folder of recordings

    Makes the figures of Trinh et al. (Sensors 2019, 19, 2036) again, 6, 9 to 11
    and 14 to 26, from the slides along x and y and from the atlas, each next to
    what the article says; holds its claims against them; and fits its method
    as published and at its best. Errors are in deg, % and mm, of slides that
    were not fitted. Writes article.html, and the numbers as CSV: claims.csv,
    variants.csv, figure-NN.csv. Prints the claims. Pressures and a laser's
    readings of the skin's height (skin_height_mm) are shown where the folder
    has them; the page names what is missing.

        softslide article --recordings my-recordings --out article
        softslide synthesize --protocol article --out protocol
        softslide article --recordings protocol --out article-protocol
    """
    arguments.recordings(parser, "slides along x and y, with their labels")
    arguments.atlas(parser, "from 'simulate' (default: the shipped one for its design, else solved coarsely)")
    arguments.out(parser, "where the page and its tables go")

    def run(**given: Any) -> None:
        made = softslide.article(**given)
        print("\n".join(made.lines()))
        print(made.page)

    return run


def compare(parser: Parser) -> Run:
    """models side by side, fitted and scored on the same slides

    Fits the article's interpolation, trees, a small network and a Gaussian
    process on features, the default model and the inverted response map to
    the same calibration slides and scores all on the same test slides:
    errors in degrees (deg), percent (%) and mm, time of a window in ms, and
    each model's differences from the default (or the first named) on the
    same slides, with 95 % confidence intervals over lines. Writes
    comparison.html, comparison.csv and paired.csv; the bundles are kept in
    DIR, below a folder for each folder of recordings.

        softslide compare --recordings bench-a bench-d --out comparison
        softslide compare --recordings lab --models my-model other-model --out which
    """
    arguments.recordings(parser, "folders, one sensor each", nargs="+")
    arguments.out(parser, "where everything goes")
    models = "some of interpolation, trees, mlp, gp, cnn, inversion, or folders of bundles, which are read out as they "
    parser.add_argument(
        "--models", nargs="+", metavar="NAME", help=f"{models}are (default: all that have a name)"
    )
    arguments.number(parser, "--jobs", "N", "recordings that a bundle reads at a time", 1)

    def run(out: Path, models: list[str] | None, **given: Any) -> None:
        softslide.compare(out=out, **given, **({"models": models} if models else {}))
        print(out / "comparison.html")

    return run


COMMANDS = (article, compare)
