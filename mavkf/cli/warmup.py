"""`mavkf warmup`: compile now, so that nothing waits for it later."""

from mavkf.cli._console import compile_first


def warmup() -> int:
    """Compile the estimator now (about half a minute), once for each installed version; `serve` and `replay` then start at once."""
    from mavkf.compiled import cache_folder

    seconds = compile_first(smoothing=True)
    print(f"compiled in {seconds:.1f} s" if seconds else "compiled before, nothing to do", f"(in {cache_folder()})")
    return 0
