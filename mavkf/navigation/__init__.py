"""The estimator: events on a timeline, folded into a state by compiled functions.

`estimator` is the entrance; `timeline` orders and folds events, `fold` takes one, `propagation` goes from one time to the next, each
`use_*` fuses one sensor, `layout` says where everything is.
"""
