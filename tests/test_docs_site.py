"""The documentation as a site: it builds without a warning, and its examples run and draw."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted(path.stem for path in (ROOT / "docs" / "examples").glob("*.py"))


@pytest.mark.long
def test_the_site_has_every_page_and_a_picture_of_each_example(tmp_path: Path) -> None:
    pytest.importorskip("sphinx_gallery", reason="pip install softslide[docs]")
    build = [sys.executable, "-m", "sphinx", "-q", "-E", "-W", "--keep-going", "-c", "docs", ".", tmp_path]
    subprocess.run(build, cwd=ROOT, check=True, timeout=900)
    pages = {path.stem for path in (tmp_path / "docs").glob("*.html")}
    assert pages >= {path.stem for path in (ROOT / "docs").glob("*.md")}
    for name in EXAMPLES:
        page = (tmp_path / "docs" / "gallery" / f"{name}.html").read_text(encoding="utf-8")
        pictures = re.findall(r'src="([^"]+\.png)"', page)
        assert pictures, name
        assert all((tmp_path / "docs" / "gallery" / each).stat().st_size > 5000 for each in pictures)
    # Links to files of the repository are not left open.
    readme = (tmp_path / "README.html").read_text(encoding="utf-8")
    assert 'href="docs/guide.html"' in readme
    assert 'href="docs/guide.md"' not in readme
