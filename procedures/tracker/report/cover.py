"""The first page of the report of a kinematic calibration."""

from procedures.report.cover import Cover, CoverFigure, judged
from procedures.report.numbers import dig, mm, number
from procedures.tracker.report.source import KincalSource

_LACKS = "what the arm's model lacks, and joints or places beyond the ranges of the samples"
_PAYLOAD = "another payload than the one that it was measured with"


def kincal_cover(source: KincalSource) -> Cover:
    """Errors before and after on poses that were held out, and what is predicted, beside limit and plan."""
    found = source.found
    if found is None:
        return Cover()
    answer, forecast, sampling = found.result, found.uncertainty.predicted_95, source.sampling
    worst = None if forecast is None else forecast.workspace.max
    promised = number(dig(None if sampling is None else sampling.predicted, "error_95_max_m"))
    figures = [
        CoverFigure("held-out error before, RMS", mm(answer.rms_registration_only)),
        CoverFigure("held-out error calibrated, RMS", mm(answer.rms_calibrated)),
        CoverFigure(f"the {source.whose_noise} alone, √3 σ", mm(source.tracker_3d)),
        judged(
            "95 % prediction error, worst place",
            worst,
            dig(source.run, "job_config", "accept", "max_error_m"),
            mm,
            planned="" if promised is None else mm(promised),
        ),
        CoverFigure("parameters that the readings determine", f"{answer.rank} of {len(answer.parameters)}"),
    ]
    if sampling is not None:
        monuments = sampling.monuments
        if monuments is not None and monuments.looks:
            figures.append(judged("monuments moved by", monuments.max_moved_m, monuments.limit_m, mm))
        figures.append(CoverFigure("poses", str(sampling.measured), planned=str(sampling.wanted)))
    open_ = [_LACKS, _PAYLOAD]
    if answer.unidentifiable:
        open_.append(
            "what the readings cannot tell apart, and no prediction needs: "
            + "; ".join(answer.unidentifiable)
        )
    return Cover(figures, open_)
