"""Report of the replication: its text and its files."""

from collections.abc import Callable, Mapping, Sequence
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from drake_quad.files import write_text
from drake_quad.flight.mission import plan_route
from drake_quad.reference.polynomial_path import peak_norm
from drake_quad.replication.calibration import HYPOTHESES, NETWORK_CELL, PD_CELL
from drake_quad.replication.claims import all_claims
from drake_quad.replication.effort import EffortMatch, effort_matches, printed_ratios, printed_scatter, write_efforts
from drake_quad.replication.fair import COMPARED, FairEntry, fair_entries, write_fair
from drake_quad.replication.figures import Flights, paper_figures
from drake_quad.replication.measures import EFFORTS, OUR_EFFORT
from drake_quad.replication.printed import CONTROLLERS, WINDS, Cell, printed_table
from drake_quad.replication.results import Experiment
from drake_quad.replication.table_ii import (
    QUANTITIES,
    TableEntry,
    number_or_dash,
    percent_or_dash,
    table_entries,
    table_markdown,
    write_entries,
)
from drake_quad.reports.claims import Claim, verdict_counts, verdict_table, write_claims
from drake_quad.reports.page import filled_template, image, table, write_figures, write_page
from drake_quad.reports.results import read_groups
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.networks.network import Network
from drake_quad.scenario.winds.fan import jets
from drake_quad.statistics.estimates import mean_interval
from drake_quad.statistics.interval import Interval
from drake_quad.visualization.style import Vector

FIGURES = {
    "table_ii": "RMSE of Table II: printed runs and their mean, and ours. The intervals of our means are narrower than"
    " their marks; the bars hold 95 % of the samples.",
    "figure_4": "The paper's Fig. 4: upper and lower elliptic memberships for four pairs of exponents.",
    "figure_7": "The paper's Fig. 7: the path without wind, sample 0; the numbers are those of the segments.",
    "figure_8": "The paper's Fig. 8: the same from above.",
    "figure_9": "The paper's Fig. 9: Euclidean error without wind, sample 0, over the numbered segments; triangles: the"
    " peaks that the paper's figure shows.",
    "figure_10": "The paper's Fig. 10: the same in low wind, four controllers; triangles: the mean RMSE of Table II.",
    "figure_11": "The paper's Fig. 11: the same in high wind.",
    "figure_12": "The paper's Fig. 12: what PD and network command on X, without wind.",
    "figure_13": "The paper's Fig. 13: the same on Y.",
    "advantage": "By how much the error of type 2 is smaller than that of type 1, without wind, over the noise of the"
    " cameras and over q, with 95 % intervals; where a point is below zero, type 1 is better.",
    "gains": "Mean RMSE over the gains of the PD, without wind; grey: a sample crashed.",
    "fair": "Mean RMSE of the PD and of PD+T2FNN beside controllers that the paper does not have.",
}
# Fields of `Claim` by the headings of their columns, in the file and in the report.
_COLUMNS = {"claim": "words", "printed": "printed", "ours": "evidence"} | {
    name: name for name in ("verdict", "rule", "details", "figure")
}
_SHOWN_COLUMNS = {"claim": "words", "the paper's evidence": "printed", "ours, with 95 % intervals": "evidence"}
_FITTED = (PD_CELL, NETWORK_CELL)


class Findings(NamedTuple):
    """Tables and claims that follow from an experiment.

    Attributes:
        entries: numbers of Table II.
        claims: claims of the paper, with verdicts.
        fair: comparison with controllers that the paper does not have.
        efforts: definitions of control effort, the closest first.
    """

    entries: Sequence[TableEntry]
    claims: Sequence[Claim]
    fair: Sequence[FairEntry]
    efforts: Sequence[EffortMatch]


def findings_of(found: Experiment) -> Findings:
    """Return the findings of an experiment."""
    return Findings(table_entries(found.cells), all_claims(found), fair_entries(found), effort_matches(found))


def write_report(
    folder: Path,
    found: Experiment,
    findings: Findings,
    flights: Flights,
    *,
    vector: Vector | None = None,
    progress: Callable[[], object] = lambda: None,
) -> list[Path]:
    """Write the tables, the figures and the pages of the report, and return the files.

    Args:
        folder: folder of the report.
        found: numbers of the experiment.
        findings: findings of the experiment.
        flights: sample 0 of each cell of Table II, which the figures show.
        vector: format of vector graphics that are written in addition; none if not given.
        progress: called after each figure.
    """
    write_text(folder / "calibration.csv", files(__package__).joinpath("calibration.csv").read_text(encoding="utf-8"))
    sections = (f"## {words}\n\n{table_markdown(findings.entries, name)}\n" for name, words in QUANTITIES.items())
    tables = [
        write_entries(folder / "table_ii.csv", findings.entries),
        write_text(folder / "table_ii.md", "# Table II\n\n" + "\n".join(sections)),
        write_claims(folder / "claims.csv", findings.claims, _COLUMNS),
        write_fair(folder / "fair.csv", findings.fair),
        write_efforts(folder / "effort.csv", findings.efforts),
    ]
    write_figures(paper_figures(found, flights), folder, vector=vector, progress=progress)
    return [*tables, *write_page(folder, report_markdown(found, findings))]


