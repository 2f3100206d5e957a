"""`python -m softslide`, the command line."""

import sys

from softslide.command_line import main

if __name__ == "__main__":
    sys.exit(main())
