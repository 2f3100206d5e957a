"""`python -m softslide`, the command line."""

import os
import sys

import softslide

# The current folder stands first, where a module of any name may be anybody's.
if sys.path[0] == os.getcwd() != os.path.dirname(softslide.__path__[0]):
    del sys.path[0]

from softslide.command_line import main

if __name__ == "__main__":
    sys.exit(main())
