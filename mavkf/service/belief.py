"""Which of the frames that are whole are believed."""

from collections import Counter
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from mavkf.service.signing import Signing


class Belief:
    """By signature, and by system id."""

    def __init__(
        self,
        *,
        signing: Signing | None = None,
        systems: frozenset[int] | None = None,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        """signing: refuses what lacks its key, None: nothing; systems: ids that are believed, None: all; say: told once of others."""
        self._signing, self._systems, self._say = signing, systems, say
        self.others: Counter[int] = Counter()

    def signed(self, data: NDArray[np.uint8], frames: NDArray[np.void]) -> NDArray[np.void]:
        """The frames that are signed as they should be; what is not is not recorded either. data: what their offsets refer to."""
        return frames if self._signing is None else self._signing.check(data, frames)

    def allowed(self, frames: NDArray[np.void]) -> NDArray[np.void]:
        """The frames of the systems that are believed."""
        if self._systems is None:
            return frames
        keep = np.isin(frames["system"], list(self._systems))
        for system in frames["system"][~keep].tolist():
            if not self.others:
                self._say(f"system {system} is not among those allowed; it and others that are not are counted")
            self.others[system] += 1
        return frames[keep]

    def report(self) -> Iterator[str]:
        """What was refused, in sentences."""
        if self._signing is not None:
            for why, count in self._signing.refused.items():
                yield f"{count} frames {why} were refused"
        if self.others:
            ids = ", ".join(map(str, sorted(self.others)))
            yield f"{self.others.total()} frames of systems that are not allowed ({ids}) were left out"
