"""Is the filter right? Judged from its innovations, and from its errors where the truth is known.

A filter that is optimal has innovations that are white, of mean zero, and as large as it says; every departure has a cause (Mehra, "On
the Identification of Variances and Adaptive Kalman Filtering", IEEE Trans. Automatic Control AC-15, 1970). Every finding is a
`records.Finding`: a value, its bounds with their probability and source, and one sentence.

    judge_sensor(...)       all of the below of one sensor's innovations, as one record
    consistency             NIS and NEES against chi-square bounds
    whiteness               autocorrelation, Ljung-Box, cumulative periodogram
    normality, bias         shape of the distribution; mean and trend
    linearisation           second-order terms that a first-order filter neglects, against S and P
    covariance, divergence  condition and symmetry of P; innovations that grow while P shrinks
"""

from mavkf.diagnostics.records import Finding, SensorJudgement
from mavkf.diagnostics.sensor import judge_sensor

__all__ = ["Finding", "SensorJudgement", "judge_sensor"]
