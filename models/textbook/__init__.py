"""Models to learn estimation with, each small enough to be checked by hand.

Plain numpy functions, as `mavkf.filters.estimator` asks of a model: f, F, F_xx and Q (discrete) or Qc (continuous), h, H, H_xx and R;
beside them X0 (n,) and P0 (n, n) to start from. SI units and radians.
"""
