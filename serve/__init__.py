"""What a device runs: a bundle's estimates, of files and live. Called, the package is the command of its name.

`softslide.serve(model, source, ...)` is `softslide.serve.stream.live.serve`.
"""

import sys
from types import ModuleType


class _Room(ModuleType):
    def __call__(self, *arguments: object, **options: object) -> int:
        from softslide.serve.stream.live import serve

        return serve(*arguments, **options)  # type: ignore[arg-type]


sys.modules[__name__].__class__ = _Room
