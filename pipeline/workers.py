"""Work on several processes: of this computer, or of a Dask cluster."""

import os
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from typing import Any

from softslide.features.errors import InputError
from softslide.features.safe_path import safe_path


def results(
    function: Callable[..., Any], calls: Iterable[tuple], jobs: int, scheduler: str = "", ordered: bool = True
) -> Iterator[Any]:
    """What the function returns for each tuple of arguments, as it comes, in the order of the calls or (ordered False)
    in that in which they end.

    jobs: processes of this computer; 1: this process. scheduler: address of a Dask cluster, tcp://HOST:PORT, whose
    workers, with this program installed and the same files in the same places, do the work instead.

    Raises:
        InputError: no such scheduler.
    """
    if jobs == 1 and not scheduler:
        yield from (function(*call) for call in calls)
        return
    from joblib import Parallel, delayed, parallel_config

    kind = "generator" if ordered else "generator_unordered"
    with ExitStack() as stack:
        stack.enter_context(safe_path())
        if scheduler:
            client = stack.enter_context(cluster(scheduler))
            stack.enter_context(parallel_config(backend="dask", client=client))
            jobs = -1
        # A cluster's workers are not this process's own.
        own = {} if scheduler else {"initializer": end_with, "initargs": (os.getpid(),)}
        # One that fails ends the others, as it should.
        warnings.filterwarnings("ignore", r"\d+ tasks which were still being processed", UserWarning)
        # A worker that has grown large is replaced between two calls; none is lost.
        warnings.filterwarnings("ignore", "A worker stopped while some jobs were given", UserWarning)
        # Each call is long enough to travel alone.
        yield from Parallel(n_jobs=jobs, batch_size=1, return_as=kind, **own)(
            delayed(function)(*call) for call in calls
        )


def end_with(parent: int) -> None:
    """Ends this process, a worker, soon after the process that it works for has ended, for whatever reason."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def cluster(scheduler: str) -> Any:
    """A client of a Dask scheduler.

    Raises:
        InputError: none answers at this address.
    """
    from distributed import Client

    try:
        return Client(scheduler, timeout="10s", set_as_default=False)
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())[:120]
        raise InputError(
            f"{scheduler}: no Dask scheduler answers ({reason}); start 'dask scheduler' and workers",
            "scheduler",
        ) from None
