"""What an estimate said was wrong, and when: the events of the monitors, or the refusals of a plain gate."""

from dataclasses import dataclass

import numpy as np

from mavkf.navigation import layout as L
from mavkf.navigation.codes import FAULT_CODES, Reason
from mavkf.navigation.estimator import Output
from mavkf.navigation.records import SENSOR_NAMES, RecordWriter

OUTAGE = "gnss_outage"
SENSORS = ("gnss_position", "gnss_velocity", "magnetometer", "barometer")  # whose refusal is a sign
FAULTS = tuple(code.name.lower() for code in FAULT_CODES)
"""Kinds of events that say that a sensor is at fault."""


@dataclass(frozen=True)
class Sign:
    """What was told at a time t (s of boot time): its kind, the size and the sentence of its event, if it is one."""

    t: float
    kind: str
    size: float | None = None
    text: str = ""


def fault_events(output: Output) -> list[Sign]:
    """The begins of faults that an estimate told, in order."""
    return [sign for sign in events_of(output) if sign.kind in FAULTS]


def told(output: Output) -> list[Sign]:
    """The begins of faults and of outages that an estimate told, in order."""
    return [sign for sign in events_of(output) if sign.kind in FAULTS or sign.kind == OUTAGE]


def refused(output: Output) -> list[Sign]:
    """The refusals of a gate by sensor, and the begins of outages: all that a filter without monitors has."""
    rows = output.innovations
    wrong = np.isin(rows[:, L.I_REASON], (Reason.GATE, Reason.DISTURBED)) & (rows[:, L.I_FUSED] == 0.0)
    named = [(float(row[L.I_TIME]), SENSOR_NAMES[int(row[L.I_SENSOR])]) for row in rows[wrong]]
    signs = [Sign(t, kind) for t, kind in named if kind in SENSORS]
    signs += [sign for sign in events_of(output) if sign.kind == OUTAGE]
    return sorted(signs, key=lambda sign: sign.t)


def events_of(output: Output) -> list[Sign]:
    """All events but the ends of faults that were told when they began: a step of a bias is told once, as it is corrected."""
    writer = RecordWriter("vehicle")
    signs, lasting = [], set()
    for event in (writer.event(note, 0) for note in output.notes):
        if event.t_end_s is None:
            lasting.add(event.kind)
        elif event.kind in lasting:
            lasting.remove(event.kind)
            continue
        if event.t_boot_s is not None:
            signs.append(Sign(event.t_boot_s, event.kind, event.size, event.text))
    return signs
