"""`python -m instok3d`."""

import sys

from instok3d.cli import main

sys.exit(main())
