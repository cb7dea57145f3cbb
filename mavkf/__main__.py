"""`python -m mavkf`: the same as the command `mavkf`."""

from mavkf.cli import entry

entry()
