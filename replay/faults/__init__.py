"""Faults to order, put into the sample rows of a recorded flight or into the log of a simulated one.

    rows = apply_faults(rows, [parse_fault("gnss-step:at=103.7,for=8,size=40,towards=330")])

`mavkf replay LOG --fault TEXT` and `mavkf simulate OUT --fault TEXT` do this; `mavkf replay --faults` lists the kinds. The same fault
gives the same rows, bit for bit, on whatever flight and in whatever pieces.
"""

from mavkf.replay.faults.kinds import KINDS, Fault, FaultKind, describe, parse_fault
from mavkf.replay.faults.rows import apply_faults

__all__ = ["KINDS", "Fault", "FaultKind", "apply_faults", "describe", "parse_fault"]
