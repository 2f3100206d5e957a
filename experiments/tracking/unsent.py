"""Records that a store did not take: kept beside the result, sent later by `softslide sync`.

A folder NAME.unsent holds `records.jsonl`, a record a line, `files/` that they name, and `state.json`: the store, the
run in it (empty before it began), the logged model, and how many records were sent.
"""

import json
import os
import shutil
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from experiments.tracking.store import STORE_ERRORS, Record, Sender, first_line
from features.errors import CheckFailed, InputError

SUFFIX = ".unsent"


@dataclass(frozen=True)
class _State:
    store: str
    run: str
    model: str
    sent: int = 0


class Unsent:
    """A new folder of records beside a result: `my-model.unsent`, or `my-model.2.unsent` where one is there."""

    def __init__(self, beside: Path, sender: Sender) -> None:
        beside.parent.mkdir(parents=True, exist_ok=True)
        self.folder = next(
            place
            for n in range(1, 10_000)
            if not (place := beside.with_name(beside.name + (f".{n}" if n > 1 else "") + SUFFIX)).exists()
        )
        (self.folder / "files").mkdir(parents=True)
        _write_state(self.folder, _State(sender.address, sender.run, sender.model))

    def keep(self, record: Record) -> None:
        """Adds one record, with a copy of the folder that it names."""
        if "folder" in record:
            kept = f"files/{len(list((self.folder / 'files').iterdir()))}"
            shutil.copytree(record["folder"], self.folder / kept)
            record = {**record, "folder": kept}
        with (self.folder / "records.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps(record) + "\n")

    def remove(self) -> None:
        """Removes what was kept."""
        shutil.rmtree(self.folder, ignore_errors=True)


def sync(places: Iterable[Path]) -> list[str]:
    """Sends what is kept in and below these folders, and removes it where all was sent; a line for each run sent.

    The store is the one that MLFLOW_TRACKING_URI names, or else the one that the records were meant for.

    Raises:
        InputError: a folder's records cannot be read. CheckFailed: the store does not take them.
    """
    lines = []
    kept = {folder: _read(folder) for place in places for folder in _folders(place)}
    # A run comes before those below it, which are to find it.
    for folder, (state, records) in sorted(kept.items(), key=lambda item: _began_ms(item[1][1])):
        sender = Sender(os.environ.get("MLFLOW_TRACKING_URI") or state.store, state.run, state.model)
        for number, record in enumerate(records[state.sent :], state.sent):
            try:
                sender.send(record, folder)
            except STORE_ERRORS as error:
                raise CheckFailed(
                    f"{folder}: {sender.address} does not take the records ({first_line(error)}); "
                    f"{len(records) - number} of {len(records)} are kept, run 'softslide sync' again"
                ) from None
            _write_state(folder, _State(state.store, sender.run, sender.model, number + 1))
        shutil.rmtree(folder)
        lines.append(
            f"{folder}: {len(records) - state.sent} records sent, run {sender.run} in {sender.address}"
        )
    return lines


def _folders(place: Path) -> list[Path]:
    if place.name.endswith(SUFFIX):
        return [place]
    return [folder for folder in place.rglob(f"*{SUFFIX}") if (folder / "state.json").is_file()]


def _began_ms(records: list[dict[str, Any]]) -> int:
    """When a run began; 0 where the store knows it already."""
    return int(records[0]["time_ms"]) if records and records[0]["kind"] == "begin" else 0


def _read(folder: Path) -> tuple[_State, list[dict[str, Any]]]:
    """Raises: InputError."""
    try:
        state = _State(**json.loads((folder / "state.json").read_text(encoding="utf-8")))
        text = (folder / "records.jsonl").read_text(encoding="utf-8")
        # A process killed as it wrote leaves a last line without its end.
        return state, [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{folder}: no records that 'train' kept ({first_line(error)}); remove it") from None


def _write_state(folder: Path, state: _State) -> None:
    scratch = folder / ".state.json"
    scratch.write_text(json.dumps(asdict(state)) + "\n", encoding="utf-8")
    scratch.replace(folder / "state.json")
