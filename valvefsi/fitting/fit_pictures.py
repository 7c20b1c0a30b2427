"""Profiles of any fit as a picture."""

from __future__ import annotations

from pathlib import Path

from valvefsi.fitting.report import Report
from valvefsi.post.plots.fit import ProfilePanel, profiles_picture


def draw_profiles(path: Path, report: Report) -> Path:
    """Draw the profile of each free parameter of a report."""
    fit, parameters = report.fit, {p.name: p for p in report.fit.problem.parameters}
    least = max(fit.cost, 1e-300)
    panels = [
        ProfilePanel(
            name=profile.name,
            unit=parameters[profile.name].unit,
            values=profile.values,
            costs=profile.costs / least,
            threshold=profile.threshold / least,
            best=fit.named[profile.name],
            interval=profile.interval,
            verdict=report.assessment.verdicts[profile.name],
            log=parameters[profile.name].log,
        )
        for profile in report.assessment.profiles
    ]
    return profiles_picture(
        path,
        panels,
        title=f"Profile likelihood, {report.model}",
        caption="least cost over all other parameters; dashed: 95 % threshold, shaded: the interval it leaves",
    )
