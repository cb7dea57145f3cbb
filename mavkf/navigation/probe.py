"""A measurement of the fold, linearised wherever one likes: the fold's own functions, run on a copy of the state that was moved."""

from mavkf.compiled import compiled
from mavkf.models.strapdown import retract
from mavkf.navigation import layout as L
from mavkf.navigation.fold import measure
from mavkf.navigation.tape import MODE as TAPE_MODE
from mavkf.navigation.tape import PROBING, rewind


@compiled
def probe(state, e, c, dx, copy, out):
    """Write on the tape of `out` what the event e would fuse if the nominal state were moved by dx (n,).

    state: (HALF,) as the measurement found it, left alone; copy: (HALF,), used up; c: parameters.
    """
    for i in range(L.HALF):
        copy[i] = state[i]
    retract(copy[L.X : L.P], dx)
    out[2][:] = 0
    out[5][TAPE_MODE] = PROBING
    rewind(copy, out[5])
    measure(copy, e, c, out)