def report_markdown(found: Experiment, findings: Findings) -> str:
    """Return the report as Markdown, with links to its figures in the adjacent folder `figures`."""
    return filled_template(
        __package__,
        figures={name: image(name, caption) for name, caption in FIGURES.items()},
        **_of_experiment(found),
        **_of_scenario(found.cells[Cell("low_wind", "pd_t2fnn")].scenario),
        **_of_calibration(),
        **_of_table(findings.entries),
        **_of_claims(findings.claims),
        **_of_fair(found, findings.fair),
        **_of_effort(findings.efforts),
    )


def _of_experiment(found: Experiment) -> dict[str, Any]:
    sweeps = [found.noise, found.q, *found.slopes.values(), *found.maps.values()]
    varied = [*(sweep.metrics.crashed for sweep in sweeps), np.isnan(found.legs.metrics.straight)]
    path_errors = (found.recorded[Cell("no_wind", name)]["path_error"] for name in ("pd", "pd_t2fnn"))
    path_pd, path_network = (mean_interval(errors).metres() for errors in path_errors)
    return {
        "samples": len(found.cells[PD_CELL].samples),
        "recorded": len(found.recorded[PD_CELL]["path_error"]),
        "duration": found.cells[PD_CELL].duration,
        "path_pd": path_pd,
        "path_network": path_network,
        "varied": sum(crashed.size for crashed in varied),
        "varied_crashed": sum(int(crashed.sum()) for crashed in varied),
        "sweep": len(found.noise.samples),
    }


def _of_scenario(scenario: Scenario) -> dict[str, Any]:
    """Return the fields of the template that describe assumptions of the scenario of PD+T2FNN in low wind."""
    plan, laboratory = plan_route(scenario), scenario.laboratory
    link, network = laboratory.command_link, cast(Network, scenario.cascade.network)
    first, second = jets(laboratory.wind)
    places = (", ".join(f"{each:g}" for each in jet.outlet) for jet in (first, second))
    return {
        "scenario": scenario,
        "plan": plan,
        "num_legs": len(plan.legs),
        "speed": peak_norm(plan.path, 1),
        "acceleration": peak_norm(plan.path, 2),
        "position_noise": 1e3 * laboratory.motion_capture.position_noise,
        "attitude_noise": 1e3 * laboratory.motion_capture.attitude_noise,
        "link_delay": 1e3 * link.period * link.delay_ticks,
        "link_loss": 100.0 * link.loss_rate,
        "jet": first,
        "jets": " and ".join(f"({place}) m" for place in places),
        "turbulence": 100.0 * first.turbulence,
        "num_sets": len(network.inputs.given["error"].centres),
        "centres": ", ".join(f"{centre:g}" for centre in network.inputs.given["error"].centres),
    }


def _of_calibration() -> dict[str, str]:
    with as_file(files(__package__) / "calibration.csv") as path:
        fitted = read_groups(path, ("hypothesis", "wind", "controller"))
    rows, numbers, spreads = [], [], {}
    off: dict[tuple[str, Cell], float] = {}
    for cell, line in printed_table().items():
        errors = {name: float(fitted[name, *cell]["rmse_m"][0]) for name in HYPOTHESES}
        off |= {(name, cell): error / line.rmse.mean - 1.0 for name, error in errors.items()}
        ours = (f"{error:.3f}{_in_brackets(off[name, cell])}" for name, error in errors.items())
        wind = WINDS[cell.wind] + (" (fitted)" if cell in _FITTED else "")
        rows.append((wind, CONTROLLERS[cell.controller], number_or_dash(line.rmse.mean), *ours))
    for name, (words, _, *free) in HYPOTHESES.items():
        values = (fitted[name, *PD_CELL][column][0] for column in ("pd_number", "network_number"))
        texts = (f"{number.words} {value:.4g}" for number, value in zip(free, values, strict=True))
        numbers.append(f"- {words}: {'; '.join(texts)}.")
        predicted = [off[name, cell] for cell in printed_table() if cell not in _FITTED]
        spreads[f"spread_{name}"] = f"{100.0 * np.nanmin(predicted):+.1f} to {100.0 * np.nanmax(predicted):+.1f} %"
    header = ("", "", "printed", *(hypothesis.words for hypothesis in HYPOTHESES.values()))
    return {"fitted": "\n".join(numbers), "calibration": table(header, rows), **spreads}


