"""`mavkf warmup`: compile now, so that nothing waits for it later."""

import sys
from contextlib import nullcontext

from mavkf.cli._console import messages, say


def warmup() -> int:
    """Compile the estimator now (about two minutes), once for each installed version; `serve` and `replay` then start at once."""
    from mavkf.compiled import cache_folder
    from mavkf.service.warmup import ensure_compiled

    on_terminal = sys.stderr.isatty()
    with messages().status("compiling the estimator, once: about two minutes") if on_terminal else nullcontext():
        seconds = ensure_compiled((lambda _: None) if on_terminal else say)
    print(f"compiled in {seconds:.1f} s" if seconds else "compiled before, nothing to do", f"(in {cache_folder()})")
    return 0
