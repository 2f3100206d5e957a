"""The licences of the packages that an installation brings, as their metadata say, written to docs/licences.md.

Reads what is installed next to it: run it where `softslide[all]` is. A package stands where it comes first.

    python -m softslide.experiments.studies.licences
"""

import sys
from collections.abc import Iterator, Sequence
from importlib.metadata import PackageNotFoundError, distribution

from packaging.requirements import Requirement

from softslide.experiments.code_hash import ROOT
from softslide.experiments.studies.script import write_page

PAGE = ROOT / "docs" / "licences.md"
EXTRAS = ("", "io", "train", "cluster", "team", "live", "test")
# Classifiers that name no licence.
VAGUE = {"OSI Approved", "DFSG approved", "Other/Proprietary License"}
LONGEST = 60  # characters of a licence's name; what is longer is its text
HEAD = """# Licences of what comes along

softslide is under the [MIT licence](../LICENSE). These packages come with an installation on Linux and x86-64. Each
keeps its own licence, here as its metadata name it. `mkl` and Intel's other runtimes come with `pypardiso`; where that
is missing, SciPy solves the skin. `felupe`, under the GPL, is used by tests alone and comes with no other installation.

`python -m softslide.experiments.studies.licences` writes this page.
"""


def licence(name: str) -> str:
    """A package's licence in a few words."""
    metadata = distribution(name).metadata
    if expression := metadata.get_all("License-Expression"):
        return str(expression[0])
    classified = [
        text.split(" :: ")[-1] for text in metadata.get_all("Classifier") or () if "License ::" in text
    ]
    if named := [text for text in classified if text not in VAGUE]:
        return ", ".join(sorted(named))
    first = "".join(metadata.get_all("License") or ()).strip().partition("\n")[0]
    return first if 0 < len(first) <= LONGEST else "not named in its metadata"


def needed(name: str, extra: str, seen: set[str]) -> Iterator[str]:
    """The packages that one brings, those that are installed, each once. seen: those before, which grows."""
    for line in distribution(name).requires or ():
        requirement = Requirement(line)
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": extra}):
            continue
        package = requirement.name.lower().replace("_", "-").replace(".", "-")
        for inner in ("", *requirement.extras):
            if (key := f"{package}[{inner}]") in seen:
                continue
            seen.add(key)
            try:
                distribution(package)
            except PackageNotFoundError:
                continue
            if not inner and package != "softslide":
                yield package
            yield from needed(package, inner, seen)


def page() -> str:
    """docs/licences.md."""
    lines, seen = [HEAD], set[str]()
    for extra in EXTRAS:
        found: dict[str, list[str]] = {}
        for package in needed("softslide", extra, seen):
            found.setdefault(licence(package), []).append(package)
        lines += [
            f"## `softslide[{extra}]`" if extra else "## `softslide`",
            "",
            "| licence | packages |",
            "|---|---|",
        ]
        lines += [f"| {name} | {', '.join(sorted(found[name]))} |" for name in sorted(found)]
        lines.append("")
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """The script."""
    return write_page("licences", __doc__, PAGE, page, argv)


if __name__ == "__main__":
    sys.exit(main())
