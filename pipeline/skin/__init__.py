"""The skin's mechanics: inflated, with boards cast in, under a sliding indenter."""

import os

# numba reads a configuration in the current folder, which may be anybody's and could name a cache of compiled code.
os.environ.setdefault("NUMBA_CACHE_DIR", "")
