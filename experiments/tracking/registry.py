"""Registered bundles: versions of one name, of which one is the champion.

`models:/softslide@champion` and `models:/softslide/3` name a bundle wherever a command takes a folder.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import mlflow
from mlflow.exceptions import MlflowException

from experiments.tracking.recording_model import BUNDLE
from experiments.tracking.store import STORE_ERRORS, client_of, first_line, store_address
from features.errors import InputError

MODEL = "softslide"
CHAMPION = "champion"
T = TypeVar("T")


def fetched(address: str, into: Path, store: str | None = None) -> Path:
    """The bundle that an address names, fetched from the store into a folder below `into`.

    Raises:
        InputError: the store does not answer, it has no such model, or that is no bundle.
    """

    def fetch() -> Path:
        client_of(store_address(store))
        into.mkdir(parents=True, exist_ok=True)
        return Path(mlflow.artifacts.download_artifacts(address, dst_path=str(into)))

    bundle = _asked(fetch, address, store) / BUNDLE
    if not bundle.is_dir():
        raise InputError(f"{address}: no bundle that 'train' registered; name another")
    # Reports name a bundle by its folder.
    return bundle.rename(into / re.sub(r"\W+", "-", address.removeprefix("models:/")))


def champion(store: str | None = None) -> str | None:
    """The champion's version; None if there is none.

    Raises:
        InputError: the store does not answer.
    """

    def ask() -> str | None:
        try:
            return str(client_of(store_address(store)).get_model_version_by_alias(MODEL, CHAMPION).version)
        except MlflowException as error:
            if error.error_code in ("RESOURCE_DOES_NOT_EXIST", "INVALID_PARAMETER_VALUE"):
                return None
            raise

    return _asked(ask, f"models:/{MODEL}@{CHAMPION}", store)


def version_of(digest: str, store: str | None = None) -> str | None:
    """The last version registered of the bundle with this hash; None if there is none.

    Raises:
        InputError: the store does not answer.
    """

    def ask() -> str | None:
        found = client_of(store_address(store)).search_model_versions(f"name = '{MODEL}'")
        versions = [int(each.version) for each in found if each.tags.get("bundle") == digest]
        return str(max(versions)) if versions else None

    return _asked(ask, f"models:/{MODEL}", store)


def make_champion(version: str, store: str | None = None) -> None:
    """Moves the alias.

    Raises:
        InputError: the store does not answer, or has no such version.
    """
    client = client_of(store_address(store))
    move = lambda: client.set_registered_model_alias(MODEL, CHAMPION, version)  # noqa: E731
    _asked(move, f"models:/{MODEL}/{version}", store)


def _asked(call: Callable[[], T], address: str, store: str | None) -> T:
    try:
        return call()
    except STORE_ERRORS as error:
        raise InputError(
            f"{address}: not to be had from {store_address(store)} ({first_line(error)}); "
            "name a folder, or the store in MLFLOW_TRACKING_URI"
        ) from None
