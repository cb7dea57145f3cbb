"""What the diagnostics say: small records that need nothing else to be understood."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Finding:
    """One number, what it may be, and what it means.

    name: of the diagnostic; axis: of the sensor ("" for all of them); value; low, high: its bounds (NaN where they cannot be told);
    probability: that the value of a right filter lies outside them (NaN where the bounds follow from something else, which `source` says);
    p_value: probability that a right filter has a value as far out as this one (NaN as before); verdict: fine or off; fine, marginal or
    broken where there are degrees; unknown where there is too little to tell; source: of the bounds; sentence: the meaning.
    """

    name: str
    axis: str
    value: float
    low: float
    high: float
    probability: float
    p_value: float
    verdict: str
    source: str
    sentence: str


@dataclass(frozen=True)
class SensorJudgement:
    """All findings about one sensor: how many measurements they rest on, how many were rejected, and the sum of it in one sentence."""

    sensor: str
    used: int
    rejected: int
    verdict: str
    sentence: str
    findings: tuple[Finding, ...] = field(default_factory=tuple)
