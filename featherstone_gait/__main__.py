"""`python -m featherstone_gait`, the same as the command `featherstone-gait`."""

import sys

from .cli import main

if __name__ == "__main__":
    sys.exit(main())
