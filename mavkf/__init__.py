"""mavkf: the fused pose of a drone from its MAVLink telemetry.

    mavkf.replay(path, **options)     estimate a log: arrays by vehicle and session
    mavkf.subscribe(vehicle)          iterate over the poses that a service publishes

Conventions, everywhere:

- SI units and radians; a name ends in its unit exactly where it is not (`lat_deg`, `time_us`), and such names live only at the edges
  (link, publish, cli, exports).
- Frames: `n` north-east-down, `b` body forward-right-down. `v_n`, `omega_b`; `C_nb` and `q_nb` take b to n (Hamilton, scalar first).
- Position: WGS-84 latitude and longitude and a height, above mean sea level as the receiver reports it. Its error is in metres in n.
- Attitude error on the left, in n: q_true = exp(dtheta_n) * q_nb. Heading variance is on the diagonal.
- `x` state, `dx` error state, `P` covariance, `F` = df/dx, `Phi` transition, `Qc` spectral density, `Qd` discrete noise, `H` = dh/dx,
  `z` measured, `z_hat` predicted, innovation `r = z - z_hat`, `S` its covariance, `K` gain, `nis = r' S^-1 r`, `sigma_*` one standard
  deviation.
- Times: `t` seconds on the vehicle's boot clock; anything else is spelled out (`t_arrival`, `utc_ns`).
- Not known is None in records, NaN in arrays, a blank cell in CSV: never zero, never a guess.
"""

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"
__all__ = ["replay", "subscribe", "__version__"]

if TYPE_CHECKING:
    from mavkf import replay
    from mavkf.publish.subscriber import subscribe


def __getattr__(name: str) -> Any:
    """The public names, imported when first used: a subscriber must not wait for the compiler that replay needs."""
    if name == "replay":
        from importlib import import_module

        return import_module("mavkf.replay")
    if name == "subscribe":
        from mavkf.publish.subscriber import subscribe

        return subscribe
    raise AttributeError(f"module 'mavkf' has no attribute {name!r}")
