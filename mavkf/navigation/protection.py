"""Protection levels: bounds on the horizontal and the vertical error, undetected faults counted in, exceeded with a stated risk at most.

Solution separation with what was measured (Brenner, "Integrated GPS/inertial fault detection availability", Navigation 43(2), 1996; Blanch
et al., "Baseline advanced RAIM user algorithm and possible improvements", IEEE Transactions on Aerospace and Electronic Systems 51(1),
2015): for each fault that the monitors follow, the estimate without it lies f b away and has the covariance P + f J^-1 f', so that the
error is at most |f b| + k sqrt(largest variance) if it is there. The bound is the largest of these and of k_0 times sigma without any
fault. A fault is there, and not found yet, at one sample in ten at most (`UNDETECTED`), so its factor is that of a tenfold risk.

A sigma is a claim itself: `CLAIM` covers that a receiver's error lasts longer, or is larger, than it says. (What the monitors leave
undecided is wider than that already.)
"""

import math

from mavkf.compiled import kernel
from mavkf.models.strapdown import POS
from mavkf.navigation import layout as L
from mavkf.navigation.monitors import effects, hypothesis, regress
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.receivers import book_of
from mavkf.stack import matrix, vector

CLAIM = 1.5  # the pooled error over sigma of simulated flights is 1.1, that of single ones goes to 1.5
UNDETECTED = 0.1


@kernel
def factor(risk):
    """The distance, in sigmas, that two normal components together exceed with this probability: Rayleigh's distribution."""
    return math.sqrt(-2.0 * math.log(risk))


@kernel
def largest_sigma(a, b, d):
    """Square root of the larger eigenvalue of [[a, b], [b, d]]."""
    return math.sqrt(max(0.5 * (a + d) + math.sqrt(0.25 * (a - d) * (a - d) + b * b), 0.0))


@kernel
def protection_levels(s, c, P):
    """The bounds on the horizontal and on the vertical error of the position, m, whose covariance is in P (n, n)."""
    k_0 = CLAIM * factor(c[Parameter.RISK])
    k = factor(min(c[Parameter.RISK] / UNDETECTED, 0.5))
    horizontal = k_0 * largest_sigma(P[POS, POS], P[POS, POS + 1], P[POS + 1, POS + 1])
    vertical = k_0 * math.sqrt(P[POS + 2, POS + 2])
    if s[L.MONITORED] != 0.0:
        size, C = vector(3), matrix(3, 3)
        shift, spread, M = vector(3), matrix(3, 3), matrix(3, 3)
        f = effects(s)
        for h in range(L.HYPOTHESES):
            if not math.isfinite(s[hypothesis(h)]):
                continue
            regress(s, h, size, C)
            for i in range(3):
                shift[i] = 0.0
                for j in range(3):
                    shift[i] += f[POS + i, 3 * h + j] * size[j]
                    spread[i, j] = 0.0
                    for a in range(3):
                        spread[i, j] += f[POS + i, 3 * h + a] * C[a, j]
            for i, j in ((0, 0), (0, 1), (1, 1), (2, 2)):
                M[i, j] = P[POS + i, POS + j]
                for a in range(3):
                    M[i, j] += spread[i, a] * f[POS + j, 3 * h + a]
            away = math.sqrt(shift[0] * shift[0] + shift[1] * shift[1])
            horizontal = max(horizontal, away + k * largest_sigma(M[0, 0], M[0, 1], M[1, 1]))
            vertical = max(vertical, abs(shift[2]) + k * math.sqrt(max(M[2, 2], 0.0)))
    b = book_of(s[L.MAIN])
    if math.isfinite(s[L.SUSPECT_POSITION]) or s[b + L.F_REFUSED_COUNT] > 0.0:
        # a receiver that is not believed may be right all the same
        other = math.hypot(s[b + L.F_INNOVATION], s[b + L.F_INNOVATION + 1])
        horizontal = max(horizontal, other + k * largest_sigma(P[POS, POS], P[POS, POS + 1], P[POS + 1, POS + 1]))
        vertical = max(vertical, abs(s[b + L.F_INNOVATION + 2]) + k * math.sqrt(P[POS + 2, POS + 2]))
    return horizontal + s[L.DOUBT], vertical + s[L.DOUBT]
