"""The command called in this process, and what it says of what it refuses."""

import pytest

import softslide


def call(*words: object) -> int:
    """The exit status of the command with these words."""
    return softslide.main([str(word) for word in words])


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line on standard error of a command that ends with 2 and prints nothing else."""
    capsys.readouterr()
    assert call(*arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.strip().count("\n") == 0
    assert err.strip()
    return err
