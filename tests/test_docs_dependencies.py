"""What an installation brings: its licences and hashes in the documents are those of the pinned packages."""

import platform

import pytest

from softslide.experiments.code_hash import ROOT
from softslide.experiments.studies import hashes, licences


def versions(text: str) -> dict[str, str]:
    pins = (line.split()[0].partition("==") for line in text.splitlines() if line)
    return {name.lower().replace("_", "-"): version.partition("+")[0] for name, _, version in pins}


@pytest.mark.skipif(platform.machine() != "x86_64", reason="what comes along differs between machines")
def test_the_page_of_licences_is_what_the_installed_packages_say() -> None:
    assert licences.PAGE.read_text(encoding="utf-8") == licences.page()


def test_every_package_is_hashed_in_the_version_that_is_pinned() -> None:
    text = hashes.PAGE.read_text(encoding="utf-8")
    pinned = versions((ROOT / "constraints.txt").read_text(encoding="utf-8"))
    assert {
        name: version for name, version in versions(text).items() if pinned.get(name, version) != version
    } == {}
    assert all(len(line.rpartition("sha256:")[2]) == 64 for line in text.splitlines())