def _of_table(entries: Sequence[TableEntry]) -> dict[str, Any]:
    errors = {entry.cell: entry for entry in entries if entry.quantity == "rmse"}
    predicted = [entry for cell, entry in errors.items() if cell not in _FITTED and np.isfinite(entry.off)]
    beyond = [entry for entry in predicted if abs(entry.off) > 0.1]
    offs = [entry.off for entry in predicted]
    crashed = sum(entry.crashed for entry in errors.values())
    return {
        **{f"table_{name}": table_markdown(entries, name) for name in QUANTITIES},
        "off_pd": percent_or_dash(errors[PD_CELL].off),
        "off_network": percent_or_dash(errors[NETWORK_CELL].off),
        "predicted": len(predicted),
        "within": len(predicted) - len(beyond),
        "beyond": "; the exceptions are " + ", ".join(map(_named, beyond)) if beyond else "",
        "spread": f"{100.0 * min(offs):+.1f} to {100.0 * max(offs):+.1f} %",
        "crashes": f"{crashed:,} samples crashed; means are those of the others." if crashed else "No sample crashed.",
    }


def _of_claims(claims: Sequence[Claim]) -> dict[str, str]:
    parts = []
    for number, claim in enumerate(claims, start=1):
        title = claim.words[0].upper() + claim.words[1:]
        parts.append(
            f"### {number}. {title}\n\nThe paper: {claim.printed}. Here: {claim.evidence}.\n\nVerdict:"
            f" **{claim.verdict}**. Rule: {claim.rule}."
        )
        if claim.details:
            parts.append(f"Cell by cell: {claim.details}.")
        if claim.figure:
            parts.append(image(claim.figure, FIGURES[claim.figure]))
    return {
        "verdicts": verdict_table(claims, _SHOWN_COLUMNS),
        "claims": "\n\n".join(parts),
        "count": verdict_counts(claims),
    }


def _of_fair(found: Experiment, entries: Sequence[FairEntry]) -> dict[str, str]:
    rows = [
        (
            WINDS[entry.cell.wind],
            COMPARED[entry.cell.controller],
            *(mean.text() for mean in (entry.rmse, entry.peak_error, entry.effort_x, entry.effort_y)),
            "1" if entry.cell.controller == "pd" else entry.over_pd.ratio(),
            "1" if entry.cell.controller == "pd_t2fnn" else entry.over_network.ratio(),
        )
        for entry in entries
    ]
    efforts = (f"effort on {axis} (m²/s⁴)" for axis in "XY")
    header = ("", "", "RMSE (m)", "peak error (m)", *efforts, "RMSE over PD's", "RMSE over PD+T2FNN's")
    over_network = {entry.cell: entry.over_network for entry in entries}
    helped = {
        wind: found.comparison(Cell(wind, "pd_feed_forward_t2fnn"), Cell(wind, "pd_feed_forward")).share
        for wind in WINDS
    }
    return {
        "fair": table(header, rows),
        **{
            f"{name}_over_network": _by_wind({wind: over_network[Cell(wind, name)] for wind in WINDS})
            for name in ("pd_retuned", "pd_feed_forward")
        },
        "network_over_feed_forward": _by_wind(helped),
    }


def _of_effort(matches: Sequence[EffortMatch]) -> dict[str, Any]:
    x, y = printed_ratios()
    rows = [("*printed*", f"{x:.2f}", f"{y:.2f}", "")]
    for match in matches:
        words = EFFORTS[match.name].words + (" (ours)" if match.name == OUR_EFFORT else "")
        rows.append((words, f"{match.ratio_x:.2f}", f"{match.ratio_y:.2f}", match.distance.ratio()))
    return {
        "effort": table(("definition", "ratio on X", "ratio on Y", "off by a factor of"), rows),
        "scatter": printed_scatter(),
        "closest": f"the {EFFORTS[matches[0].name].words}",
    }


def _named(entry: TableEntry) -> str:
    return f"{CONTROLLERS[entry.cell.controller]} in {WINDS[entry.cell.wind]} ({percent_or_dash(entry.off)})"


def _by_wind(shares: Mapping[str, Interval]) -> str:
    return ", ".join(f"{share.percent()} ({WINDS[wind]})" for wind, share in shares.items())


def _in_brackets(off: float) -> str:
    return "" if np.isnan(off) else f" ({percent_or_dash(off)})"
