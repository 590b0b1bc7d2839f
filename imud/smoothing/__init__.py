"""Fixed-interval smoothing: every estimate from the data before it and after it (`imud replay --smooth`).

The estimator `attitude` by a fixed-interval smoother: `intervals` records, `fixed_interval` goes back, `attitude`
corrects.

`navigation` by a two-filter smoother (Fraser and Potter, "The optimum linear smoother as a combination of two optimum
linear filters", AIAA J. 1969): the same filter runs over the data once forward and once backward in time, and the two
estimates of each sample are averaged by their variances. `reversal` turns time round, `average` combines, `two_filter`
does the whole.
"""

from .two_filter import Segments, play_smoothed

__all__ = ["Segments", "play_smoothed"]
