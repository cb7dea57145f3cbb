"""`python -m mavkf`: the same as the command `mavkf`."""

import sys

from mavkf.cli import main

sys.exit(main())
