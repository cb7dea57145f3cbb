"""One sensor's judgement: what goes in, what is left out, and the sentence that comes out."""

import numpy as np
import pytest

from mavkf.diagnostics import judge_sensor
from mavkf.errors import UsageError

Array = np.ndarray


def record(n: int = 300, m: int = 2, seed: int = 0) -> tuple[Array, Array, Array]:
    """Times, innovations and correlated covariances of a right filter."""
    random = np.random.default_rng(seed)
    A = random.normal(size=(n, m, m + 1))
    S = A @ A.transpose(0, 2, 1)
    r = np.einsum("nij,nj->ni", np.linalg.cholesky(S), random.normal(size=(n, m)))
    return np.arange(n) * 0.2, r, S


def test_a_right_filter_has_all_findings() -> None:
    judgement = judge_sensor("gnss", *record(), axes=("north", "east"))
    assert judgement.verdict == "fine"
    assert (judgement.sensor, judgement.used, judgement.rejected) == ("gnss", 300, 0)
    names = [(finding.name, finding.axis) for finding in judgement.findings]
    assert len(names) == len(set(names)) == 3 + 2 * 6
    assert {axis for _, axis in names} == {"", "north", "east"}
    for finding in judgement.findings:
        assert finding.sentence.endswith(".")
        assert finding.probability == pytest.approx(0.01 / 15)


def test_false_alarms_of_the_whole_are_as_rare_as_promised() -> None:
    off = sum(judge_sensor("gnss", *record(100, 2, seed), probability=0.05).verdict == "off" for seed in range(150))
    assert 1 <= off <= 17  # 7.5 expected, all but one in a thousand times no more than 17


def test_rejected_are_counted_and_not_judged() -> None:
    t, r, S = record()
    fused = np.ones(300, dtype=bool)
    r[::10] *= 100.0
    assert judge_sensor("gnss", t, r, S).verdict == "off"
    fused[::10] = False
    judgement = judge_sensor("gnss", t, r, S, fused)
    assert judgement.verdict == "fine"
    assert (judgement.used, judgement.rejected) == (270, 30)


def test_missing_components_are_left_out() -> None:
    """NaN in r or S, a whole measurement, and an axis that is never there."""
    t, r, S = record(300, 3)
    r[:, 2] = np.nan
    S[:, 2, :] = S[:, :, 2] = np.nan
    r[5], r[7, 0] = np.nan, np.inf
    S[9, 1, 1] = np.nan
    judgement = judge_sensor("gnss", t, r, S, axes=("north", "east", "down"))
    assert judgement.used == 299
    for finding in judgement.findings:
        assert finding.verdict == ("unknown" if finding.axis == "down" else "fine"), finding
    assert judgement.verdict == "fine"


def test_the_sentence_is_of_the_worst() -> None:
    t, r, S = record()
    S[:, 0, 1] = S[:, 1, 0] = 0.0
    r = np.random.default_rng(1).normal(size=r.shape) * np.sqrt(np.diagonal(S, axis1=1, axis2=2))
    r[:, 1] += 0.8 * np.sin(t / 3.0) * np.sqrt(S[:, 1, 1])
    judgement = judge_sensor("gnss", t, r, S, axes=("north", "east"))
    off = [finding for finding in judgement.findings if finding.verdict == "off"]
    worst = min(off, key=lambda finding: finding.p_value)
    assert judgement.sentence.startswith("gnss east: ")
    assert worst.sentence in judgement.sentence
    assert f"{len(off)} of 15" in judgement.sentence


def test_linearisation_has_degrees() -> None:
    for share, verdict in ((0.051, "fine"), (0.08, "marginal"), (0.3, "broken")):
        judgement = judge_sensor("radar", *record(), outside=np.full(300, share))
        assert judgement.verdict == verdict
        assert judgement.findings[-1].value == pytest.approx(share)
    assert "The first order is not enough" in judgement.sentence


def test_too_few_are_unknown() -> None:
    for n in (0, 1):
        judgement = judge_sensor("gnss", *record(n))
        assert judgement.used == n
        assert judgement.verdict == ("unknown" if n == 0 else "fine")
    assert "too few" in judge_sensor("gnss", *record(0)).sentence


def test_bad_arguments_are_said() -> None:
    t, r, S = record()
    for arguments in ((t[1:], r, S), (t, r[:, 0], S), (t, r, S[:, :1]), (t, r, S, np.ones(3))):
        with pytest.raises(UsageError, match=r"Shapes t .* must be \(n,\)"):
            judge_sensor("gnss", *arguments)
    with pytest.raises(UsageError, match="1 names of axes for 2"):
        judge_sensor("gnss", t, r, S, axes=("north",))
    with pytest.raises(UsageError, match="between 0 and 1"):
        judge_sensor("gnss", t, r, S, probability=0.0)
    with pytest.raises(UsageError, match="singular"):
        judge_sensor("gnss", t, r, np.ones((300, 2, 2)))
