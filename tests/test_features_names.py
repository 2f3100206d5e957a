"""Names that people give cannot be read as anything but names."""

import pytest

from softslide.features.names import check_plain, is_plain


@pytest.mark.parametrize(
    "name",
    [
        "a0",
        "article",
        "Haut Ä, 3. Guss (v2)",
        "v=3.2_dir=45",
        "-45deg_1",
        "皮膚 1",
        "24 x 36",
        "50%",
        "-1.5",
        "console",
        "com10",
        "aux_1",
    ],
)
def test_names_of_labs_are_taken(name: str) -> None:
    check_plain(name, "a name")


@pytest.mark.parametrize(
    "name",
    [
        "",
        "skin */ int main() { return 1; } /*",
        "<script>alert(1)</script>",
        "=HYPERLINK(1)",
        "@SUM(1)",
        "-1+WEBSERVICE(A1)",
        "\x1b[31mred",
        "two\nlines",
        'say "hello"',
        "up\\down",
        "../up",
        "a" * 201,
        *("C:evil", "a:stream", "a.parquet:z"),
        *("CON", "nul", "prn", "Aux", "COM1", "lpt9", "com²", "nul.v2", "con .x"),
        *("x.", "x ", " x", "..", "..."),
        *("+A1&B1", "-A1+B2", "-2+3+cmd", "-1&A1", "-", "+1"),
    ],
)
def test_what_another_language_would_read_is_refused(name: str) -> None:
    assert not is_plain(name)
    with pytest.raises(ValueError, match="a name is"):
        check_plain(name, "a name")
