"""Kinematic models and sensor models as compiled functions of plain arrays.

A kinematic model is a module with its layout by name, `propagate`, `transition`, `retract` and `local`; a sensor model has
`predict` (z_hat), `jacobian` (H = dh/dx) and its noise. Symbols and frames: see the docstring of `mavkf`.
`textbook` has models to learn with.
"""
