"""What the front door says of what it refuses."""

import pytest

import softslide


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line on standard error of a command that ends with 2 and prints nothing else."""
    capsys.readouterr()
    assert softslide.main([str(argument) for argument in arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.strip().count("\n") == 0
    assert err.strip()
    return err
